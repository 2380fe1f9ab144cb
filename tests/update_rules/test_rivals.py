"""Rivals: tables that compete, and channels that are led to the better one."""

import copy
import json
from functools import partial
from pathlib import Path

import pytest
import torch
from gymnasium.spaces import Discrete
from projected import Hidden

from bra import Agent, TableTask, blahut_arimoto
from bra.channels import Multinomial, Table
from bra.critics import TableCritic
from bra.marginals import ExactMarginals, RunningMarginals
from bra.objective import table_objective
from bra.tasks import PredatorPrey
from bra.update_rules import Chain, Projection, Rivals
from bra.update_rules.rivals import Aim
from bra.update_rules.sweeps import sweep

UTILITIES = [[2.0, 0.0, 1.0], [0.0, 1.5, 1.0], [-1.0, 0.5, 3.0]]
PRIOR = [0.5, 0.3, 0.2]
CASES = Path(__file__).parent
REGIMES = [(8.0, 10.0), (1.0, 10.0), (0.5, 0.5)]
REGIMES += [pytest.param(other, marks=pytest.mark.slow) for other in ((8.0, 1.0), (1.0, 1.0))]
SEEDS = [0, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2))]
QUICK = Rivals(count=12, sweeps=10, lead=60)


def random_problem(seed):
    generator = torch.Generator().manual_seed(seed)
    states, percepts, actions = (int(n) for n in torch.randint(2, 8, (3,), generator=generator))
    kind = {"generator": generator, "dtype": torch.float64}
    utilities, weights = torch.randn(states, actions, **kind), torch.rand(states, **kind)
    beta_1, beta_2 = (0.3 * 60 ** torch.rand(2, **kind)).tolist()
    start = torch.randn(percepts, actions, **kind).log_softmax(-1)
    return utilities, weights / weights.sum(), start, beta_1, beta_2


@pytest.mark.parametrize("seed", range(10))
def test_sweeps_never_lower_j_and_say_what_it_is(seed):
    utilities, prior, log_action, *betas = random_problem(seed)
    log_marginal = torch.full(log_action.shape[:1], 1 / len(log_action)).double().log()
    before = -torch.inf
    for _ in range(30):
        old = log_action
        percept, log_action, log_marginal, objective, _ = sweep(
            log_action, log_marginal, prior.log(), utilities, *betas
        )
        assert before - 1e-12 <= objective <= _j(prior, percept, old, utilities, betas) + 1e-12
        torch.testing.assert_close(log_marginal.exp(), prior @ percept.exp())
        before = _j(prior, percept, log_action, utilities, betas)
        assert before >= objective - 1e-12


def _j(prior, log_percept, log_action, utilities, betas):
    terms = table_objective(prior, log_percept.exp(), log_action.exp(), utilities, *betas)
    return terms.objective


@pytest.mark.parametrize("prices", [(8.0, 10.0), (8.0, 1.0), (1.0, 10.0), (1.0, 1.0)])
def test_an_optimum_is_a_fixed_point_of_sweeps(prices):
    task = PredatorPrey()
    optimum = blahut_arimoto.serial(task.utilities, task.prior, 13, *prices)
    percept, action, marginal, objective, _ = sweep(
        optimum.action_given_percept.clamp_min(1e-300).log(),
        optimum.percept_marginal.clamp_min(1e-300).log(),
        task.prior.log(),
        task.utilities,
        *prices,
    )
    assert objective.item() == pytest.approx(optimum.objective, abs=1e-9)
    used = optimum.percept_marginal > 1e-9
    torch.testing.assert_close(marginal.exp(), optimum.percept_marginal, rtol=0, atol=1e-5)
    torch.testing.assert_close(
        action.exp()[used], optimum.action_given_percept[used], rtol=0, atol=1e-4
    )
    torch.testing.assert_close(percept.exp(), optimum.percept_given_state, rtol=0, atol=1e-4)


def trained(task, percepts, *prices, rivals=QUICK, updates=280, seed=0, **rule):
    agent = Agent(
        task,
        Table,
        partial(Multinomial, start="covering"),
        percepts,
        *prices,
        update_rule=Projection(rivals=rivals, **rule),
        seed=seed,
    )
    optimizer = torch.optim.Adam(agent.parameters(), lr=0.3)
    for _ in range(updates):
        generator = torch.Generator().manual_seed(agent.updates)
        loss = agent.update_loss(task.sample(8, generator))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        agent.updates += 1
    return agent


def handed_case():
    case = json.loads((CASES / "table13x8.json").read_text(encoding="utf-8"))
    prices = case["beta_perception"], case["beta_action"]
    task = TableTask(str(CASES / "table13x8.csv"), case["prior"], observations="index")
    return task, case["percepts"], prices


@pytest.mark.parametrize("seed", SEEDS)
def test_a_table_that_covering_starts_and_cooling_miss(seed):
    task, percepts, prices = handed_case()
    optimum = blahut_arimoto.serial(task.utilities, task.prior, percepts, *prices).objective
    spread = (task.utilities.max() - task.utilities.min()).item()
    reached = trained(task, percepts, *prices, seed=seed).evaluate().objective
    assert reached == pytest.approx(optimum, abs=0.005 * spread)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("prices", [(0.2, 0.3), (20.0, 0.1), (0.1, 20.0)])
def test_no_agent_ends_below_the_best_constant_action(prices, seed):
    task = TableTask(UTILITIES, prior=PRIOR, observations="index")
    constant = (task.prior @ task.utilities).max().item()
    agent = trained(task, 3, *prices, rivals=Rivals(count=2, sweeps=2, lead=200), seed=seed)
    reached = agent.evaluate().objective
    assert reached > constant - 0.001 * 4  # of the range; fits of a certain action never end


@pytest.mark.parametrize("prices", REGIMES)
def test_predator_prey_without_cooling(prices):
    task = PredatorPrey(observations="index")
    optimum = blahut_arimoto.serial(task.utilities, task.prior, 13, *prices).objective
    agent = trained(task, 13, *prices, seed=1)
    assert agent.evaluate().objective == pytest.approx(optimum, abs=0.005)


def test_utilities_may_be_learnt():
    task, percepts, prices = handed_case()
    optimum = blahut_arimoto.serial(task.utilities, task.prior, percepts, *prices).objective
    rivals = Rivals(count=20, sweeps=10, lead=100)
    critic = TableCritic(start=2.2)
    agent = trained(task, percepts, *prices, rivals=rivals, updates=400, critic=critic)
    assert agent.evaluate().objective == pytest.approx(optimum, abs=0.03)


def test_channels_are_led_for_a_time_and_then_let_go_little_by_little():
    task = TableTask(UTILITIES, prior=PRIOR, observations="index")
    agent = trained(task, 4, 2.0, 3.0, rivals=Rivals(count=2, sweeps=3, lead=4), updates=3)
    rivals, shares = agent.update_rule.rivals, []
    for update in range(3, 13):
        agent.updates = update
        chain = agent.coming_chain()
        aims = []
        for own in (0.0, 1.0):
            targets = (torch.full(shape, own) for shape in ((3, 4), (4, 3), (4,)))
            aims.append(copy.deepcopy(rivals).guide(Aim(*targets), chain, *_tables(agent)))
        share = aims[0].weight.sum().item()
        for led, mixed in zip(*aims, strict=True):  # s · led, and s · led + (1 − s)
            torch.testing.assert_close(mixed - led, torch.full_like(led, 1 - share))
        shares.append(share)
    assert shares == pytest.approx([1, 1, 1, 1, 0.75, 0.5, 0.25, 0, 0, 0])


def _tables(agent):
    action = agent.action(torch.arange(4)).logits.log_softmax(-1)
    flat = torch.full((4,), 0.25).log()
    return action.detach(), flat, agent.task.prior.float().log(), agent.task.utilities.float()


def test_what_channels_are_let_go_to_is_the_rules_own():
    task = TableTask(UTILITIES, prior=PRIOR, observations="index")
    rivals = Rivals(count=2, sweeps=3, lead=4)
    agent = trained(task, 4, 2.0, 3.0, rivals=rivals, updates=9)
    for leads in (True, False):
        plain = Projection().loss(agent.coming_chain(), task.states())[0]
        led = agent.update_rule.loss(agent.coming_chain(), task.states())[0]
        assert torch.equal(plain, led) is not leads
        agent.updates += 1


def test_the_terms_are_those_of_the_channels():
    task = TableTask(UTILITIES, prior=PRIOR, observations="index")
    agent = trained(task, 4, 2.0, 3.0, updates=5)
    terms = agent.update_rule.loss(agent.coming_chain(), task.states())[1]
    assert terms.objective.item() == pytest.approx(agent.evaluate().objective, abs=1e-5)


def test_tables_belong_to_the_state_and_rivals_to_seed_and_update():
    task = TableTask(UTILITIES, prior=PRIOR, observations="index")
    agent, other = (trained(task, 4, 2.0, 3.0, updates=15) for _ in range(2))
    assert agent.state_dict().keys() >= {"update_rule.rivals.log_action"}
    other.update_rule.rivals.log_action.zero_()
    other.load_state_dict(agent.state_dict())
    for _ in range(10):
        losses = [one.update_loss(task.states()) for one in (agent, other)]
        assert torch.equal(*losses)
        agent.updates = other.updates = agent.updates + 1
    elsewhere = trained(task, 4, 2.0, 3.0, updates=15, seed=1).state_dict()
    name = "update_rule.rivals.log_action"
    assert not torch.equal(elsewhere[name], agent.state_dict()[name])


def test_unknown_signals_are_refused():
    task = Hidden(UTILITIES, None)
    channels = Table(Discrete(3), Discrete(2)), Table(Discrete(2), Discrete(3))
    chain = Chain(task, *channels, RunningMarginals(), 1.0, 1.0)
    with pytest.raises(ValueError, match=r"rivals compete over known .* Hidden has not; leave"):
        Projection(rivals=Rivals()).check(chain)
    known = Chain(task.table, *channels, ExactMarginals(), 1.0, 1.0)
    Projection(rivals=Rivals()).check(known)


@pytest.mark.parametrize("name", ["count", "sweeps", "lead"])
def test_numbers_are_checked(name):
    with pytest.raises(ValueError, match=f"rivals {name} must be"):
        Rivals(**{name: 0})
