"""Counting, checkpoints and resuming."""

import math
from functools import partial

import pytest
import torch
from gymnasium.spaces import Box, Discrete
from small_agents import make_agent
from training import assert_same_state, fit, make_trainer

from bra import Agent, PredatorPrey, RolloutDataModule, TableTask
from bra.channels import CNN, MLP, Channel, Gaussian
from bra.checkpoints.recipes import same_recipe
from bra.marginals import BatchMarginals, ExactMarginals, RunningMarginals
from bra.tasks import TargetTask, Task, World
from bra.update_rules import ScoreFunction


def test_an_update_is_one_step_of_both_optimizers(tmp_path):
    agent = make_agent()
    trainer = fit(agent, tmp_path, max_epochs=3)
    assert agent.updates == 30
    assert trainer.global_step == 30
    assert agent.samples == 30 * 4
    steps = [state["step"].item() for state in trainer.optimizers[0].state.values()]
    assert set(steps) == {30}
    momenta = [state["momentum_buffer"] for state in trainer.optimizers[1].state.values()]
    assert len(momenta) == 1 and momenta[0].abs().sum() > 0
    assert trainer.lr_scheduler_configs[0].scheduler.last_epoch == 30


def test_what_was_left_to_the_agent_is_recorded():
    torch.manual_seed(0)
    agent = Agent(PredatorPrey(), percepts=3)
    given = agent.init_arguments()
    assert given["seed"] == agent.seed
    assert given["percepts"] == Discrete(3)
    assert given["update_rule"] is agent.update_rule
    assert given["marginals"] is agent.marginals
    again = Agent(**given)
    assert_same_state(agent, again)
    assert same_recipe(agent.recipe, again.recipe)


class Hunter(Agent):
    """An agent with arguments of its own."""

    def __init__(self, width: int, **own):
        super().__init__(PredatorPrey(), partial(MLP, hidden=[width]), **own)


def test_a_derived_agent_is_rebuilt_from_its_own_arguments(tmp_path):
    agent = Hunter(6, percepts=4, seed=1)
    fit(agent, tmp_path, max_epochs=1).save_checkpoint(tmp_path / "hunter.ckpt")
    loaded = Hunter.load_from_checkpoint(tmp_path / "hunter.ckpt")
    assert_same_state(agent, loaded)
    resumed = Hunter(6, percepts=4, seed=1)
    fit(resumed, tmp_path, max_epochs=1, ckpt_path=tmp_path / "hunter.ckpt")
    assert_same_state(agent, resumed)


def test_rules_and_marginals_belong_to_one_agent(tmp_path):
    rule, marginals = ScoreFunction(baseline="running"), RunningMarginals()
    first, second = (make_agent(percepts=n, update_rule=rule, marginals=marginals) for n in (3, 5))
    fit(first, tmp_path, max_epochs=1)
    assert rule.running_weight == 0
    assert second.update_rule.running_weight == 0
    fit(second, tmp_path, max_epochs=1)


def test_the_data_must_be_of_the_same_task(tmp_path):
    agent = make_agent()
    other = RolloutDataModule(PredatorPrey("mating"))
    with pytest.raises(
        ValueError, match=r"draws worlds of PredatorPrey\(variant=mating.*same task"
    ):
        make_trainer(tmp_path, max_epochs=1).fit(agent, other)
    equal = RolloutDataModule(PredatorPrey(), 4, 5)
    make_trainer(tmp_path, max_epochs=1).fit(agent, equal)
    assert agent.updates == 5


def test_a_task_with_one_action(tmp_path):
    agent = Agent(TableTask([[1.0], [2.0]]))
    fit(agent, tmp_path, max_epochs=1)
    assert agent.behaviour().tolist() == [[1.0], [1.0]]
    assert agent.evaluate().expected_utility == 1.5


def test_a_density_and_a_state_that_never_occurs():
    task = TableTask([[1, 2], [3, 0], [0, 1]], prior=[0.5, 0.5, 0], observations="index")
    agent = Agent(task, partial(Gaussian, scale=0.01), MLP, Box(-3, 3, (1,)), seed=0)
    reached = agent.evaluate()
    assert math.isfinite(reached.objective)
    # Two states, far apart in units of the scale, each with mass one half.
    assert reached.perception_information == pytest.approx(math.log(2), abs=1e-6)


def test_predictions_differ_between_batches():
    agent = make_agent()
    world = agent.task.sample(64, torch.Generator().manual_seed(0))
    first, again, second = (agent.predict_step(world, batch) for batch in (0, 0, 1))
    assert torch.equal(first.percept, again.percept)
    assert not torch.equal(first.percept, second.percept)


def test_seed_decides_the_initial_channels():
    def weights(seed):
        return make_agent(seed=seed).perception.network[0].weight

    assert torch.equal(weights(1), weights(1))
    assert not torch.equal(weights(1), weights(2))
    torch.manual_seed(7)
    first = make_agent(seed=None)
    torch.manual_seed(7)
    assert make_agent(seed=None).seed == first.seed


def test_behaviour_and_act():
    agent = make_agent()
    behaviour = agent.behaviour()
    assert behaviour.shape == (9, 9)
    torch.testing.assert_close(behaviour.sum(1), torch.ones(9, dtype=torch.float64))
    torch.manual_seed(0)
    percept, action = agent.act(agent.task.observations[:1].expand(40_000, -1))
    assert percept.shape == action.shape == (40_000,)
    frequencies = action.bincount(minlength=9) / 40_000
    # Four standard errors of a frequency are at most 0.01.
    torch.testing.assert_close(frequencies.double(), behaviour[0], atol=0.01, rtol=0)
    with pytest.raises(TypeError, match=r"needs a FiniteTask, got TargetTask; use act\(\)"):
        Agent(TargetTask([[0.0]]), action=Gaussian).behaviour()


class Dial(Task):
    """A world without a list of states: say whether a noisy reading of ω ~ N(0, 1) is positive."""

    observation_space = Box(-math.inf, math.inf, (1,))
    action_space = Discrete(2)

    def sample(self, count, generator):
        state = torch.randn(count, generator=generator)
        noise = 0.1 * torch.randn(count, generator=generator)
        return World(state, (state + noise).unsqueeze(-1))

    def utility(self, state, action):
        return ((state > 0) == action.bool()).float()


def test_a_world_without_a_list_of_states(tmp_path):
    agent = Agent(
        Dial(),
        percepts=2,
        beta_perception=5.0,
        beta_action=5.0,
        update_rule=ScoreFunction(samples=4, baseline="leave-one-out"),
        perception_optimizer=partial(torch.optim.Adam, lr=0.05),
        action_optimizer=partial(torch.optim.Adam, lr=0.05),
        seed=0,
    )
    assert isinstance(agent.marginals, RunningMarginals)
    data = RolloutDataModule(agent.task, 64, 150)
    trainer = make_trainer(tmp_path, max_epochs=1)
    trainer.fit(agent, data)
    (metrics,) = trainer.test(agent, data, verbose=False)
    # A binary channel on a fair coin at 1/β = 1/5 + 1/5: J ≤ ln((e^β + 1)/2)/β = 0.7555.
    assert 0.65 < metrics["objective/J"] < 0.7555
    assert metrics["information/perception_bits"] < 1
    (rollout,) = trainer.predict(agent, data)
    assert rollout.utility.mean() > 0.85


def test_default_marginals():
    assert isinstance(Agent(PredatorPrey()).marginals, ExactMarginals)
    continuous = Agent(Dial(), MLP, MLP, Box(-1, 1, (1,)))
    assert isinstance(continuous.marginals, BatchMarginals)


class Silent(Channel):
    def forward(self, condition):
        return condition


class Wide(MLP):
    def forward(self, condition):
        return super().forward(condition.unsqueeze(0))


def test_one_encounter_has_no_batch_marginal(tmp_path):
    agent = make_agent(marginals=BatchMarginals())
    data = RolloutDataModule(agent.task, batch_size=1)
    with pytest.raises(ValueError, match="BatchMarginals need batches of at least 2"):
        make_trainer(tmp_path, max_epochs=1).fit(agent, data)


@pytest.mark.parametrize(
    ("own", "error", "message"),
    [
        ({"beta_perception": 0.0}, ValueError, "beta_perception must be positive and finite"),
        ({"beta_action": float("nan")}, ValueError, "beta_action must be positive and finite"),
        ({"beta_action": float("inf")}, ValueError, "beta_action must be positive and finite"),
        ({"percepts": 0}, ValueError, "percepts must be a whole number of at least 1, got 0"),
        ({"perception": CNN}, ValueError, r"CNN cannot go from Box.* to Discrete\(5\)"),
        ({"action": Gaussian}, ValueError, r"Gaussian cannot go from Discrete\(5\) to Discrete"),
        ({"perception": Silent}, TypeError, "Silent.forward returned Tensor; expected"),
        ({"perception": Wide}, ValueError, r"Wide.forward returned .* batch shape \(1, 2\)"),
        ({"perception": torch.nn.Tanh}, TypeError, "perception: "),
        (
            {"action": make_agent().action},
            TypeError,
            "action must be a class of kind Channel, or a funct",
        ),
        ({"perception_optimizer": torch.optim.LBFGS}, ValueError, "LBFGS needs the loss several"),
        (
            {"action_scheduler": torch.optim.lr_scheduler.ReduceLROnPlateau},
            ValueError,
            "ReduceLROnPlateau waits for a metric",
        ),
        ({"perception": lambda c, o: MLP(c, o)}, TypeError, "cannot be written into a checkpoint"),
        (
            {"perception_optimizer": partial(torch.optim.Adam, lr=-1.0)},
            ValueError,
            "perception_optimizer: Invalid learning rate",
        ),
    ],
)
def test_wrong_settings_are_refused(own, error, message):
    with pytest.raises(error, match=message):
        make_agent(**own)
