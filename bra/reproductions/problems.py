"""What was published, where, and how it comes out here."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from bra.blahut_arimoto import rate_distortion, serial
from bra.objective import bits
from bra.tasks import FiniteTask, Medical, PredatorPrey, Taxonomy


@dataclass(frozen=True)
class Value:
    """One number.

    Attributes:
        quantity: What it is.
        reference: The number that the problem's source gives; None where it prints a figure only.
        found: What comes out here.
        bound: What nothing exceeds, by a certificate; None for terms that are not bounded.
    """

    quantity: str
    reference: float | None
    found: float
    bound: float | None = None


@dataclass(frozen=True)
class Problem:
    """A decision with a published solution.

    Attributes:
        title: What it is about, in a line.
        source: Where the numbers stand.
        solve: Works them out.
    """

    title: str
    source: str
    solve: Callable[[], list[Value]]


GENEWEIN = (
    "Genewein, Leibfried, Grau-Moya & Braun, Front. Robot. AI 2:27 (2015); it prints figures, in "
    "units of its own"
)
HUNTING = {
    (8.0, 10.0): 3.27049,
    (8.0, 1.0): 2.54754,
    (1.0, 10.0): 2.5601,
    (1.0, 1.0): 2.04489,
}


def _chain(
    task: FiniteTask, percepts: int, published: dict[tuple[float, float], float | None]
) -> list[Value]:
    """J of both channels in series at pairs of prices."""
    beta_1, beta_2 = torch.tensor(list(published), dtype=torch.float64).T
    found = serial(task.utilities, task.prior, percepts, beta_1, beta_2)
    optima = zip(
        published.items(),
        torch.as_tensor(found.objective).tolist(),
        torch.as_tensor(found.tight_bound).tolist(),
        strict=True,
    )
    return [
        Value(f"J at β₁ {pair[0]:g}, β₂ {pair[1]:g}", known, here, bound)
        for (pair, known), here, bound in optima
    ]


def _channel(
    utilities: Tensor, prior: Tensor | None, beta: float, **published: float | None
) -> list[Value]:
    """J, E[U] and I(Ω;A) of one channel."""
    found = rate_distortion(utilities, prior, beta)
    here = {
        "J": (float(found.objective), float(found.upper_bound)),
        "E[U]": (float(found.expected_utility), None),
        "I(Ω;A) in bits": (bits(float(found.end_to_end_information)), None),
    }
    known = dict(zip(here, (published.get(name) for name in ("J", "utility", "rate")), strict=True))
    return [Value(name, known[name], *pair) for name, pair in here.items()]


def _safe_and_risky() -> list[Value]:
    """Matějka & McKay's closed form for the probability q of the risky action.

    Risky pays 1 or, with probability g, 0; safe pays R. Where q is neither 0 nor 1, the condition
    of an optimum E[e^{U(ω,risky)/λ} / Z(ω)] = 1 is, with v = e^{1/λ} and r = e^{R/λ},

        g / (q + (1 − q) r) + (1 − g) v / (q v + (1 − q) r) = 1,

    which is linear in q: q = r (v − r + g − g v) / ((v − r)(r − 1)).
    """
    values = []
    for cost, safe, nothing in ((0.4, 0.5, 0.5), (0.4, 0.5, 0.4), (0.2, 0.7, 0.5)):
        v, r = math.exp(1 / cost), math.exp(safe / cost)
        known = r * (v - r + nothing - nothing * v) / ((v - r) * (r - 1))
        table = torch.tensor([[0.0, safe], [1.0, safe]], dtype=torch.float64)
        prior = torch.tensor([nothing, 1 - nothing], dtype=torch.float64)
        found = rate_distortion(table, prior, 1 / cost)
        values.append(
            Value(
                f"P(risky) at λ {cost:g}, R {safe:g}, P(0) {nothing:g}",
                min(1.0, max(0.0, known)),
                found.action_marginal[0].item(),
            )
        )
    return values


def _consideration() -> list[Value]:
    """One of several goods is worth 1; with probability μ(a), in falling order, it is good a.

    With δ = e^β − 1 and S the sum of μ over the K likeliest goods, these are considered where
    μ(K)(K + δ) > S ≥ μ(K + 1)(K + δ), and

        p(a) = (μ(a)(K + δ) − S) / (δ S).
    """
    prior = torch.tensor([0.4, 0.3, 0.2, 0.07, 0.03], dtype=torch.float64)
    values = []
    for beta in (1.0, 2.0, 4.0):
        delta, sums = math.expm1(beta), prior.cumsum(0)
        size = next(k for k in range(5, 0, -1) if prior[k - 1] * (k + delta) > sums[k - 1])
        found = rate_distortion(torch.eye(5, dtype=torch.float64), prior, beta)
        chosen = (prior[0] * (size + delta) / sums[size - 1] - 1) / delta
        used = float((found.action_marginal > 1e-6).sum())
        values += [
            Value(f"goods considered at β {beta:g}", float(size), used),
            Value("  P(the likeliest)", chosen.item(), found.action_marginal[0].item()),
        ]
    return values


def _pricing() -> list[Value]:
    """A seller's price p for an elasticity (d + 1)/d of demand: U = p^{−(d+1)/d} (p − 1)."""
    demand = torch.linspace(1 / 9, 1 / 2, 50, dtype=torch.float64)[:, None]
    prices = torch.linspace(10 / 9, 3 / 2, 50, dtype=torch.float64)
    utilities = prices ** (-(demand + 1) / demand) * (prices - 1)
    found = rate_distortion(utilities, None, 1 / 0.00531)
    carried = float((found.action_marginal > 1e-6).sum())
    values = _channel(utilities, None, 1 / 0.00531, J=0.0920102, utility=0.0939004, rate=0.51356)
    return [*values, Value("prices that are set", 4.0, carried)]


def _lai_gershman() -> list[Value]:
    """Policy complexity and reward at β = 5."""
    identity = torch.eye(3, dtype=torch.float64) * 0.6 + 0.2
    skewed = torch.tensor([0.6, 0.2, 0.2], dtype=torch.float64)
    shared = torch.tensor([[1, 0.5, 0], [1, 0.5, 0], [0.5, 0, 1]], dtype=torch.float64)
    tasks = {
        "uniform": _channel(identity, None, 5.0, utility=0.7457, rate=1.0561),
        "skewed": _channel(identity, skewed, 5.0, rate=0.8421),
        "two states alike": _channel(shared, None, 5.0, utility=0.9688, rate=0.6081),
    }
    return [
        Value(f"{value.quantity}, {name}", value.reference, value.found, value.bound)
        for name, values in tasks.items()
        for value in values[1:]
    ]


def _gaussian() -> list[Value]:
    """Squared error of a normal quantity, of standard deviation 3, on 100 points of ±10."""
    points = torch.linspace(-10, 10, 100, dtype=torch.float64)
    prior = (-points.square() / 18).softmax(0)
    error = (points[:, None] - points).square()
    _, utility, rate = _channel(-error, prior, 1.0, rate=2.0776)
    return [Value("mean squared error", 0.4999, -utility.found), rate]


PROBLEMS = {
    "predator-prey": Problem(
        "nine animals to hunt, ambush or flee",
        f"{GENEWEIN}; numbers by an independent solver, nats",
        lambda: _chain(PredatorPrey(), 13, dict(HUNTING)),
    ),
    "mating": Problem(
        "the same animals, to be courted or fled from",
        GENEWEIN,
        lambda: _chain(PredatorPrey("mating"), 13, {(8.0, 10.0): None, (1.0, 1.0): None}),
    ),
    "medical": Problem(
        "six diseases and their treatments, through three percepts",
        GENEWEIN,
        lambda: _chain(Medical(), 3, {(8.0, 10.0): None, (1.0, 1.0): None}),
    ),
    "taxonomy": Problem(
        "thirteen customers, by item, class and half",
        GENEWEIN,
        lambda: _chain(Taxonomy(), 13, {(8.0, 10.0): None, (1.0, 1.0): None}),
    ),
    "safe-and-risky": Problem(
        "whether to look at a risky choice beside a safe one",
        "Matějka & McKay, American Economic Review 105 (2015), section 4: a closed form",
        _safe_and_risky,
    ),
    "consideration-sets": Problem(
        "who looks for the one good alternative considers the likely ones alone",
        "Caplin, Dean & Leahy, Review of Economic Studies 86 (2019): a closed form",
        _consideration,
    ),
    "pricing": Problem(
        "a seller who does not know demand sets few prices",
        "Matějka, Review of Economic Studies 83 (2016); on 50 × 50 points",
        _pricing,
    ),
    "policy-complexity": Problem(
        "reward against complexity of a policy at β = 5",
        "Lai & Gershman, Psychology of Learning and Motivation 74 (2021)",
        _lai_gershman,
    ),
    "gaussian": Problem(
        "absolute identification of a normal quantity at slope −1",
        "Sims, Cognition 152 (2016)",
        _gaussian,
    ),
}
