"""One channel Ω → A: the rate-distortion optimum, which is unique, with its certified gap."""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from bra.blahut_arimoto.mixture_likelihood import (
    GAP_TOLERANCE,
    NEWTON_CAP,
    MixtureLikelihood,
    maximise,
)
from bra.blahut_arimoto.reduction import reduced
from bra.blahut_arimoto.results import RateDistortion, per_price, warn_cap
from bra.checks.arrays import Array
from bra.checks.prices import check_betas
from bra.checks.tables import check_prior, check_utilities
from bra.information import mutual_information

# Of J, in units of the likelihood.
_ROUNDING = 4 * torch.finfo(torch.float64).eps


def rate_distortion(utilities: Array, prior: Array | None, beta: float | Array) -> RateDistortion:
    """Optimum of one channel, max over p(a|ω) of E[U(ω,a)] − (1/β) I(Ω;A).

    The optimum has the form p(a|ω) = q(a) e^{βU(ω,a)} / Z(ω), Z(ω) = Σ_a q(a) e^{βU(ω,a)}, and
    maximises the concave function (1/β) Σ_ω p(ω) log Z(ω) over distributions q, which Newton steps
    do (see `bra.blahut_arimoto.mixture_likelihood`). The stopping rule is the certificate

        J* − J(q) ≤ (1/β) log max_a D(a),  D(a) = Σ_ω p(ω) e^{βU(ω,a)} / Z(ω),

    which holds for every q. Where the best single action is as good, to rounding, it is returned.

    Args:
        utilities: U(ω,a), shape (W, A); −inf for an action that is forbidden in a state.
        prior: p(ω), shape (W,); None for uniform.
        beta: Price β > 0 of information, per nat; a number or a tensor of any shape.

    Returns:
        The optimum, one for each price.

    Raises:
        ValueError: If an argument cannot be read as numbers, or a number is not admissible.
    """
    table = check_utilities(utilities)
    prices = check_betas(beta, "beta")
    problem = reduced(table, check_prior(prior, len(table)), table.shape[1], prices.flatten())
    optimum = solve(problem.utilities, problem.prior, *problem.betas)
    cap = f"{NEWTON_CAP} Newton steps"
    gap = problem.unit * optimum.gap
    warn_cap("rate_distortion", optimum.converged, cap, gap)
    objective = problem.value(optimum.objective)
    shape = prices.shape
    return RateDistortion(
        objective=per_price(objective, shape),
        expected_utility=per_price(problem.value(optimum.expected_utility), shape),
        end_to_end_information=per_price(optimum.information, shape),
        action_given_state=per_price(
            problem.all_states(problem.all_actions(optimum.channel)), shape
        ),
        action_marginal=per_price(problem.all_actions(optimum.marginal), shape),
        upper_bound=per_price(objective + gap, shape),
        gap=per_price(gap, shape),
        iterations=per_price(optimum.iterations, shape),
        converged=per_price(optimum.converged, shape),
    )


class Optimum(NamedTuple):
    """One-channel optima of a batch of B prices."""

    objective: Tensor  # (B,)
    expected_utility: Tensor  # (B,)
    information: Tensor  # (B,)
    channel: Tensor  # (B, W, A)
    marginal: Tensor  # (B, A)
    gap: Tensor  # (B,)
    iterations: Tensor  # (B,)
    converged: Tensor  # (B,)


def solve(utilities: Tensor, prior: Tensor, beta: Tensor) -> Optimum:
    """One-channel optimum for finite utilities (W, A), a prior (W,) and a batch of prices (B,)."""
    likelihood = MixtureLikelihood(utilities, prior, beta)
    q, certificate, iterations = maximise(likelihood)
    scale = likelihood.scale.squeeze(1)
    upper_bound = (scale * likelihood.value(q) + (scale * certificate).log1p()) / beta

    centred, offset = centre(utilities, prior)
    channel = (q.log()[:, None] + beta[:, None, None] * centred).softmax(-1)
    information = mutual_information(prior, channel)
    constant = prior @ centred
    silent = _utility(channel, centred, prior) - information / beta <= (
        constant.amax() + _ROUNDING * scale / beta
    )
    single = one_hot(constant.argmax(), len(constant)).to(channel)
    channel = torch.where(silent[:, None, None], single, channel)
    information = torch.where(silent, 0.0, information)
    expected_utility = _utility(channel, centred, prior)
    objective = expected_utility - information / beta
    return Optimum(
        objective=objective + offset,
        expected_utility=expected_utility + offset,
        information=information,
        channel=channel,
        marginal=prior @ channel,
        gap=(upper_bound - objective).clamp(min=0.0),
        iterations=iterations,
        converged=certificate <= GAP_TOLERANCE,
    )


def _utility(channel: Tensor, utilities: Tensor, prior: Tensor) -> Tensor:
    """E[U] of channels (B, W, A), shape (B,)."""
    return (channel * utilities).sum(2) @ prior


def centre(utilities: Tensor, prior: Tensor) -> tuple[Tensor, Tensor]:
    """Utilities less each state's best one, and the expectation of what was taken away."""
    best = utilities.amax(1)
    return utilities - best[:, None], prior @ best
