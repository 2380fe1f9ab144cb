"""Branch and bound over action marginals: true bounds that close."""

import itertools
import time

import numpy as np
import pytest
import torch
from problems import IDENTITY, MUGS, PREDATOR_PREY

from bra.blahut_arimoto import serial
from bra.blahut_arimoto.action_boxes import interchangeable, secant
from bra.blahut_arimoto.certificate import certify_gap
from bra.blahut_arimoto.concave_envelope import Landscape
from bra.blahut_arimoto.reduction import reduced
from bra.blahut_arimoto.simplex_covers import Covers


def proved(utilities, prior, betas, below, nodes, bound=None):
    """The bound after a number of boxes, in units of the problem, from a J that is attained."""
    table = torch.as_tensor(np.array(utilities), dtype=torch.double)
    p = torch.full((len(table),), 1 / len(table)).double() if prior is None else prior
    prices = (torch.tensor([beta], dtype=torch.double) for beta in betas)
    problem = reduced(table, torch.as_tensor(p), len(table), *prices)
    inside = (value - problem.offset.item() for value in (below, bound or below + 0.3))
    units = [value / problem.unit for value in inside]
    certificate = certify_gap(problem, *units, 60.0, nodes)
    return problem.value(torch.tensor(certificate.bound)).item()


def drawn(seed):
    """Utilities with forbidden and repeated entries, skewed priors, prices far and near."""
    rng = np.random.default_rng(seed)
    states, actions, percepts = (int(n) for n in rng.integers([1, 1, 1], [6, 6, 7]))
    utilities = rng.normal(size=(states, actions)) * 10 ** rng.uniform(-1, 1)
    if seed % 3 == 0:
        utilities = utilities.round()
    if seed % 4 == 0:
        utilities[:, 1:][rng.random((states, actions - 1)) < 0.2] = -np.inf
    prior = rng.dirichlet(np.full(states, 0.5)) if seed % 2 else np.full(states, 1 / states)
    return utilities, prior, percepts, *(10 ** rng.uniform(-1.5, 1.5, 2))


def check_random(seed, seconds):
    utilities, prior, percepts, *betas = drawn(seed)
    found = serial(utilities, prior, percepts, *betas, restarts=8, budget=16, certify=seconds)
    regret = max(1.0, abs(found.objective))
    assert found.bound >= found.objective - 1e-12 * regret
    full = serial(utilities, prior, 6, *betas, restarts=16, budget=32, seed=1)
    assert found.upper_bound >= full.objective - 1e-12 * regret
    assert found.bound == found.tight_bound <= found.upper_bound


@pytest.mark.parametrize("seed", range(20))
def test_never_below_the_best_known(seed):
    check_random(seed, 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20, 1000))
def test_never_below_the_best_known_of_many(seed):
    check_random(seed, 0.5)


@pytest.mark.parametrize(
    ("shape", "seed"),
    [((2, 2), 0), ((2, 2), 1), ((3, 3), 2), pytest.param((3, 3), 3, marks=pytest.mark.slow)],
)
def test_brute_force_with_two_percepts(shape, seed):
    """Perception on a grid, and the best action channel for it after many Blahut-Arimoto steps."""
    rng = np.random.default_rng(seed)
    utilities, betas = 2 * rng.normal(size=shape), rng.uniform(1, 4, 2)
    prior = rng.dirichlet(np.ones(shape[0]))
    grid = np.linspace(0, 1, 41 if shape[0] == 2 else 21)
    first = np.array(list(itertools.product(grid, repeat=shape[0])))
    channel = np.stack((first, 1 - first), 2)
    joint = prior[:, None] * channel
    percept = joint.sum(1)
    worth = joint.swapaxes(1, 2) @ utilities / np.maximum(percept, 1e-300)[..., None]
    q = np.full((len(first), shape[1]), 1 / shape[1])
    for _ in range(300):
        weights = q[:, None] * np.exp(betas[1] * (worth - worth.max(2, keepdims=True)))
        action = weights / weights.sum(2, keepdims=True)
        q = (percept[..., None] * action).sum(1)

    def divergence(p, reference):
        ratio = np.where(p > 0, p, 1) / np.where(p > 0, np.maximum(reference, 1e-300), 1)
        return (p * np.log(ratio)).sum(-1)

    cost_1 = (prior * divergence(channel, percept[:, None])).sum(1) / betas[0]
    cost_2 = (percept * divergence(action, q[:, None])).sum(1) / betas[1]
    value = ((percept[..., None] * action * worth).sum((1, 2)) - cost_1 - cost_2).max()
    found = serial(utilities, prior, shape[0], *betas, certify=2.0)
    assert found.bound >= value - 1e-12
    assert found.closed
    assert found.bound - found.objective <= 2e-3


@pytest.mark.parametrize(
    ("betas", "optimum", "nodes"), [((1, 10), 2.56010, 200), ((8, 10), 3.27049, 200)]
)
def test_predator_prey_closes(betas, optimum, nodes):
    bound = proved(PREDATOR_PREY, None, betas, optimum - 1e-5, nodes)
    assert optimum - 1e-5 <= bound <= optimum + 2e-3


def test_bounds_only_fall_with_more_boxes():
    bounds = [proved(PREDATOR_PREY, None, (1, 1), 2.04489, nodes) for nodes in (1, 50, 300, 900)]
    assert bounds == sorted(bounds, reverse=True)
    assert bounds[-1] < 2.2


@pytest.mark.parametrize("betas", [(1e-6, 1e6), (1e6, 1e-6), (1e-9, 1e-9), (1e12, 1e12), (1e7, 2)])
@pytest.mark.parametrize("utilities", [IDENTITY, MUGS, [[0.0, -np.inf, 2e9], [1, 3, -1e9]]])
def test_prices_and_utilities_of_any_size(utilities, betas):
    found = serial(utilities, None, 4, *betas, restarts=4, budget=8, certify=0.05)
    assert np.isfinite(found.bound)
    assert found.bound >= found.objective - 1e-9 * max(1, abs(found.objective))


def test_one_state_and_one_action():
    one = serial([[1.0, 3.0]], None, 1, 1.0, 1.0, certify=1.0)
    assert one.bound == pytest.approx(3.0)
    assert one.closed
    one = serial([[1.0], [3.0]], None, 2, 1.0, 1.0, certify=1.0)
    assert one.bound == pytest.approx(2.0)
    assert one.closed
    assert one.nodes == 0


def test_few_percepts_keep_the_capacity():
    plain = serial(PREDATOR_PREY, None, 2, 8.0, 10.0)
    found = serial(PREDATOR_PREY, None, 2, 8.0, 10.0, certify=0.2)
    assert found.objective <= found.bound <= plain.tight_bound
    assert not found.closed


def test_without_certify_nothing_changes():
    found = serial(PREDATOR_PREY, None, 13, 1.0, 1.0)
    assert found.nodes == 0
    assert not found.closed
    assert found.upper_bound == pytest.approx(2.33075, abs=5e-6)


def test_time_is_kept():
    began = time.monotonic()
    plain = serial(np.random.default_rng(0).normal(size=(30, 30)), None, 30, 3.0, 3.0, budget=1)
    solved = time.monotonic() - began
    table = np.random.default_rng(0).normal(size=(30, 30))
    found = serial(table, None, 30, 3.0, 3.0, budget=1, certify=0.2)
    assert time.monotonic() - began < 2 * solved + 5
    assert found.objective <= found.bound <= plain.bound


@pytest.mark.parametrize("seconds", [-1, 0, float("nan"), float("inf"), "5", True, [1]])
def test_seconds_that_are_none(seconds):
    with pytest.raises(ValueError, match="certify must be a positive number of seconds, got"):
        serial(IDENTITY, None, 2, 1.0, 1.0, certify=seconds)


def test_several_prices_are_refused():
    with pytest.raises(ValueError, match="certify takes one pair of prices, got 2"):
        serial(IDENTITY, None, 2, [1.0, 2.0], 1.0, certify=1.0)


def test_secants_lie_below_the_entropy():
    low, high = np.array([0.0, 0.1, 0.5, 0.3]), np.array([1.0, 0.2, 1.0, 0.3 + 1e-12])
    slope, intercept = secant(low, high)
    for t in np.linspace(0, 1, 11):
        q = low + t * (high - low)
        entropy = -q * np.log(np.maximum(q, 1e-300))
        assert (slope * q + intercept <= entropy + 1e-12).all()


def test_interchangeable_actions():
    assert interchangeable(np.eye(4), np.full(4, 0.25)) == [[0, 1, 2, 3]]
    assert interchangeable(np.eye(3), np.array([0.25, 0.5, 0.25])) == [[0, 2]]
    assert interchangeable(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([0.5, 0.5])) == []
    prey = np.array(PREDATOR_PREY)[:, [0, 1, 2, 6, 7, 8]]
    assert interchangeable(prey, np.full(9, 1 / 9)) == [[0, 1, 2]]


def heights(landscape, grid, linear, weights):
    """F at the points of a grid."""
    entropy = (grid * np.log(np.maximum(grid, 1e-300))).sum(1)
    convex, _ = landscape.softmax(grid, weights)
    return convex + grid @ linear - landscape.entropy_price * entropy


@pytest.mark.parametrize("seed", range(8))
def test_the_envelope_bounds_a_fine_grid(seed):
    """From the whole simplex, and from the cells that other c and g left."""
    rng = np.random.default_rng(seed)
    landscape = Landscape(4 * rng.normal(size=(3, 4)), rng.uniform(0.2, 2), rng.uniform(0.5, 4))
    covers = Covers(landscape)
    grid = np.array([(i, j, 60 - i - j) for i in range(61) for j in range(61 - i)]) / 60
    linear, weights = rng.normal(size=(1, 3)), rng.normal(size=(1, 4))
    cover = [covers.simplex]
    for change in (0.0, 0.01, 0.1, 1.0):
        linear = linear + change * rng.normal(size=(1, 3))
        weights = weights + change * rng.normal(size=(1, 4))
        values = heights(landscape, grid, linear[0], weights[0])
        enough = np.array([values.max() + 1e-2])
        found = covers.largest(linear, weights, cover, enough, 10_000, time.monotonic() + 10)
        cover = covers.forget(found.covers)
        assert found.bound[0] >= values.max() - 1e-12
        assert found.bound[0] >= found.value[0] - 1e-12
        assert found.bound[0] <= enough[0]


@pytest.mark.parametrize("seed", range(8))
def test_cells_bound_what_they_hold_for_other_weights(seed):
    rng = np.random.default_rng(seed)
    landscape = Landscape(3 * rng.normal(size=(4, 5)), rng.uniform(0.2, 2), rng.uniform(0.5, 4))
    covers = Covers(landscape)
    linear, weights = rng.normal(size=(1, 4)), rng.normal(size=(1, 5))
    enough, deadline = np.array([-10.0]), time.monotonic() + 10
    found = covers.largest(linear, weights, [covers.simplex], enough, 50, deadline)
    known = covers.cells(found.covers[0])
    points = np.einsum("pk,nkj->npj", rng.dirichlet(np.full(4, 0.5), 200), known.vertices)
    for change in (0.0, 0.1, 1.0, 10.0):
        c = linear[0] + change * rng.normal(size=4)
        g = weights[0] + change * rng.normal(size=5)
        count = len(known.bound)
        bounds = known.transferred(
            np.tile(c, (count, 1)), np.tile(g, (count, 1)), landscape.sharpness
        )
        inside = [heights(landscape, some, c, g).max() for some in points]
        assert (bounds >= np.array(inside) - 1e-12).all()
