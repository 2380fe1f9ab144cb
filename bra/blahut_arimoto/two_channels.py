"""Two channels in series, Ω → X → A: the best of many climbs, and bounds that hold globally.

Each climb follows the self-consistent equations (Genewein, Leibfried, Grau-Moya and Braun 2015,
section 4)

    p(a|x) ∝ p(a) exp(β₂ Σ_ω p(ω|x) U(ω,a))
    p(x|ω) ∝ p(x) exp(β₁ ΔF(ω,x)),  ΔF(ω,x) = E_{p(a|x)}[U(ω,a)] − (1/β₂) KL(p(a|x) ‖ p(a))

with the marginals p(x) and p(a) renewed after each sweep. Every line maximises the same functional
in one of its arguments, so J never falls. Squared extrapolation (SQUAREM, Varadhan and Roland 2008)
shortens the way; an extrapolated point that lies below its base is thrown away, so J never falls
there either.

A climb has converged when neither block can gain: with p(a|x) and p(a) held, perception is a
one-channel problem with utility ΔF; with p(x|ω) held, action is one with utility E[U|x]; and the
certificates of the two (see `rate_distortion`),

    (1/β₁) log max_x Σ_ω p(ω) e^{β₁ΔF(ω,x)} / Z(ω)
    + (1/β₂) log max_a Σ_x p(x) e^{β₂E[U(ω,a)|x]} / Z(x),

sum to less than the tolerance. That proves a stationary point, not a global optimum.

The upper bound is global. By data processing I(Ω;A) is at most I(Ω;X) and at most I(X;A), so
J ≤ E[U] − (1/β₁ + 1/β₂) I(Ω;A), which is at most the one-channel optimum at 1/β = 1/β₁ + 1/β₂,
which is at most the returned value of that plus its certified gap. Channels that are noisy or have
few outcomes let less through; `tight_bound` says how much less.

No more percepts are needed than states: for a given p(a), J is the mean over percepts of a function
of the posterior p(ω|x), and whatever mean posteriors with their mean at p(ω) can reach, |Ω| of them
can (Carathéodory).
"""

from typing import overload

import torch

from bra.blahut_arimoto.results import AtRates, Serial, per_price
from bra.blahut_arimoto.solution import Effort, solve_serial
from bra.blahut_arimoto.two_rates import RateProblem, at_rates
from bra.checks.arrays import Array
from bra.checks.prices import broadcast_betas, check_betas
from bra.checks.tables import check_prior, check_utilities


@overload
def serial(
    utilities: Array,
    prior: Array | None,
    percepts: int,
    beta_perception: float | Array,
    beta_action: float | Array,
    restarts: int = ...,
    seed: int = ...,
    budget: int | None = ...,
    certify: float | None = ...,
) -> Serial: ...


@overload
def serial(
    utilities: Array,
    prior: Array | None,
    percepts: int,
    beta_perception: float | None = ...,
    beta_action: float | None = ...,
    restarts: int = ...,
    seed: int = ...,
    budget: int | None = ...,
    certify: float | None = ...,
    *,
    perception_bits: float,
    action_bits: float | None = ...,
) -> AtRates: ...


@overload
def serial(
    utilities: Array,
    prior: Array | None,
    percepts: int,
    beta_perception: float | None = ...,
    beta_action: float | None = ...,
    restarts: int = ...,
    seed: int = ...,
    budget: int | None = ...,
    certify: float | None = ...,
    *,
    perception_bits: None = ...,
    action_bits: float,
) -> AtRates: ...


def serial(
    utilities: Array,
    prior: Array | None,
    percepts: int,
    beta_perception: float | Array | None = None,
    beta_action: float | Array | None = None,
    restarts: int = 32,
    seed: int = 0,
    budget: int | None = None,
    certify: float | None = None,
    *,
    perception_bits: float | None = None,
    action_bits: float | None = None,
) -> Serial | AtRates:
    """Best optimum found of E[U(ω,a)] − (1/β₁) I(Ω;X) − (1/β₂) I(X;A) over p(x|ω) and p(a|x).

    Batches of starts climb until half of them led to the best end, that end meets the bound, or the
    budget is used up. The best single action takes its place if it is as good.

    Args:
        utilities: U(ω,a), shape (W, A); −inf for an action that is forbidden in a state.
        prior: p(ω), shape (W,); None for uniform.
        percepts: Number of percepts |X|.
        beta_perception: Price β₁ > 0 of I(Ω;X), per nat; a number or a tensor.
        beta_action: Price β₂ > 0 of I(X;A), per nat; a number or a tensor. The two are broadcast
            against each other; beside a budget they are numbers.
        restarts: Number of starts in a batch, for each pair of prices.
        seed: Seed of all starts.
        budget: Most starts for each pair of prices; None for 16 batches, fewer for large problems.
        certify: Seconds to spend on lowering `bound` (see `certificate`), after the search and
            for one pair of prices only; None for none. Enough of them close the gap if |X| ≥ |Ω|.
        perception_bits: The most bits that I(Ω;X) may have, in place of `beta_perception`: E[U],
            less what the other channel costs if it has a price, is then maximised within it.
        action_bits: The same for I(X;A), in place of `beta_action`.

    Returns:
        The best end, one for each pair of prices. With a budget the prices that lead to it and the
        end there, see `AtRates`.

    Raises:
        ValueError: If an argument cannot be read as numbers, a number is not admissible, a channel
            has a price and a budget, or neither, several pairs of prices are to be certified, or no
            policy was found that never takes a forbidden action.
    """
    table = check_utilities(utilities)
    p = check_prior(prior, len(table))
    effort = Effort.checked(percepts, restarts, budget, seed, certify)
    betas, bits = (beta_perception, beta_action), (perception_bits, action_bits)
    if bits != (None, None):
        return at_rates(RateProblem.of(table, p, effort, betas, bits))
    named = zip(("beta_perception", "beta_action"), betas, strict=True)
    prices = broadcast_betas(**{name: check_betas(beta, name) for name, beta in named})  # type: ignore[arg-type]  # it refuses None
    if certify is not None and prices[0].numel() != 1:
        raise ValueError(
            f"certify takes one pair of prices, got {prices[0].numel()}; solve for each alone"
        )
    with torch.inference_mode():  # a sixth less for small problems; clones belong to no mode
        terms = solve_serial(table, p, effort, *(beta.flatten() for beta in prices))
    shape = prices[0].shape
    return Serial(**{name: per_price(term.clone(), shape) for name, term in terms.items()})
