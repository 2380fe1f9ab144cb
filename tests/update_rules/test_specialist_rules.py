"""Rules that train actions which look at the signal again."""

import math
from dataclasses import replace
from functools import partial

import pytest
import torch
from gymnasium.spaces import Discrete
from specialists_by_hand import (
    PRICES,
    Hidden,
    chain_of,
    exact_terms,
    make_chain,
)

from bra import blahut_arimoto
from bra.channels import CNN, MLP, Gaussian, Multinomial, Table
from bra.channels.distributions import log_probabilities
from bra.marginals import BatchMarginals, RunningMarginals
from bra.objective import table_objective
from bra.tasks import Medical, PredatorPrey, TargetTask, World
from bra.update_rules import ExactGradient, Projection, ScoreFunction
from bra.update_rules.sweeps import sweep_looks
from bra.update_rules.targets import project, project_looks


def gradient(loss, chain):
    parameters = [*chain.perception.parameters(), *chain.action.parameters()]
    return torch.cat([g.flatten() for g in torch.autograd.grad(loss, parameters)]).double()


CHAINS = {
    "tables": (Table, Table),
    "network and multinomial": (partial(MLP, hidden=[4]), Multinomial),
    "networks": (partial(MLP, hidden=[4]), partial(MLP, hidden=[4]), "vector"),
    "convolutions": (partial(CNN, channels=[2]), partial(CNN, channels=[2]), "image"),
    "gaussian actions": (Table, Gaussian, "index", True),
}


@pytest.mark.parametrize("name", CHAINS)
def test_score_function_follows_the_gradient_of_j(name):
    # 100 batches of 2000 against autograd: six standard errors in at most 120 coordinates, failure
    # probability 4e-6 per chain (Student's t).
    chain = make_chain(*CHAINS[name])
    expected = gradient(-exact_terms(chain).objective, chain)
    generator = torch.Generator().manual_seed(0)
    torch.manual_seed(0)
    gradients = torch.stack(
        [
            gradient(ScoreFunction().loss(chain, chain.task.sample(2000, generator))[0], chain)
            for _ in range(100)
        ]
    )
    error = gradients.std(0) / 10
    assert expected.norm() > 8 * error.norm()
    difference = (gradients.mean(0) - expected).abs()
    assert (difference < 6 * error + 1e-5).all(), (difference / error).max()


@pytest.mark.parametrize("name", ["tables", "gaussian actions"])
def test_sampled_terms_are_the_expected_ones(name):
    # 100 000 encounters, standard deviations below 2.5: six standard errors are 0.05.
    chain = make_chain(*CHAINS[name])
    torch.manual_seed(0)
    world = chain.task.sample(100_000, torch.Generator().manual_seed(0))
    terms = ScoreFunction().loss(chain, world)[1].item()
    exact = exact_terms(chain).detach().item()
    assert terms.direct_information > 0.05
    for term, value in terms.known().items():
        assert value == pytest.approx(getattr(exact, term), abs=0.05), term


@pytest.mark.parametrize("rule", [ScoreFunction(), ExactGradient(), Projection()])
def test_the_loss_comes_with_all_terms_of_j(rule):
    chain = make_chain()
    world = chain.task.sample(50, torch.Generator().manual_seed(0))
    terms = rule.loss(chain, world)[1].detach().item()
    costs = (terms.perception_information, terms.action_information, terms.direct_information)
    spent = sum(cost / beta for cost, beta in zip(costs, PRICES, strict=True))
    assert terms.objective == pytest.approx(terms.expected_utility - spent, abs=1e-5)


def test_projection_over_a_batch_of_all_states_is_that_over_known_ones():
    known = make_chain()
    hidden = chain_of(Hidden(), Table, Table, BatchMarginals())
    states = torch.tensor([0] * 5 + [1] * 3 + [2] * 2)
    losses = [Projection().loss(chain, World(states, states)) for chain in (known, hidden)]
    for one, other in zip(*(terms.item().known().values() for _, terms in losses), strict=True):
        assert one == pytest.approx(other, abs=1e-5) or other is None
    one, other = (
        gradient(loss, chain) for (loss, _), chain in zip(losses, (known, hidden), strict=True)
    )
    torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-6)


def test_running_averages_of_the_shared_action_by_hand():
    chain = chain_of(Hidden(), Table, Table, RunningMarginals(decay=0.9))
    batches = [torch.tensor(states) for states in ([0, 1], [2, 2], [1, 0])]
    total, weight = torch.zeros(3, 3), torch.zeros(3, 1)
    for batch in batches:
        percepts = chain.perception(batch).probs.detach()
        look = chain.second_look(batch).probs.detach()
        total = 0.9 * total + 0.1 * torch.einsum("bx,xba->xa", percepts, look) / 2
        weight = 0.9 * weight + 0.1 * percepts.mean(0)[:, None]
        found = chain.shared_action(batch)
        torch.testing.assert_close(found.probs, total / weight)


def test_running_averages_belong_to_the_state_and_to_looks_alone():
    percepts = Discrete(3)
    plain, looking = RunningMarginals(), RunningMarginals()
    for marginals in (plain, looking):
        marginals.check(Hidden(), percepts)
    looking.check_looks(Hidden(), percepts)
    assert [*plain.state_dict()] == ["average"]
    assert looking.state_dict()["shared"].shape == (3, 3)
    task = TargetTask([[0.0], [1.0]])
    with pytest.raises(ValueError, match="need Discrete actions that look again, got Box"):
        looking.check_looks(task, percepts)


def random_problem(seed):
    generator = torch.Generator().manual_seed(seed)
    states, percepts, actions = (int(n) for n in torch.randint(2, 8, (3,), generator=generator))
    kind = {"generator": generator, "dtype": torch.float64}
    utilities, weights = torch.randn(states, actions, **kind), torch.rand(states, **kind)
    beta_1, beta_2 = (0.3 * 60 ** torch.rand(2, **kind)).tolist()
    beta_3 = torch.rand((), **kind).item() / (1 / beta_1 + 1 / beta_2)
    start = torch.randn(percepts, actions, **kind).log_softmax(-1)
    return utilities, weights / weights.sum(), start, beta_1, beta_2, beta_3


@pytest.mark.parametrize("seed", range(10))
def test_sweeps_never_lower_j_and_say_what_it_is(seed):
    utilities, prior, log_action, *betas = random_problem(seed)
    log_marginal = torch.full(log_action.shape[:1], 1 / len(log_action)).double().log()
    before = -torch.inf
    for _ in range(30):
        found = sweep_looks(log_action, log_marginal, prior.log(), utilities, *betas)
        terms = table_objective(
            prior, found.log_percept.exp(), found.log_look.exp(), utilities, *betas
        )
        assert before - 1e-10 <= found.objective <= terms.objective + 1e-12
        torch.testing.assert_close(found.log_marginal.exp(), prior @ found.log_percept.exp())
        before = found.objective
        log_action, log_marginal = found.log_action, found.log_marginal


@pytest.mark.parametrize("prices", [(8.0, 10.0, 3.0), (2.5, math.inf, 1.0), (8.0, 2.0, 1.0)])
def test_sweeps_end_where_the_solver_does(prices):
    task = Medical("heart-heavy")
    best = blahut_arimoto.general(task.utilities, task.prior, 3, *prices, budget=32)
    found = sweep_looks(
        best.action_given_percept.clamp(min=1e-25).log(),
        best.percept_marginal.log(),
        task.prior.log(),
        task.utilities,
        *prices,
    )
    assert found.objective == pytest.approx(best.objective, abs=1e-7)
    torch.testing.assert_close(found.log_action.exp(), best.action_given_percept, atol=1e-4, rtol=0)


def test_near_the_serial_limit_sweeps_are_as_quick_as_serial_ones():
    task = PredatorPrey()
    torch.manual_seed(0)
    action, marginal = torch.randn(5, 9).double().log_softmax(-1), torch.full((5,), 0.2).double()
    marginal = marginal.log()
    for _ in range(200):
        found = sweep_looks(action, marginal, task.prior.log(), task.utilities, 8.0, 10.0, 1e-3)
        action, marginal = found.log_action, found.log_marginal
    assert (action.exp().amax(-1) > 0.9).any()


def test_near_the_serial_limit_specialists_go_far_towards_where_serial_actions_aim():
    task, chain = PredatorPrey(), replace(make_chain(), beta_action=0.3, beta_direct=1e-4)
    prior, kind = task.prior, {"generator": torch.Generator().manual_seed(0), "dtype": torch.double}
    log_percept = torch.randn(9, 5, **kind).log_softmax(-1)
    log_joint = prior.log().unsqueeze(-1) + log_percept
    log_marginal = log_joint.logsumexp(0)
    value = (log_joint - log_marginal).exp().T @ task.utilities
    shared = torch.randn(5, 9, **kind).mul(0.2).log_softmax(-1)
    look, tables = shared.unsqueeze(1).expand(-1, 9, -1), (prior.log(), log_percept)
    serial = project(chain, *tables, shared, log_marginal, task.utilities, value)
    found = project_looks(chain, *tables, look, log_marginal, shared, task.utilities)
    whole, way = serial.action - shared.exp(), found.action.mean(1) - shared.exp()
    assert 0.2 < (way * whole).sum() / whole.square().sum() < 1


def test_log_probabilities_of_looks_have_the_order_of_conditions():
    chain = make_chain()
    rows = log_probabilities(chain.second_look(chain.task.observations))
    assert rows.shape == (3, 3, 3)
    torch.testing.assert_close(rows[1, 2], chain.action.logits[1 * 3 + 2].log_softmax(-1))
