"""Agents whose actions look at the signal again, at a third price."""

from functools import partial
from pathlib import Path

import pytest
import torch
from gymnasium.spaces import Box, Discrete, Tuple
from lightning.pytorch.loggers import CSVLogger
from training import fit

from bra import Agent, Cooling
from bra.blahut_arimoto import general
from bra.callbacks import InformationMonitor
from bra.callbacks.baseline import solve_reference
from bra.channels import MLP, Multinomial, Table
from bra.cli.baseline import baseline_text, optimum_fields
from bra.tasks import Medical, TargetTask
from bra.update_rules import ExactGradient, Projection, UpdateRule

PRICES = (10.0, 5.0, 2.0)
COVERING = partial(Multinomial, start="covering")


class Blind(UpdateRule):
    """A rule of one's own, which asks channels for p(a|x)."""

    def loss(self, chain, world):
        raise NotImplementedError


def make_agent(**own):
    settings = {"percepts": 3, "perception": Table, "action": Table, "seed": 0, "update_rule": None}
    betas = dict(zip(("beta_perception", "beta_action", "beta_direct"), PRICES, strict=True))
    return Agent(Medical(observations="index"), **(settings | betas | own))


def at_optimum(**own):
    agent = make_agent(**own)
    task = agent.task
    found = general(task.utilities, task.prior, 3, *PRICES, budget=32)
    with torch.no_grad():
        agent.perception.logits.copy_(found.percept_given_state.clamp(min=1e-30).log())
        rows = found.action_given_percept_and_state.clamp(min=1e-30).log()
        agent.action.logits.copy_(rows.flatten(0, 1))
    return agent, found


def test_evaluation_is_that_of_the_optimum():
    agent, found = at_optimum()
    terms = agent.evaluate()
    for name in (
        "objective",
        "expected_utility",
        "perception_information",
        "action_information",
        "direct_information",
        "end_to_end_information",
    ):
        assert getattr(terms, name) == pytest.approx(getattr(found, name), abs=1e-5)
    torch.testing.assert_close(agent.behaviour(), found.action_given_state, atol=1e-5, rtol=0)
    looks = agent.evaluation().action_given_percept_and_state
    torch.testing.assert_close(looks, found.action_given_percept_and_state, atol=1e-5, rtol=0)


@pytest.mark.parametrize("rule", [ExactGradient, Projection])
def test_the_optimum_is_stationary(rule):
    agent, found = at_optimum(update_rule=rule())
    agent.update_loss(agent.task.states()).backward()
    assert agent.perception.logits.grad.abs().max() < 1e-5
    assert agent.action.logits.grad.abs().max() < 1e-5
    assert agent.terms.objective.item() == pytest.approx(found.objective, abs=1e-5)
    assert agent.terms.direct_information.item() == pytest.approx(
        found.direct_information, abs=1e-5
    )


def test_baseline_is_that_of_three_prices():
    reference = solve_reference(make_agent(), restarts=4)
    assert reference.objective == pytest.approx(2.342520, abs=1e-6)
    assert "I(Ω;A|X)     0.7794 bits" in baseline_text(reference)
    assert optimum_fields(reference)["direct_information_nats"] == pytest.approx(0.540257, abs=1e-6)


def test_the_exact_gradient_is_that_of_evaluation():
    agent = make_agent(update_rule=ExactGradient())
    agent.update_loss(agent.task.states()).backward()
    for logits in (agent.perception.logits, agent.action.logits):
        step = 0.01 * logits.grad / logits.grad.norm()
        values = []
        for sign in (1, -1):
            with torch.no_grad():
                logits.sub_(sign * step)
            agent.updates += 1
            values.append(agent.evaluate().objective)
            with torch.no_grad():
                logits.add_(sign * step)
        slope = (values[0] - values[1]) / 0.02
        assert slope == pytest.approx(logits.grad.norm().item(), rel=1e-3)


def test_agents_learn_specialists(tmp_path):
    agent = make_agent(perception=None, action=None)
    before = agent.evaluate().objective
    fit(agent, tmp_path, max_epochs=10)
    after = agent.evaluate()
    assert after.objective > before + 0.3
    assert 0 < after.direct_information
    percept, action = agent.act(torch.arange(6))
    assert percept.shape == action.shape == (6,)


def test_checkpoints_keep_the_third_price(tmp_path):
    agent = make_agent()
    trainer = fit(agent, tmp_path, max_epochs=1)
    trainer.save_checkpoint(tmp_path / "agent.ckpt")
    again = Agent.load_from_checkpoint(tmp_path / "agent.ckpt")
    assert again.beta_direct == PRICES[2]
    assert again.evaluate() == agent.evaluate()


def test_covering_starts_share_out_the_actions_among_percepts():
    pair = Tuple((Discrete(5), Discrete(4)))
    channel = Multinomial(pair, Discrete(5), start="covering")
    grid = torch.meshgrid(torch.arange(5), torch.arange(4), indexing="ij")
    favourite = channel(grid).probs.argmax(-1)
    assert (favourite == favourite[:, :1]).all()
    assert sorted(favourite[:, 0].tolist()) == [0, 1, 2, 3, 4]


def test_networks_join_signals_and_percepts():
    pair = Tuple((Discrete(3), Box(0, 1, (2, 2))))
    channel = MLP(pair, Discrete(5), hidden=[])
    assert channel.network[0].in_features == 7
    assert channel((torch.arange(3), torch.rand(3, 2, 2))).batch_shape == (3,)


@pytest.mark.parametrize(
    ("own", "words"),
    [
        ({"beta_direct": 0.0}, "beta_direct must be positive and finite, got 0"),
        ({"beta_direct": float("nan")}, "beta_direct must be positive and finite, got nan"),
        ({"beta_direct": float("inf")}, "beta_direct must be positive and finite, got inf"),
        (
            dict.fromkeys(("beta_perception", "beta_action", "beta_direct"), float("inf")),
            "all inf: information is free, and the solution is the best action in every state",
        ),
        ({"beta_perception": float("inf")}, "beta_perception must be positive and finite, got inf"),
        ({"update_rule": Blind()}, "Blind does not train actions that look at the signal again"),
        ({"percepts": Box(-1, 1, (1,))}, "beta_direct needs Discrete percepts, each of which"),
        (
            {"task": TargetTask([[0.0], [1.0]], observations="index"), "action": COVERING},
            "action: Multinomial cannot go from Tuple.*: its outcome space must be Discrete",
        ),
        (
            {"task": Medical(), "action": Multinomial},
            "action: Multinomial keeps a row for each condition and cannot have Box",
        ),
    ],
)
def test_refusals(own, words):
    task = own.pop("task", Medical(observations="index"))
    settings = {"percepts": 3, "action": Table, "beta_direct": 1.0, "seed": 0}
    with pytest.raises(ValueError, match=words) as caught:
        Agent(task, **(settings | own))
    assert "\n" not in str(caught.value)


def test_information_that_is_free_for_actions():
    agent = make_agent(beta_action=float("inf"))
    terms = agent.evaluate()
    spent = terms.perception_information / 10 + terms.direct_information / 2
    assert terms.objective == pytest.approx(terms.expected_utility - spent, abs=1e-9)
    agent.update_loss(agent.task.states()).backward()
    assert agent.action.logits.grad.isfinite().all()
    with pytest.raises(ValueError, match="beta_action must be positive and finite, got inf"):
        Agent(agent.task, beta_action=float("inf"))


def test_the_third_price_cools_with_the_second(tmp_path):
    agent = make_agent(cooling=Cooling(factor=2.0, action_factor=4.0, updates=2))
    chain = agent.coming_chain()
    prices = (chain.beta_perception, chain.beta_action, chain.beta_direct)
    assert prices == (20.0, 20.0, 8.0)
    logger = CSVLogger(tmp_path)
    fit(agent, tmp_path, max_epochs=1, logger=logger, callbacks=[InformationMonitor()])
    rows = (Path(logger.log_dir) / "metrics.csv").read_text().splitlines()
    table = [dict(zip(rows[0].split(","), row.split(","), strict=True)) for row in rows[1:]]
    assert [float(row["prices/beta_direct"]) for row in table] == [8.0, PRICES[2]]
    assert agent.coming_chain().beta_direct == PRICES[2]


def test_certificates_are_not_for_three_prices():
    with pytest.raises(ValueError, match="certify proves optima without beta_direct, got both"):
        solve_reference(make_agent(), certify=1.0)


def test_channels_that_take_no_pair_are_refused():
    class Plain(MLP):
        condition_spaces = (Discrete, Box)

    with pytest.raises(ValueError, match="its condition space must be Discrete or Box"):
        make_agent(action=partial(Plain, hidden=[]))
