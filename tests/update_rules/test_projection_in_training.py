"""What the projection rule does with percepts, averages and whole trainings."""

import math
from functools import partial

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete
from projected import BETA_2, UTILITIES, Hidden, checked, gradients, make_chain

from bra import Agent, Cooling, blahut_arimoto
from bra.channels import MLP, Gaussian, Multinomial, Table
from bra.channels.distributions import probabilities
from bra.critics import TableCritic
from bra.marginals import BatchMarginals, ExactMarginals, RunningMarginals
from bra.tasks import PredatorPrey, TargetTask
from bra.update_rules import Chain, Projection, Rivals

REGRETS = torch.tensor(UTILITIES) - torch.tensor(UTILITIES).amax(1, keepdim=True)


NUMBER = Box(-np.inf, np.inf, shape=(1,), dtype=np.float32)


def test_the_value_of_a_percept_is_an_average_by_hand():
    chain = make_chain(Hidden(), marginals=RunningMarginals())
    chain.marginals.check(chain.task, Discrete(4))
    rule = checked(chain, decay=0.5)
    generator, weighted, weight = torch.Generator().manual_seed(0), 0.0, 0.0
    for _ in range(5):
        world = chain.task.sample(1, generator)
        rule.loss(chain, world)
        percept_given = probabilities(chain.perception(world.observation)).detach()
        weighted = 0.5 * weighted + 0.5 * percept_given.T @ REGRETS[world.state]
        weight = 0.5 * weight + 0.5 * percept_given.sum(0)
        torch.testing.assert_close(rule.percept_value, weighted / weight[:, None])
        torch.testing.assert_close(rule.percept_log_weight.exp(), weight)
        with torch.no_grad():
            chain.perception.logits += 0.3
            chain.perception.logits[:, 0] -= 0.5


def test_a_percept_that_has_become_impossible_keeps_its_value():
    chain = make_chain(Hidden(), marginals=BatchMarginals())
    rule = checked(chain, decay=0.0)
    world = chain.task.sample(20, torch.Generator().manual_seed(0))
    with torch.no_grad():
        chain.perception.logits[:, 0] = -200.0  # e⁻²⁰⁰ is 0 in float32
    loss, _ = rule.loss(chain, world)
    others = chain.perception.logits[:, 1:].detach()[world.state]
    mean = (-others.logsumexp(1)).softmax(0) @ REGRETS[world.state]
    torch.testing.assert_close(rule.percept_value[0], mean, rtol=0, atol=1e-4)
    assert all(part.isfinite().all() for part in gradients(chain, loss))


@pytest.mark.parametrize(
    ("hidden", "arguments"),
    [(False, {}), (True, {}), (False, {"rivals": Rivals(2, 1, 2)})],
    ids=["known", "sampled", "rivals"],
)
def test_a_percept_that_no_state_reaches_counts_nothing(hidden, arguments):
    chain = make_chain(Hidden() if hidden else None, marginals=BatchMarginals())
    with torch.no_grad():
        chain.perception.logits[:, 0] = -math.inf
    rule = checked(chain, **arguments)
    world = chain.task.sample(20, torch.Generator().manual_seed(0))
    loss, terms = rule.loss(chain, world)
    assert loss.isfinite() and terms.objective.isfinite()
    assert all(part.isfinite().all() for part in gradients(chain, loss))
    fewer = make_chain(Hidden() if hidden else None, percepts=3, marginals=BatchMarginals())
    with torch.no_grad():
        fewer.perception.logits.copy_(chain.perception.logits[:, 1:])
        fewer.action.logits.copy_(chain.action.logits[1:])
    _, expected = checked(fewer).loss(fewer, world)
    assert terms.objective.item() == pytest.approx(expected.objective.item(), abs=1e-5)


@pytest.mark.parametrize("critic", [None, TableCritic(3.0)], ids=["asked", "learnt"])
def test_utilities_may_be_whole_numbers(critic):
    class Whole(Hidden):
        def utility(self, state, action):
            return super().utility(state, action).long()

    chain = make_chain(Whole(), marginals=BatchMarginals())
    rule = checked(chain, critic=critic)
    loss, _ = rule.loss(chain, chain.task.sample(20, torch.Generator().manual_seed(0)))
    assert loss.dtype == torch.float32


def test_averages_belong_to_the_state():
    chain = make_chain(Hidden(), marginals=BatchMarginals())
    rule, other = checked(chain), checked(chain)
    rule.loss(chain, chain.task.sample(20, torch.Generator().manual_seed(0)))
    other.load_state_dict(rule.state_dict())
    assert torch.equal(other.percept_value, rule.percept_value)
    assert rule.percept_value.abs().sum() > 0


@pytest.mark.parametrize(
    "prices",
    [
        *[(8.0, 10.0), (1.0, 10.0), (0.5, 0.5)],
        *(pytest.param(other, marks=pytest.mark.slow) for other in ((8.0, 1.0), (1.0, 1.0))),
    ],
)
def test_with_a_covering_start_and_cooling_it_reaches_the_optimum(prices):
    task = PredatorPrey(observations="index")
    cooling = Cooling(factor=16.0, updates=150)
    agent = Agent(
        task,
        Table,
        partial(Multinomial, start="covering"),
        13,
        *prices,
        update_rule=Projection(),
        cooling=cooling,
        seed=1,
    )
    optimizer = torch.optim.Adam(agent.parameters(), lr=0.3)
    for _ in range(320):
        loss, _ = agent.update_rule.loss(agent.coming_chain(), task.states())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        agent.updates += 1
    optimum = blahut_arimoto.serial(task.utilities, task.prior, 13, *prices).objective
    assert agent.evaluate().objective == pytest.approx(optimum, abs=0.005)


@pytest.mark.parametrize("population", [3])
def test_a_population_is_trained_by_vmap(population):
    chains = []
    for seed in range(population):
        chain = make_chain(perception=partial(Table, spread=1.0 + seed))
        chains.append(chain)
    rule = checked(chains[0])
    states = chains[0].task.states()

    def loss(perception, action, beta):
        chain = chains[0]
        functional = Chain(
            chain.task,
            Functional(chain.perception, perception),
            Functional(chain.action, action),
            chain.marginals,
            beta,
            BETA_2,
        )
        return rule.loss(functional, states)[0]

    stacked = [
        torch.stack([getattr(chain, channel).logits.detach() for chain in chains])
        for channel in ("perception", "action")
    ]
    betas = torch.tensor([1.0, 2.0, 3.0])
    together = torch.func.vmap(torch.func.grad(loss))(*stacked, betas)
    for k in range(population):
        alone = torch.func.grad(loss)(stacked[0][k], stacked[1][k], betas[k])
        torch.testing.assert_close(together[k], alone)


class Functional(torch.nn.Module):
    """A table with other logits."""

    def __init__(self, channel, logits):
        super().__init__()
        self.channel, self.values = channel, logits
        self.outcome_space = channel.outcome_space

    def forward(self, condition):
        return torch.func.functional_call(self.channel, {"logits": self.values}, (condition,))

    def forward_all(self):
        return self(torch.arange(len(self.values)))


@pytest.mark.parametrize(
    ("perception", "action", "percepts", "task", "message"),
    [
        (Gaussian, MLP, NUMBER, PredatorPrey, r"needs percepts that can be enumerated, got Box"),
        (Table, Gaussian, Discrete(3), TargetTask, "needs actions that can be enumerated, got Box"),
    ],
)
def test_densities_are_refused(perception, action, percepts, task, message):
    task = (
        task([[1.0], [2.0]], observations="index")
        if task is TargetTask
        else task(observations="index")
    )
    first = perception(task.observation_space, percepts)
    second = action(percepts, task.action_space)
    chain = Chain(task, first, second, ExactMarginals(), 1.0, 1.0)
    with pytest.raises(ValueError, match=rf"Projection {message}.*; use ScoreFunction"):
        Projection().check(chain)


@pytest.mark.parametrize("decay", [-0.1, 1.0, math.nan])
def test_decay_is_checked(decay):
    with pytest.raises(ValueError, match="decay must be at least 0 and less than 1"):
        Projection(decay)
