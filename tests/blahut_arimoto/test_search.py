"""How many starts a search makes, and where they come from."""

import numpy as np
import pytest
import torch
from problems import MUGS, PREDATOR_PREY, random_problem

from bra.blahut_arimoto import general, serial
from bra.blahut_arimoto.starts import agglomerated


def hard_problem():
    rng = np.random.default_rng(3)
    return rng.standard_normal((18, 12)), rng.dirichlet(np.ones(18)), 5, 7.0, 12.0


def test_an_easy_problem_makes_one_batch():
    found = serial(PREDATOR_PREY, None, 13, 8.0, 10.0)
    assert found.starts == len(found.optima) == 32
    assert found.hits == (found.optima > found.objective - 1e-8).sum() >= 16


def test_a_hard_problem_makes_more_until_the_budget_is_used_up():
    few, some, many = (serial(*hard_problem(), budget=n) for n in (32, 80, None))
    assert (few.starts, some.starts, many.starts) == (32, 80, 512)
    assert few.objective <= some.objective <= many.objective
    assert 1 <= few.hits < 16
    assert torch.equal(many.optima[:32], few.optima)
    best = many.objective
    assert many.optima.max().item() == pytest.approx(best, abs=1e-10)
    # Moves away from the best that come back are no hits.
    assert many.hits <= (many.optima > best - 1e-8).sum()


@pytest.mark.slow
def test_large_problems_have_smaller_budgets():
    utilities, prior = random_problem(200, 200, seed=1)
    assert serial(utilities, prior, 40, 1e3, 1e3, restarts=16).starts <= 64


@pytest.mark.parametrize(("solver", "third"), [(serial, ()), (general, (1.0,))])
def test_long_searches_log_their_progress(monkeypatch, caplog, solver, third):
    for part in ("search", "climb"):
        monkeypatch.setattr(f"bra.blahut_arimoto.{part}.SILENCE", 0.0)
    with caplog.at_level("INFO", logger="bra.blahut_arimoto"):
        solver(*hard_problem(), *third, restarts=8, budget=16)
    assert caplog.messages == [
        f"{solver.__name__}: 8 of 8 climbs of this batch are done",
        f"{solver.__name__}: 8 of 8 climbs of this batch are done",
        f"{solver.__name__}: 16 of at most 16 starts",
    ]


def test_pairs_of_prices_need_different_numbers_of_starts():
    utilities, prior, percepts, *betas = hard_problem()
    prices = [[0.01, betas[0]], [0.01, betas[1]]]
    found = serial(utilities, prior, percepts, *prices, restarts=8, budget=24)
    assert found.starts.tolist() == [8, 24]
    assert found.optima[0, 8:].isnan().all()
    assert found.hits[0] == 8
    alone = serial(utilities, prior, percepts, *betas, restarts=8, budget=24)
    torch.testing.assert_close(found.optima[1], alone.optima, atol=1e-8, rtol=0)


def test_where_the_best_single_action_meets_the_bound_no_start_leaves_it():
    found = serial(MUGS, None, 4, 0.3, 0.3)
    assert found.objective == found.tight_bound == 2.75
    assert found.hits == found.starts == 32


def test_agglomeration_joins_states_that_respond_alike():
    rows = torch.eye(3, dtype=torch.double)[[0, 1, 0, 2, 1, 0]]
    channel = (20 * rows + torch.linspace(0, 1, 18).view(6, 3)).softmax(1)[None]
    prior = torch.full((6,), 1 / 6, dtype=torch.double)
    groups = agglomerated(channel, prior, torch.tensor([3]), 3)[0]
    assert torch.equal(groups.sum(1), torch.ones(6, dtype=torch.double))
    assert torch.equal(groups @ groups.T, rows @ rows.T)
    uneven = torch.tensor([0.3, 0.3, 0.3, 1e-6, 0.05, 0.05]).double()
    two = agglomerated(channel, uneven, torch.tensor([2]), 2)[0]
    assert two[0, 0] != two[1, 0]
    copied = agglomerated(channel, prior, torch.tensor([3]), 5)[0]
    assert torch.equal(copied, groups[:, [0, 1, 2, 0, 1]])


@pytest.mark.parametrize("seed", range(5))
def test_ward_merges_the_cheapest_two(seed):
    """As by trying all pairs of groups, each time anew."""
    rng = np.random.default_rng(seed)
    channel, prior = rng.dirichlet(np.full(4, 0.5), 12), rng.dirichlet(np.ones(12))
    groups = [[state] for state in range(12)]

    def spread(members):
        mean = prior[members] @ np.sqrt(channel[members]) / prior[members].sum()
        return prior[members] @ np.square(np.sqrt(channel[members]) - mean).sum(1)

    while len(groups) > 4:
        pairs = [(i, j) for i in range(len(groups)) for j in range(i)]
        first, second = min(
            pairs,
            key=lambda pair: (
                spread(groups[pair[0]] + groups[pair[1]])
                - spread(groups[pair[0]])
                - spread(groups[pair[1]])
            ),
        )
        groups[second] += groups.pop(first)
    tables = torch.as_tensor(channel)[None], torch.as_tensor(prior)
    found = agglomerated(*tables, torch.tensor([4]), 4)[0]
    merged = {tuple(column.nonzero().flatten().tolist()) for column in found.T}
    assert merged == {tuple(sorted(members)) for members in groups}


def test_results_can_be_differentiated_through():
    found = serial(PREDATOR_PREY, None, 3, 8.0, 10.0, restarts=2, budget=2)
    weights = torch.ones(9, 9, dtype=torch.double, requires_grad=True)
    (weights * found.action_given_state).square().sum().backward()
    assert weights.grad is not None
