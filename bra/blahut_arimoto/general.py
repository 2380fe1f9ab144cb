"""The general case: perception, and an action that looks at the state again, p(a|x,ω).

Genewein, Leibfried, Grau-Moya and Braun (2015), section 5. Percepts choose a prior p(a|x), at β₁
for what they tell of the state and at β₂ for what they tell of the action; what the action finds
out by itself, I(Ω;A|X), is paid at β₃. Self-consistent equations (see `general_problem`):

    p(a|x,ω) = p(a|x) exp(β₃ [U(ω,a) − (1/β₂) log p(a|x)/p(a)]) / Z(x,ω)
    p(x|ω)   = p(x) exp(β₁ ΔF(ω,x)) / Z(ω),  ΔF(ω,x) = (1/β₃) log Z(x,ω)

with p(a|x), p(a) and p(x) at their marginals. Serial is β₃ → 0, parallel β₂ = ∞. Climbs, starts and
the search among their ends are those of `serial`.

**Certificate of a climb.** With p(a|x) and p(a) held, perception is a one-channel problem with
utility ΔF. With p(x|ω) held, E log Z is concave in p(a|x) and p(a), and by Jensen and Hölder no
others gain more than

    (c₃ − c₂) Σ_x p(x) log max_a D(a|x) + c₂ log max_a D(a),

cᵢ = 1/βᵢ, D being the ratio of the new marginals to the old ones. Both together are below the
tolerance at the end. That proves a stationary point, not a global optimum.

**Upper bound.** Let c₁₂ = c₁ + c₂, I = I(Ω;A), t = I(Ω;A|X) and k = max(I − t, 0). By the chain
rule I ≤ I(X;A) + t and I ≤ I(Ω;X) + t, so k is at most either of them, and at most log |X|. Hence
information costs at least c₁₂ k + c₃ t, with k + t ≥ I.

* If c₁₂ ≥ c₃ that is at least c₃ I: J is at most that of one channel at β₃, which a percept that
  tells nothing attains. Percepts are worthless.
* If c₁₂ < c₃, then for every μ from 0 to c₃ − c₁₂ it is at least (c₁₂ + μ)(k + t) − μ log |X|, so

      J* ≤ min_μ J₁(c₁₂ + μ) + μ log |X|,

  J₁(c) being the certified bound of one channel whose information costs c per nat.
"""

import math

import torch
from torch import Tensor
from torch.nn.functional import pad

from bra.blahut_arimoto import one_channel
from bra.blahut_arimoto.general_problem import GeneralProblem
from bra.blahut_arimoto.reduction import Reduction, reduced
from bra.blahut_arimoto.results import General, per_price
from bra.blahut_arimoto.solution import (
    Effort,
    best_of_many,
    refuse_forbidden,
    solve_serial,
)
from bra.blahut_arimoto.tight_bound import Bounds, within_capacity
from bra.checks.arrays import Array, check_numbers
from bra.checks.prices import broadcast_betas, check_betas, refuse_free
from bra.checks.tables import check_prior, check_utilities


def general(
    utilities: Array,
    prior: Array | None,
    percepts: int,
    beta_perception: float | Array,
    beta_action: float | Array,
    beta_direct: float | Array | None,
    restarts: int = 32,
    seed: int = 0,
    budget: int | None = None,
) -> General:
    """Best optimum found of E[U] − (1/β₁) I(Ω;X) − (1/β₂) I(X;A) − (1/β₃) I(Ω;A|X).

    Over p(x|ω) and p(a|x,ω). With β₃ = 0 actions do not look again: the values are those of
    `serial`. Where 1/β₁ + 1/β₂ ≥ 1/β₃ percepts are worthless, and the one channel that is the
    optimum is returned.

    Args:
        utilities: U(ω,a), shape (W, A); −inf for an action that is forbidden in a state.
        prior: p(ω), shape (W,); None for uniform.
        percepts: Number of percepts |X|.
        beta_perception: Price β₁ > 0 of I(Ω;X), per nat; inf where it is free.
        beta_action: Price β₂ > 0 of I(X;A), per nat; inf where it is free.
        beta_direct: Price β₃ ≥ 0 of I(Ω;A|X), per nat; inf where it is free; None is 0. Prices are
            numbers or tensors, broadcast against each other.
        restarts: Number of starts in a batch, for each set of prices.
        seed: Seed of all starts.
        budget: Most starts for each set of prices; None for 16 batches, fewer for large problems.

    Returns:
        The best end, one for each set of prices.

    Raises:
        ValueError: If an argument cannot be read as numbers, a number is not admissible, all
            information is free, or no policy was found that never takes a forbidden action.
    """
    table = check_utilities(utilities)
    p = check_prior(prior, len(table))
    effort = Effort.checked(percepts, restarts, budget, seed)
    prices = _prices(beta_perception, beta_action, beta_direct)
    betas = torch.stack([beta.flatten() for beta in prices])
    looks = betas[2] > 0
    terms: dict[str, Tensor] = {}
    if looks.any():
        terms = _solve(table, p, effort, *betas[:, looks])
    if not looks.all():
        serial = _as_general(solve_serial(table, p, effort, *betas[:2, ~looks]), len(table))
        terms = _merged(looks, terms, serial) if terms else serial
    return General(**{name: per_price(term, prices[0].shape) for name, term in terms.items()})


def _prices(
    beta_perception: float | Array, beta_action: float | Array, beta_direct: float | Array | None
) -> tuple[Tensor, ...]:
    """β₁, β₂ and β₃ in their common shape."""
    direct = check_numbers(0.0 if beta_direct is None else beta_direct, "beta_direct")
    given = torch.where(direct == 0, 1.0, direct)
    prices = broadcast_betas(
        beta_perception=check_betas(beta_perception, "beta_perception", infinite=True),
        beta_action=check_betas(beta_action, "beta_action", infinite=True),
        beta_direct=torch.where(direct == 0, 0.0, check_betas(given, "beta_direct", infinite=True)),
    )
    refuse_free(*prices)
    return prices


def _solve(
    table: Tensor, prior: Tensor, effort: Effort, beta_1: Tensor, beta_2: Tensor, beta_3: Tensor
) -> dict[str, Tensor]:
    """The entries of `General` for B sets of prices, β₃ > 0."""
    # Worthless percepts are as good at a cost of c₃ as at a higher one.
    worthless = 1 / beta_1 + 1 / beta_2 >= 1 / beta_3
    beta_1 = torch.where(worthless, beta_3, beta_1)
    beta_2 = torch.where(worthless, math.inf, beta_2)
    problem = reduced(table, prior, table.shape[1], beta_1, beta_2, beta_3)
    beta_1, beta_2, beta_3 = problem.betas
    chain = GeneralProblem(problem.utilities, problem.prior, beta_1, beta_2, problem.regret, beta_3)
    bounds = _bounds(problem, effort.percepts)
    terms = best_of_many(problem, chain, bounds, effort)
    refuse_forbidden(terms, table, prior, effort.percepts)
    return terms


def _bounds(problem: Reduction, percepts: int) -> Bounds:
    beta_1, beta_2, beta_3 = problem.betas
    beta = 1 / (1 / beta_1 + 1 / beta_2)
    single = one_channel.solve(problem.utilities, problem.prior, beta)
    capacity = math.log(percepts)
    upper = within_capacity(problem.utilities, problem.prior, beta, single, capacity, beta_3)
    return Bounds(single.channel, upper, upper)


def _as_general(serial: dict[str, Tensor], states: int) -> dict[str, Tensor]:
    """Serial solutions, whose actions do not look again."""
    rows = serial["action_given_percept"][:, :, None]
    return serial | {
        "direct_information": torch.zeros_like(serial["objective"]),
        "action_given_percept_and_state": rows.expand(-1, -1, states, -1),
    }


def _merged(mask: Tensor, terms: dict[str, Tensor], other: dict[str, Tensor]) -> dict[str, Tensor]:
    """Entries of B sets of prices, of which those in the mask (B,) are the first's."""
    starts = max(terms["optima"].shape[1], other["optima"].shape[1])
    merged = {}
    for name, part in terms.items():
        parts = [part, other[name]]
        if name == "optima":
            parts = [pad(p, (0, starts - p.shape[1]), value=torch.nan) for p in parts]
        merged[name] = parts[0].new_empty(len(mask), *parts[0].shape[1:])
        merged[name][mask], merged[name][~mask] = parts
    return merged
