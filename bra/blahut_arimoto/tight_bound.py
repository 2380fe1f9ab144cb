"""A tighter bound on J of two channels in series, from how little channels let through.

By data processing I(Ω;A) ≤ I(Ω;X) and I(Ω;A) ≤ I(X;A), which is all that the bound of one channel
uses. Two things make both sharper.

**Contraction.** Let (p(x|ω), p(a|x)) be an optimum, q_x = p(ω|x), r_x = p(a|x), u_x = E[U(ω,·)|x],
‖·‖ total variation, and

    D = max |U(ω,a) − U(ω,a′) − U(ω′,a) + U(ω′,a′)|

over pairs of states and of actions. The self-consistent equations (see `serial`) say that on the
supports log r_x/r_x′ = β₂ (u_x − u_x′) up to what does not depend on the action, and
log q_x/q_x′ = β₁ (E_{r_x}[U] − E_{r_x′}[U]) up to what does not depend on the state. So the first
oscillates by no more than β₂ D ‖q_x − q_x′‖ between actions, and the second by no more than
β₁ D ‖r_x − r_x′‖ between states.

Where log p/p′ oscillates by no more than δ, the odds of any set under p are at most e^δ times those
under p′, hence ‖p − p′‖ ≤ tanh(δ/4), the most for complementary odds. So

    ‖q_x − q_x′‖ ≤ tanh(β₁ D ‖r_x − r_x′‖ / 4),   ‖r_x − r_x′‖ ≤ tanh(β₂ D ‖q_x − q_x′‖ / 4),

and no two are further apart than t = tanh(β₁ D s/4), s = tanh(β₂ D t/4), the largest solution. It
is zero if β₁ β₂ D² ≤ 16: nothing is worth knowing then, and J* is that of the best single action.

A channel contracts information by its η_KL, which two of its inputs attain (Ordentlich and
Polyanskiy, "Strong data processing constant is achieved by binary inputs", IEEE Trans. Inf. Theory
68, 2022). For two inputs of probabilities λ and 1 − λ it is the largest Var π / λ(1 − λ), π being
the first one's posterior (Choi, Ruskai and Seneta 1994). π has mean λ and log-odds that oscillate
by no more than δ, from log u to log v say, so that Var π ≤ (λ − π₋)(π₊ − λ), and at the worst λ

    η_KL ≤ (√v − √u)² / ((1 + u)(1 + v)) ≤ tanh²(δ/4),

with equality for a binary symmetric channel. So I(Ω;A) ≤ s² I(Ω;X), I(Ω;A) ≤ t² I(X;A), and

    J* ≤ max E[U] − c I(Ω;A),   c = 1/(β₁ s²) + 1/(β₂ t²).

**Capacity.** I(Ω;A) ≤ log |X|. So for every multiplier λ ≥ 0

    J* ≤ J₁(c + λ) + λ log |X|,

J₁(c) being the certified bound of one channel whose information costs c per nat. This is convex in
λ, and least where that channel's information is log |X|, or at 0 if it is less there anyway.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from bra.blahut_arimoto.one_channel import Optimum, solve

CONTRACTIONS = 1000
"""Of t, which falls towards the solution and may stop anywhere above it."""
GRID, PRECISION = 16, 5e-3
"""Multipliers tried at once, and how far the logarithms of the outermost may be apart at last."""


class Bounds(NamedTuple):
    """What no pair of channels exceeds, (B,), and the channel that attains the looser bound."""

    channel: Tensor  # (B, W, A)
    upper: Tensor  # (B,)
    tight: Tensor  # (B,)


def bounds(
    utilities: Tensor, prior: Tensor, beta_1: Tensor, beta_2: Tensor, percepts: int
) -> Bounds:
    """The bound of one channel, and the tighter one of the module's text, in utility units.

    Args:
        utilities: U(ω,a), (W, A).
        prior: p(ω), (W,).
        beta_1: β₁, (B,).
        beta_2: β₂, (B,).
        percepts: |X|.
    """
    known, table = prior[prior > 0], utilities[prior > 0]
    posterior, action = contractions(contrast(table), beta_1, beta_2)
    informed = (posterior > 0) & (percepts > 1)
    cost = (1 / (beta_1 * action**2) + 1 / (beta_2 * posterior**2))[informed]
    solved = solve(utilities, prior, 1 / torch.cat((1 / beta_1 + 1 / beta_2, cost)))
    count = len(beta_1)
    upper = (solved.objective + solved.gap)[:count]
    tight = (known @ table).amax().expand(count)  # of the best single action
    if informed.any():
        free = Optimum(*(column[count:] for column in solved))
        found = within_capacity(table, known, 1 / cost, free, math.log(percepts))
        tight = tight.masked_scatter(informed, found)
    return Bounds(solved.channel[:count], upper, torch.fmin(upper, tight))


def contrast(utilities: Tensor) -> Tensor:
    """D, how much the difference between two actions can depend on the state, ()."""
    table, widest = utilities.mT.contiguous(), utilities.new_zeros(())
    for action in range(1, len(table)):
        advantage = table[:action] - table[action]
        widest = torch.maximum(widest, (advantage.amax(1) - advantage.amin(1)).amax())
    return widest


def contractions(contrast: Tensor, beta_1: Tensor, beta_2: Tensor) -> tuple[Tensor, Tensor]:
    """Bounds t on ‖q_x − q_x′‖ and s on ‖r_x − r_x′‖, (B,) each.

    Args:
        contrast: D, ().
        beta_1: β₁, (B,).
        beta_2: β₂, (B,).
    """
    rate_1, rate_2 = beta_1 * contrast / 4, beta_2 * contrast / 4
    posterior = (rate_1 * rate_2 > 1).to(beta_1)
    for _ in range(CONTRACTIONS):
        previous, posterior = posterior, (rate_1 * (rate_2 * posterior).tanh()).tanh()
        if torch.equal(previous, posterior):
            break
    return posterior, (rate_2 * posterior).tanh()


def within_capacity(
    utilities: Tensor,
    prior: Tensor,
    beta: Tensor,
    free: Optimum,
    capacity: float,
    least_beta: Tensor | None = None,
) -> Tensor:
    """min_λ J₁(1/β + λ) + λ log |X| over λ ≥ 0, (B,), J₁(1/β) being that of the `free` channel.

    As far as 1/β + λ ≤ 1/`least_beta`, if that is given.
    """
    bound = free.objective + free.gap
    short = free.information > capacity
    if not short.any():
        return bound
    # A channel of price β′ has I ≤ β′ (largest − smallest U), so less than log |X| at the low end.
    spread = (utilities.amax(1) - utilities.amin(1)).amax()
    high = beta[short].log()
    low = torch.minimum(high, (capacity / spread).log())
    if least_beta is not None:
        low = torch.maximum(low, least_beta[short].log())
    along = torch.linspace(0, 1, GRID, dtype=beta.dtype)
    best = bound[short]
    while (high - low > PRECISION).any():
        prices = (low.unsqueeze(1) + (high - low).unsqueeze(1) * along).exp()
        channels = solve(utilities, prior, prices.flatten())
        multiplier = 1 / prices - 1 / beta[short].unsqueeze(1)
        values = (channels.objective + channels.gap).view_as(prices) + multiplier * capacity
        best = torch.minimum(best, values.amin(1))
        step = (high - low) / (GRID - 1)
        middle = low + step * values.argmin(1)
        low, high = torch.maximum(low, middle - step), torch.minimum(high, middle + step)
    return bound.masked_scatter(short, best)
