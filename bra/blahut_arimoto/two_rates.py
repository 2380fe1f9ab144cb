"""Two channels in series at given rates: the most that so much perception and action can earn.

A budget B₁ of I(Ω;X) or B₂ of I(X;A) takes the place of a price. With prices λᵢ = 1/βᵢ for the
budgets, and J*(λ) the optimum of `serial` at these prices, no channels within the budgets, nor any
that share time so that their mean rates keep to them, earn more than

    D(λ) = J*(λ) + λ₁ B₁ + λ₂ B₂        for every λ ≥ 0:

if they have the rates Iᵢ ≤ Bᵢ, what they earn is J(λ) + λ₁ I₁ + λ₂ I₂ ≤ J*(λ) + λ₁ B₁ + λ₂ B₂,
and means keep the inequality. A certified bound on J* in its place makes one on D. As a maximum of
functions linear in λ, D is convex, and its least value is, by strong duality of a linear program,
what the best time sharing between channels earns.

So prices are found by column generation: the linear program of time sharing between all optima met
so far (its columns) has dual prices, `serial` is solved there, and its optimum is a further column,
until it is no better than what is known. The solution is one pair of channels where D has a unique
optimum. Where the rates jump, at a first-order transition, no price has the rates between, and up
to three optima at the same prices share the time.
"""

import math
import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import torch
from torch import Tensor

from bra.blahut_arimoto.results import AtRates, Serial, per_price
from bra.blahut_arimoto.solution import Effort, solve_serial
from bra.checks.arrays import Array
from bra.checks.prices import check_beta, check_price_or_budget, check_rate

GRID = (1e-2, 1.0, 10.0, 100.0)
"""Prices β to begin with, per what information can earn."""
FREE = 1e9
"""β, in the same unit, at which information costs nothing."""
CLOSE = 1e-11
"""Share of what information can earn from which a further optimum is better."""
MOST_STEPS, MOST_COLUMNS = 60, 32
FIRST = 2
"""Batches of starts for each pair of prices, until these lead to nothing better."""
NO_SHARE = 1e-7
ROUNDING = 1e-9
"""Below zero that a share may come out."""
INFORMATIONS = ("perception_information", "action_information")
JUMP = 1e-3
"""Nats by which rates of different optima differ."""


@dataclass(frozen=True)
class _Columns:
    """Optima at n pairs of prices."""

    prices: Tensor  # λ₁, λ₂, (n, 2)
    ends: tuple[Serial, ...]  # n

    def each(self, name: str) -> Tensor:
        """An entry of all, (n,)."""
        return torch.tensor([getattr(end, name) for end in self.ends], dtype=torch.float64)

    @property
    def rates(self) -> Tensor:
        """I(Ω;X), I(X;A), (n, 2)."""
        return torch.stack([self.each(name) for name in INFORMATIONS], 1)

    def beside(self, other: "_Columns") -> "_Columns":
        return _Columns(torch.cat((self.prices, other.prices)), self.ends + other.ends)

    def take(self, index: Tensor) -> "_Columns":
        return _Columns(self.prices[index], tuple(self.ends[i] for i in index.tolist()))


@dataclass(frozen=True)
class _Shared:
    """Optimal time sharing between n columns."""

    shares: Tensor  # (n,)
    duals: Tensor  # λ, those of the problem where it has some, (2,)
    level: float  # what no column exceeds in worth − λ·rate where there are budgets


@dataclass(frozen=True)
class RateProblem:
    """The chain Ω → X → A with a budget for one of its channels, or for both.

    Attributes:
        utilities: U(ω,a), (W, A).
        prior: p(ω), (W,).
        effort: Of each search.
        prices: λ₁ and λ₂, (2,); of no meaning where there is a budget.
        budgets: B₁ and B₂ in nats, (2,); of no meaning where there is a price.
        limited: Which have a budget, (2,).
    """

    utilities: Tensor
    prior: Tensor
    effort: Effort
    prices: Tensor
    budgets: Tensor
    limited: Tensor

    @classmethod
    def of(
        cls,
        utilities: Tensor,
        prior: Tensor,
        effort: Effort,
        betas: tuple[float | Array | None, float | Array | None],
        bits: tuple[float | None, float | None],
    ) -> Self:
        """The problem of people's prices and budgets.

        Raises:
            ValueError: If a channel does not have one of both, a single admissible number.
        """
        prices, budgets = [], []
        for channel, beta, limit in zip(("perception", "action"), betas, bits, strict=True):
            check_price_or_budget(beta, limit, channel)
            if beta is None and limit is None:
                raise ValueError(
                    f"give beta_{channel}, a price, or {channel}_bits, a budget; got neither"
                )
            prices.append(1 / check_beta(beta, f"beta_{channel}") if limit is None else 0.0)  # type: ignore[arg-type]  # it looks
            given = 0.0 if limit is None else check_rate(limit, f"{channel}_bits")
            budgets.append(given * math.log(2))
        limited = torch.tensor([limit is not None for limit in bits])
        rows = torch.tensor([prices, budgets], dtype=torch.float64)
        problem = cls(utilities, prior, effort, rows[0], rows[1], limited)
        none = limited & (rows[1] == 0)  # any price that is too high leads there
        too_high = torch.where(none, FREE * problem.stake, problem.prices)
        return replace(problem, prices=too_high, limited=limited & ~none)

    @cached_property
    def stake(self) -> float:
        """What information can earn; the range of utilities where every action may fail."""
        earned = self.prior @ self.utilities.amax(1) - (self.prior @ self.utilities).amax()
        finite = self.utilities[self.utilities.isfinite()]
        return min(earned.item(), (finite.amax() - finite.amin()).item()) or 1.0

    def solve(self, prices: Tensor, effort: Effort) -> _Columns:
        """Optima at prices λ (n, 2), those of the problem where it has some."""
        prices = torch.where(self.limited, prices, self.prices).clamp(min=self.stake / FREE)
        with warnings.catch_warnings():  # the end says whether it converged
            warnings.filterwarnings("ignore", "serial: .*did not converge")
            terms = solve_serial(self.utilities, self.prior, effort, *(1 / prices).T)
        ends = [
            Serial(**{n: per_price(term[i : i + 1], torch.Size()) for n, term in terms.items()})
            for i in range(len(prices))
        ]
        return _Columns(prices, tuple(ends))

    def worth(self, columns: _Columns) -> Tensor:
        """E[U] less what costs its price, (n,)."""
        return columns.each("expected_utility") - columns.rates @ torch.where(
            self.limited, 0.0, self.prices
        )

    def gain(self, columns: _Columns, shared: _Shared) -> Tensor:
        """What each column has more, at the dual prices, than those that share the time, (n,)."""
        costs = (columns.rates * shared.duals)[:, self.limited].sum(1)
        return self.worth(columns) - costs - shared.level

    def bound(self, columns: _Columns) -> float:
        """The least D(λ), for J* its certified bound."""
        extra = (columns.prices * self.budgets)[:, self.limited].sum(1)
        return (columns.each("tight_bound") + extra).amin().item()

    def share(self, columns: _Columns) -> _Shared:
        """Time sharing w ≥ 0, Σ w = 1, of the largest Σ w worth with Σ w rates ≤ budgets.

        A vertex of the linear program has as many basic variables as constraints, counting what is
        left of each budget: few enough to try all. The optimal one is where no column gains.

        Raises:
            ValueError: If no time sharing keeps to the budgets.
        """
        count, limits = len(columns.ends), int(self.limited.sum())
        rates = torch.cat((columns.rates[:, self.limited], torch.eye(limits).double()))
        unity = torch.cat((torch.ones(count), torch.zeros(limits))).double()
        table = torch.cat((rates, unity[:, None]), 1)  # (n + m, m + 1)
        worth = torch.cat((self.worth(columns), torch.zeros(limits).double()))
        basis = torch.combinations(torch.arange(len(table)), limits + 1)
        inverse, info = torch.linalg.inv_ex(table[basis].mT)
        target = torch.cat((self.budgets[self.limited], torch.ones(1).double()))
        weights = inverse @ target
        duals = (worth[basis][:, None] @ inverse).squeeze(1)
        gains = (worth - duals @ table.T).amax(1)
        feasible = (info == 0) & (weights >= -ROUNDING).all(1) & gains.isfinite()
        if not feasible.any():
            raise ValueError(
                "budgets so small leave no channels that never take a forbidden action; give more "
                "bits, or large negative utilities instead of -inf"
            )
        best = int(torch.where(feasible, gains, math.inf).argmin())
        shares = torch.zeros(len(table)).double().index_add(0, basis[best], weights[best])
        prices = self.prices.clone()
        prices[self.limited] = duals[best, :-1].clamp(min=0.0)
        shares = torch.where(shares > NO_SHARE, shares, 0.0)[:count]
        return _Shared(shares / shares.sum(), prices, duals[best, -1].item())


def at_rates(problem: RateProblem) -> AtRates:
    """The optimum of a problem, see there, and its bound, certified in the end if it is to be.

    Raises:
        ValueError: If no channels within the budgets avoid the forbidden actions.
    """
    unit, limited = problem.stake, problem.limited
    full = problem.effort._replace(certify=None)
    first = FIRST * full.restarts
    effort = full._replace(budget=min(full.budget or first, first))
    one = unit / torch.tensor([*GRID, FREE], dtype=torch.float64)
    grid = torch.where(limited, torch.cartesian_prod(one, one), problem.prices)
    columns = problem.solve(torch.unique(grid, dim=0), effort)
    bound = problem.bound(columns)
    for _ in range(MOST_STEPS):
        shared = problem.share(columns)
        # Where nothing jumps, prices that rates lead to, as straight as they are between columns.
        straight = shared.shares @ columns.prices
        found = problem.solve(torch.stack((shared.duals, straight)), effort)
        bound = min(bound, problem.bound(found))
        better = (problem.gain(found, shared) > CLOSE * unit).any()
        if not better and effort == full:
            break
        effort = effort if better else full
        best = problem.gain(columns, shared).argsort(descending=True)[:MOST_COLUMNS]
        columns = columns.take(best).beside(found)
    ends, shares = _ends(columns, shared.shares)
    prices = shared.duals
    if len(ends) == 1:
        ends, prices = [found.ends[1]], torch.where(prices > 0, straight, prices)
    if better or not all(end.converged for end in ends):
        warnings.warn("serial: the search for prices did not converge", stacklevel=3)
    if problem.effort.certify is not None:
        bound = min(bound, problem.bound(problem.solve(shared.duals[None], problem.effort)))
    return _result(problem, prices, ends, shares, bound)


def _ends(columns: _Columns, shares: Tensor) -> tuple[list[Serial], list[float]]:
    """The most used ones of columns with the same rates, and the shares (n,) of all of these."""
    ends: dict[int, float] = {}
    rates = columns.rates
    for index in shares.argsort(descending=True).tolist():
        if share := shares[index].item():
            near = (i for i in ends if (rates[i] - rates[index]).abs().amax() < JUMP)
            first = next(near, index)
            ends[first] = ends.get(first, 0.0) + share
    return [columns.ends[i] for i in ends], list(ends.values())


def _result(
    problem: RateProblem, prices: Tensor, ends: list[Serial], shares: list[float], bound: float
) -> AtRates:
    """Means over the ends."""
    weights = torch.tensor(shares, dtype=torch.float64)
    columns = _Columns(prices.expand(len(ends), -1), tuple(ends))
    perception, action = (weights @ columns.rates).tolist()
    slack = problem.limited & (prices <= 2 * problem.stake / FREE)
    beta_1, beta_2 = torch.where(slack, math.inf, 1 / prices).tolist()
    return AtRates(
        objective=(weights @ problem.worth(columns)).item(),
        expected_utility=(weights @ columns.each("expected_utility")).item(),
        perception_information=perception,
        action_information=action,
        beta_perception=beta_1,
        beta_action=beta_2,
        upper_bound=bound,
        ends=tuple(ends),
        shares=tuple(shares),
    )
