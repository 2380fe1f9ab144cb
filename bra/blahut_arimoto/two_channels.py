"""Two channels in series, Ω → X → A: the best of many climbs, and a bound that holds globally."""

import torch
from torch import Tensor

from bra.blahut_arimoto import one_channel
from bra.blahut_arimoto.climb import SWEEP_CAP, climb
from bra.blahut_arimoto.results import Serial, per_price, warn_cap
from bra.blahut_arimoto.serial_problem import SerialProblem
from bra.blahut_arimoto.starts import starts
from bra.blahut_arimoto.tight_bound import tight_bound
from bra.checks import Array, check_betas, check_count, check_prior, check_utilities
from bra.information import mutual_information


def serial(
    utilities: Array,
    prior: Array | None,
    percepts: int,
    beta_perception: float | Array,
    beta_action: float | Array,
    restarts: int = 32,
    seed: int = 0,
) -> Serial:
    """Best optimum found of E[U(ω,a)] − (1/β₁) I(Ω;X) − (1/β₂) I(X;A) over p(x|ω) and p(a|x).

    Each restart climbs by the self-consistent equations (Genewein, Leibfried, Grau-Moya and Braun
    2015, section 4)

        p(a|x) ∝ p(a) exp(β₂ Σ_ω p(ω|x) U(ω,a))
        p(x|ω) ∝ p(x) exp(β₁ ΔF(ω,x)),  ΔF(ω,x) = E_{p(a|x)}[U(ω,a)] − (1/β₂) KL(p(a|x) ‖ p(a))

    with the marginals p(x) and p(a) renewed after each sweep. Every line maximises the same
    functional in one of its arguments, so J never falls. Squared extrapolation (SQUAREM, Varadhan
    and Roland 2008) shortens the way; an extrapolated point that lies below its base is thrown
    away, so J never falls there either.

    A restart has converged when neither block can gain: with p(a|x) and p(a) held, perception is a
    one-channel problem with utility ΔF; with p(x|ω) held, action is one with utility E[U|x]; and
    the certificates of the two (see `rate_distortion`),

        (1/β₁) log max_x Σ_ω p(ω) e^{β₁ΔF(ω,x)} / Z(ω)
        + (1/β₂) log max_a Σ_x p(x) e^{β₂E[U(ω,a)|x]} / Z(x),

    sum to less than the tolerance. That proves a stationary point, not a global optimum.

    The upper bound is global. By data processing I(Ω;A) is at most I(Ω;X) and at most I(X;A), so
    J ≤ E[U] − (1/β₁ + 1/β₂) I(Ω;A), which is at most the one-channel optimum at
    1/β = 1/β₁ + 1/β₂, which is at most the returned value of that plus its certified gap. Channels
    that are noisy or have few outcomes let less through; `tight_bound` says how much less.

    Args:
        utilities: U(ω,a), shape (W, A), finite.
        prior: p(ω), shape (W,); None for uniform.
        percepts: Number of percepts |X|.
        beta_perception: Price β₁ > 0 of I(Ω;X), per nat; a number or a tensor.
        beta_action: Price β₂ > 0 of I(X;A), per nat; a number or a tensor. The two are broadcast
            against each other.
        restarts: Number of starts for each pair of prices.
        seed: Seed of the random starts.

    Returns:
        The best restart, one for each pair of prices.

    Raises:
        ValueError: If an argument cannot be read as numbers, or a number is not admissible.
    """
    table = check_utilities(utilities)
    p = check_prior(prior, len(table))
    percepts, restarts = check_count(percepts, "percepts"), check_count(restarts, "restarts")
    beta_1, beta_2 = _broadcast(
        check_betas(beta_perception, "beta_perception"), check_betas(beta_action, "beta_action")
    )
    shape = beta_1.shape

    bound = one_channel.solve(table, p, 1 / (1 / beta_1 + 1 / beta_2).flatten())
    upper = bound.objective + bound.gap
    tight = tight_bound(table, p, beta_1.flatten(), beta_2.flatten(), percepts)
    tight = torch.fmin(upper, tight)  # NaN where squares of prices leave the range of numbers
    centred, offset = one_channel.centre(table, p)
    problem = SerialProblem(
        utilities=centred,
        prior=p,
        beta_1=beta_1.flatten().repeat_interleave(restarts),
        beta_2=beta_2.flatten().repeat_interleave(restarts),
    )
    end = climb(problem, starts(problem, bound.channel, percepts, restarts, seed))
    warn_cap("serial", end.converged, f"{SWEEP_CAP} sweeps", end.gap)

    terms = _terms(problem, end.point)
    optima = terms["objective"].view(-1, restarts)
    # The first among equals, so that rounding does not choose between names of percepts.
    level = optima.amax(1, keepdim=True) - 100 * problem.tolerance().view(-1, restarts)
    best = (optima >= level).double().argmax(1) + restarts * torch.arange(len(optima))
    chosen = {name: term[best] for name, term in terms.items()}
    chosen["objective"] += offset
    chosen["expected_utility"] += offset
    return Serial(
        **{name: per_price(term, shape) for name, term in chosen.items()},
        upper_bound=per_price(upper, shape),
        tight_bound=per_price(tight, shape),
        optima=per_price(optima + offset, shape),
        iterations=per_price(end.sweeps.view(-1, restarts).amax(1), shape),
        converged=per_price(end.converged.view(-1, restarts).all(1), shape),
    )


def _terms(problem: SerialProblem, point: Tensor) -> dict[str, Tensor]:
    """J, its terms and the channels at a point, with their own marginals, batch first."""
    action = point[:-1].exp().permute(2, 1, 0)
    perception = problem.perceive(point).percept_given_state.permute(2, 0, 1)
    percept_marginal = problem.prior @ perception
    behaviour = perception @ action
    expected_utility = (behaviour * problem.utilities).sum(2) @ problem.prior
    perception_information = mutual_information(problem.prior, perception)
    action_information = mutual_information(percept_marginal, action)
    cost = perception_information / problem.beta_1 + action_information / problem.beta_2
    return {
        "objective": expected_utility - cost,
        "expected_utility": expected_utility,
        "perception_information": perception_information,
        "action_information": action_information,
        "end_to_end_information": mutual_information(problem.prior, behaviour),
        "action_given_state": behaviour,
        "percept_given_state": perception,
        "action_given_percept": action,
        "percept_marginal": percept_marginal,
        "action_marginal": problem.prior @ behaviour,
    }


def _broadcast(beta_1: Tensor, beta_2: Tensor) -> tuple[Tensor, Tensor]:
    """Both prices in their common shape."""
    try:
        shape = (beta_1 + beta_2).shape
    except RuntimeError as error:
        raise ValueError(
            "beta_perception and beta_action must broadcast against each other, got shapes "
            f"{tuple(beta_1.shape)} and {tuple(beta_2.shape)}"
        ) from error
    return beta_1.expand(shape), beta_2.expand(shape)
