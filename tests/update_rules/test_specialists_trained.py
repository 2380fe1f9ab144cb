"""Specialists in training."""

import math
from functools import partial

import pytest
import torch
from specialists_by_hand import (
    PRICES,
    PRIOR,
    UTILITIES,
    Hidden,
    chain_of,
    exact_terms,
    make_chain,
)
from training import make_trainer

from bra import Agent, Population, RolloutDataModule, blahut_arimoto
from bra.channels import Table
from bra.critics import NetworkCritic, TableCritic
from bra.marginals import RunningMarginals
from bra.tasks import Medical, PredatorPrey
from bra.update_rules import Projection, Rivals
from bra.update_rules.rivals import Aim


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.01, 0.03])
def test_networks_of_specialists_stay_where_rivals_lead_them(tmp_path, rate):
    task, prices = PredatorPrey(), (8.0, 10.0, 1.0)
    names = ("beta_perception", "beta_action", "beta_direct")
    betas = dict(zip(names, prices, strict=True))
    rates = {"perception_rate": rate, "action_rate": rate}
    agents = Population(task, percepts=13, replicas=4, seed=0, **betas, **rates)
    make_trainer(tmp_path, max_epochs=1).fit(agents, RolloutDataModule(task, 1, 2000))
    assert (agents.objectives() > 3.27049 - 0.025).all()


def look_agent(prices, **own):
    betas = dict(zip(("beta_perception", "beta_action", "beta_direct"), prices, strict=True))
    settings = {"percepts": 3, "perception": Table, "action": Table, "seed": 0, "cooling": None}
    return Agent(Medical(observations="index"), **(settings | betas | own))


def descend(agent, updates):
    optimizers = [torch.optim.Adam(c.parameters(), 0.3) for c in (agent.perception, agent.action)]
    generator = torch.Generator().manual_seed(0)
    for _ in range(updates):
        agent.zero_grad()
        agent.update_loss(agent.task.sample(8, generator)).backward()
        for optimizer in optimizers:
            optimizer.step()
        agent.updates += 1


@pytest.mark.parametrize(
    "prices",
    [
        (1.0, 1.0, 0.7),
        pytest.param((5.0, 1.0, 3.0), marks=pytest.mark.slow),
        pytest.param((5.0, 2.0, 4.0), marks=pytest.mark.slow),
    ],
)
def test_agents_find_out_where_percepts_are_worthless(prices):
    agent = look_agent(prices, update_rule=Projection())
    descend(agent, 300)
    best = blahut_arimoto.rate_distortion(agent.task.utilities, None, prices[2])
    terms = agent.evaluate()
    assert terms.objective == pytest.approx(best.objective, abs=5e-3)
    assert terms.perception_information < 1e-3
    assert terms.action_information < 1e-3


def test_rivals_lead_specialists_to_the_optimum():
    prices = (2.5, math.inf, 1.0)
    quick = Rivals(count=15, sweeps=10, lead=50)
    agent = look_agent(prices, update_rule=Projection(rivals=quick))
    descend(agent, 300)
    assert agent.evaluate().objective == pytest.approx(2.041820, abs=0.015)


def test_a_critic_learns_what_specialists_are_worth():
    agent = look_agent((8.0, 10.0, 3.0), update_rule=Projection(critic=TableCritic(3.0)))
    descend(agent, 250)
    terms = agent.evaluate()
    single = blahut_arimoto.rate_distortion(agent.task.utilities, None, 3.0)
    assert terms.objective > single.objective
    assert terms.direct_information > 0.1


def test_specialists_keep_a_little_of_what_rivals_lead_them_to():
    rivals = Rivals(count=2, sweeps=3, lead=4)
    agent = look_agent((8.0, 10.0, 3.0), update_rule=Projection(rivals=rivals))
    task, nothing = agent.task, (torch.zeros(6, 3), torch.zeros(3, 6, 10), torch.zeros(3))
    tables = (torch.full((3, 10), -math.log(10)), torch.full((3,), -math.log(3)))
    shares = []
    for update in (5, 6, 8, 9, 10, 1000):
        agent.updates = update
        found = agent.update_rule.rivals.guide(
            Aim(*nothing), agent.coming_chain(), *tables, task.prior.log(), task.utilities
        )
        shares.append(found.weight.sum().item())
        torch.testing.assert_close(found.action.sum(-1), torch.full((3, 6), shares[-1]))
    assert shares == pytest.approx([1.0, 1.0, 0.5, 0.25, 0.02, 0.02])


@pytest.mark.parametrize(
    ("critic", "times", "off"),
    [(TableCritic(3.0), 1, 1e-6), (NetworkCritic(lr=0.01, batch_size=60, memory=60), 400, 0.02)],
    ids=["table", "network"],
)
def test_no_critic_has_to_see_the_percept(critic, times, off):
    """What it tells of (ξ, a) is all there is to know: specialists aim where U would have them."""
    agent = look_agent((8.0, 10.0, 3.0), update_rule=Projection(critic=critic))
    task, knowing = agent.task, agent.update_rule.critic
    state, action = torch.cartesian_prod(torch.arange(6), torch.arange(10)).T
    generator = torch.Generator().manual_seed(0)
    for _ in range(times):
        uniform = partial(torch.rand, generator=generator)
        knowing.take(state, action, task.utility(state, action).double(), uniform)
    chain, worlds = agent.coming_chain(), task.states()
    weights = [*agent.perception.parameters(), *agent.action.parameters()]
    slopes = [
        torch.autograd.grad(rule.loss(chain, worlds)[0], weights)
        for rule in (Projection(), agent.update_rule)
    ]
    torch.testing.assert_close(*slopes, rtol=0, atol=off)


def test_signals_that_are_not_known_train_specialists_too():
    chain = chain_of(Hidden(), Table, Table, RunningMarginals(decay=0.9))
    rule = Projection()
    rule.check(chain)
    optimizer = torch.optim.Adam(
        [*chain.perception.parameters(), *chain.action.parameters()], lr=0.1
    )
    generator = torch.Generator().manual_seed(0)
    for _ in range(300):
        optimizer.zero_grad()
        rule.loss(chain, chain.task.sample(32, generator))[0].backward()
        optimizer.step()
    known = make_chain()
    known.perception.load_state_dict(chain.perception.state_dict())
    known.action.load_state_dict(chain.action.state_dict())
    found = exact_terms(known).objective.item()
    best = blahut_arimoto.general(UTILITIES, PRIOR, 3, *PRICES).objective
    assert found == pytest.approx(best, abs=0.02)
