"""Prices that approach those of the agent."""

import math
from functools import partial

import pytest
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from training import assert_same_state, fit

from bra import Agent, Cooling, Population, PredatorPrey
from bra.callbacks import InformationMonitor
from bra.channels import Multinomial
from bra.checkpoints.recipes import from_recipe
from bra.critics import Exploration, TableCritic
from bra.tasks import TargetTask
from bra.update_rules import ExactGradient, Projection, ScoreFunction


def make_agent(**own):
    settings = {
        "action": partial(Multinomial, start="covering"),
        "percepts": 5,
        "beta_perception": 8.0,
        "beta_action": 10.0,
        "update_rule": Projection(),
        "cooling": Cooling(factor=16.0, updates=20),
        "seed": 0,
    }
    return Agent(PredatorPrey(), **(settings | own))


def test_the_scale_falls_geometrically_to_one():
    cooling = Cooling(factor=16.0, updates=4)
    scales = [cooling.scales(k, seed=7) for k in range(6)]
    assert [first for first, _ in scales] == pytest.approx([16, 8, 4, 2, 1, 1])
    assert all(first == second for first, second in scales)
    assert cooling.scales(4, 7) == cooling.scales(10**9, 7) == (1.0, 1.0)


def test_both_prices_may_have_factors_of_their_own():
    cooling = Cooling(factor=16.0, updates=4, action_factor=0.25)
    assert cooling.scales(0, seed=0) == (16.0, 0.25)
    assert cooling.scales(2, seed=0) == pytest.approx((4.0, 0.5))
    agent = make_agent(cooling=cooling)
    assert agent.prices == (128.0, 2.5)


def test_from_a_range_every_seed_draws_its_own_factor():
    cooling = Cooling(factor=[2.0, 32.0], updates=4, action_factor=[0.25, 4.0])
    factors = torch.tensor([cooling.factors(seed) for seed in range(2000)]).log2()
    assert factors[:, 0].min() >= 1 and factors[:, 0].max() <= 5
    # Uniform on [1, 5] and [-2, 2]: the mean of 2000 has a standard deviation of 0.026.
    assert factors.mean(0).tolist() == pytest.approx([3.0, 0.0], abs=0.13)
    assert factors.T.corrcoef()[0, 1].abs() < 0.12
    assert cooling.factors(5) == cooling.factors(5) != cooling.factors(6)
    only = Cooling(factor=[2.0, 32.0], updates=4)
    first, second = only.factors(3)
    assert first == second != only.factors(4)[0]


@pytest.mark.parametrize("rule", [Projection(), ExactGradient(), ScoreFunction()])
def test_updates_see_cooled_prices_and_evaluation_does_not(rule, tmp_path):
    agent = make_agent(update_rule=rule)
    plain = make_agent(update_rule=rule, cooling=None)
    assert agent.prices == (128.0, 160.0)
    assert agent.evaluate() == plain.evaluate()
    world = agent.task.states()
    torch.manual_seed(0)
    terms = agent.update_rule.loss(agent.coming_chain(), world)[1]
    price = terms.perception_information / 128 + terms.action_information / 160
    torch.testing.assert_close(terms.objective, terms.expected_utility - price)
    fit(agent, tmp_path, max_epochs=2)
    assert agent.updates == 20
    assert agent.prices == (8.0, 10.0)


def test_a_resumed_run_cools_on(tmp_path):
    through = make_agent()
    fit(through, tmp_path, max_epochs=3)
    callback = ModelCheckpoint(tmp_path, "cut", every_n_train_steps=13)
    cut = {"callbacks": [callback], "enable_checkpointing": True, "max_steps": 13}
    fit(make_agent(), tmp_path, max_epochs=3, **cut)
    loaded = Agent.load_from_checkpoint(tmp_path / "cut.ckpt")
    assert loaded.cooling == Cooling(factor=16.0, updates=20)
    assert loaded.prices[0] == pytest.approx(8 * 16 ** (7 / 20))
    resumed = make_agent()
    fit(resumed, tmp_path, ckpt_path=tmp_path / "cut.ckpt", max_epochs=3)
    assert_same_state(resumed, through)
    warm = make_agent(cooling=None)
    fit(warm, tmp_path, max_epochs=3)
    assert not torch.equal(warm.action.eta, through.action.eta)


def test_prices_are_logged(tmp_path):
    from lightning.pytorch.loggers import TensorBoardLogger

    logger = TensorBoardLogger(tmp_path)
    monitor = InformationMonitor(every_n_updates=10)
    fit(make_agent(), tmp_path, max_epochs=3, logger=logger, callbacks=[monitor])
    events = EventAccumulator(logger.log_dir)
    events.Reload()
    for name, beta in (("perception", 8), ("action", 10)):
        points = events.Scalars(f"prices/beta_{name}")
        assert [point.step for point in points] == [0, 10, 20, 30]
        expected = [16 * beta, 4 * beta, beta, beta]
        assert [point.value for point in points] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"factor": 0.0}, "cooling factor must be positive and finite, got 0.0"),
        ({"factor": math.inf}, "cooling factor must be positive and finite, got inf"),
        ({"factor": math.nan}, "cooling factor must be positive and finite, got nan"),
        ({"factor": [4.0, math.inf]}, r"factor must be positive and finite, got \[4.0, inf\]"),
        ({"action_factor": 0.0}, "cooling action_factor must be positive and finite, got 0.0"),
        ({"action_factor": [4.0, 0.5]}, "a number, or the low and the high end of a range, got"),
        ({"factor": [1.0, 2.0, 3.0]}, "a number, or the low and the high end of a range, got"),
        ({"updates": 0}, "cooling updates must be a whole number of at least 1, got 0"),
        ({"updates": 2.5}, "cooling updates must be a whole number of at least 1, got 2.5"),
    ],
)
def test_bad_settings_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Cooling(**arguments)


SHARES = {
    "cooling": Cooling(16.0, 0.5),
    "update_rule": Projection(critic=TableCritic(5.0), exploration=Exploration(0.3, 0.75, 0.2)),
}


def settled(learner) -> tuple[int, ...]:
    exploration = learner.update_rule.exploration
    return learner.cooling.updates, exploration.updates, exploration.uniform_updates


@pytest.mark.parametrize(
    "length",
    [{"max_epochs": 2}, {"max_epochs": 9, "max_steps": 20}, {"max_epochs": -1, "max_steps": 20}],
    ids=["epochs", "steps first", "steps only"],
)
def test_a_share_is_one_of_the_run(length, tmp_path):
    agent = make_agent(**SHARES)
    fit(agent, tmp_path, **length)
    assert settled(agent) == (10, 15, 4)
    assert settled(Agent(**from_recipe(agent.recipe))) == (10, 15, 4)
    fit(agent, tmp_path, max_epochs=4)
    assert settled(agent) == (10, 15, 4)  # what has begun goes on


def test_chosen_shares_are_printed_as_updates(tmp_path, capsys):
    agent = Agent(TargetTask([[0.0], [1.0]]), seed=0)
    fit(agent, tmp_path, max_epochs=3)
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "chosen" in line)
    assert line == agent.chosen
    assert "cooling Cooling(factor=4.0, updates=12)" in line


@pytest.mark.parametrize("kind", [Agent, partial(Population, replicas=2)])
def test_a_longer_resumed_run_keeps_its_shares(kind, tmp_path):
    def make():
        return kind(PredatorPrey(), percepts=5, seed=0, **SHARES)

    cut = tmp_path / "cut.ckpt"
    callback = ModelCheckpoint(tmp_path, "cut", every_n_train_steps=13)
    saving = {"callbacks": [callback], "enable_checkpointing": True}
    through = make()
    fit(through, tmp_path, max_epochs=2, **saving)
    resumed = make()
    fit(resumed, tmp_path, max_epochs=2, ckpt_path=cut)
    assert_same_state(resumed, through)
    longer = make()
    fit(longer, tmp_path, max_epochs=4, ckpt_path=cut)
    assert settled(longer) == settled(through) == (10, 15, 4)
    assert longer.run == 20


def test_agents_without_a_run_take_shares_of_a_usual_one():
    agent = make_agent(**SHARES)
    agent.updates = 2500
    assert agent.prices == (32.0, 40.0)
