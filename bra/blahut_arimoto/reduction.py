"""A problem without what cannot matter to its optimum, in units of its own, and the way back.

**States.** J depends on a state only through its row of utilities, up to a constant, and is concave
in p(x|ω): states whose rows differ by a constant share one optimal row of the channel and become
one state. States without mass weigh nothing.

**Actions.** If U(ω,a) ≤ U(ω,b) in every state with mass, giving a's probability to b loses no
utility and, by data processing, costs no information: a is dropped.

**Regret.** Let r(ω,a) = max U(ω,·) − U(ω,a). The best single action loses R₁, its mean regret,
against E[max U]; the best one in each state of some k ≤ |X| actions loses at most
R_k + (1/β₁ + 1/β₂) log k, for one channel R_k + (1/β) log k. So an optimum loses no more than
B = min(R₁, R_k + (1/β₁ + 1/β₂) log k), however large single regrets are. Tolerances refer to B.

**Penalties.** An optimum gives all cells with a regret of at least r a probability m ≤ B/r. Leave
out of its channels every p(ω,x) and p(x,a) below √m: each cell with such a regret loses a factor,
since p(ω,x) p(x,a) ≥ √m √m would give it m/p(x). What is left avoids these cells altogether, and
has moved a mass of at most |X| (W + A) √m. Regrets are cut at r = 10⁴⁰ (R + 1/β₁ + 1/β₂), R being
R₁ or R_k, where √m ≤ 10⁻²⁰ is below the rounding of J. They count as forbidden from there on, as
−inf does. The cut only adds to J, so that bounds stay bounds.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

_CUT, _HIGHEST_CUT = 1e40, 1e90
# Outside this range, in units of the regret, information is free, or too dear, to all digits.
_LOWEST_PRICE, _HIGHEST_PRICE = 1e-18, 1e60


@dataclass(frozen=True)
class Reduction:
    """A problem of S states and K actions, at B sets of prices, that stands for a larger one."""

    utilities: Tensor
    """Minus the regret, in `unit`s, (S, K)."""
    prior: Tensor
    """(S,)."""
    betas: tuple[Tensor, ...]
    """Price of each link, per `unit` of utility, (B,) each."""
    regret: Tensor
    """B, in `unit`s, (B,)."""
    unit: float
    """A power of two."""
    offset: Tensor
    """E[max U], ()."""
    state_of: Tensor
    """The reduced state of every state, (W,)."""
    kept: Tensor
    """The actions that were kept, (K,)."""
    forbidden: Tensor
    """Where the utility was −inf or as good as that, (S, K)."""
    actions: int
    """|A|."""

    @property
    def prices(self) -> tuple[Tensor, Tensor]:
        """β₁ and β₂ of two channels in series."""
        beta_1, beta_2 = self.betas
        return beta_1, beta_2

    def value(self, utility: Tensor) -> Tensor:
        """Utilities of the reduced problem as such of the original."""
        return 2 * (self.unit / 2 * utility + self.offset / 2)  # no overflow on the way

    def all_actions(self, probabilities: Tensor) -> Tensor:
        """Distributions over the kept actions (..., K) as ones over all, (..., A)."""
        full = probabilities.new_zeros(*probabilities.shape[:-1], self.actions)
        full[..., self.kept] = probabilities
        return full

    def all_states(self, channel: Tensor) -> Tensor:
        """A channel from the reduced states (..., S, Y) as one from all, (..., W, Y)."""
        return channel[..., self.state_of, :]


def reduced(utilities: Tensor, prior: Tensor, percepts: int, *betas: Tensor) -> Reduction:
    """The problem without duplicate states, dominated actions and boundless penalties.

    Args:
        utilities: U(ω,a), (W, A), finite or −inf, each state with a finite one.
        prior: p(ω), (W,).
        percepts: |X|; for one channel |A|.
        betas: Prices of the links in series, (B,) each.

    Raises:
        ValueError: If information is needed, and so dear that J is beyond the range of numbers.
    """
    occurs = prior > 0
    kept = undominated(utilities[occurs])
    # Regrets are halved until they have a unit, so that differences cannot overflow.
    halved = utilities[:, kept] / 2
    best = halved.amax(1, keepdim=True)
    regrets = torch.where(best.isfinite(), best - halved, 0.0)
    single, several, count = _mean_regrets(regrets[occurs], prior[occurs], percepts)
    cost = torch.stack([1 / beta for beta in betas]).sum(0) / 2
    # The logarithm of one is zero, and the cost may be infinite.
    informed = cost * math.log(count) if count > 1 else torch.zeros_like(cost)
    regret = torch.minimum(single, several + informed)
    if count == 1 and single.isinf():
        raise ValueError(
            "utilities forbid every single action in some state, so that one percept cannot do; "
            "allow more percepts"
        )
    if not (2 * regret).isfinite().all():
        raise ValueError(
            "utilities forbid every single action, and beta is so small that the information to do "
            "without them costs more than numbers can hold; give larger betas"
        )
    unit = 2.0 ** math.floor(math.log2(regret.max().clamp(1e-300, 1e300)))
    cut = _CUT * (torch.minimum(single, several) / unit + (cost / unit).max())
    rows = (regrets / unit).clamp(max=cut.clamp(max=_HIGHEST_CUT))
    merged, state_of = torch.unique(rows, dim=0, return_inverse=True)
    return Reduction(
        utilities=-merged,
        prior=torch.zeros(len(merged)).to(prior).index_add(0, state_of, prior),
        betas=tuple((2 * unit * beta).clamp(_LOWEST_PRICE, _HIGHEST_PRICE) for beta in betas),
        regret=regret / unit,
        unit=2 * unit,
        offset=prior @ torch.where(occurs, utilities.amax(1), 0.0),
        state_of=state_of,
        kept=kept,
        forbidden=merged >= cut,
        actions=utilities.shape[1],
    )


def undominated(utilities: Tensor) -> Tensor:
    """Actions that no other is at least as good as in every state; the first of equal ones, (K,).

    Args:
        utilities: U(ω,a), (W, A).
    """
    actions = utilities.shape[1]
    no_better = torch.ones(actions, actions, dtype=torch.bool)  # a (row) than b (column)
    for row in utilities:
        no_better &= row[:, None] <= row
        if no_better.sum() == actions:  # itself
            break
    first = torch.ones_like(no_better).tril(-1)
    return (~(no_better & (~no_better.mT | first)).any(1)).nonzero().squeeze(1)


def _mean_regrets(regrets: Tensor, prior: Tensor, percepts: int) -> tuple[Tensor, Tensor, int]:
    """R₁ (), R_k () for some k actions, at most as many as percepts, and k.

    The k actions are chosen one after the other, the one that lowers the mean most.
    """
    states, actions = regrets.shape
    single = (prior @ regrets).amin()
    count = min(percepts, states, actions)
    if count < percepts or count == min(states, actions):
        return single, torch.zeros_like(single), count
    # Beyond comparison with finite regrets, but less in fewer states.
    bar = 1e6 * regrets[regrets.isfinite()].amax() / prior.amin()
    left = torch.full((states, 1), math.inf).to(regrets)
    for _ in range(count):
        shared = torch.minimum(left, regrets.clamp(max=bar))
        left = shared[:, (prior @ shared).argmin(), None]
    # An action for every state may exist all the same where these are not enough.
    return single, prior @ left.squeeze(1).clamp(max=regrets[regrets.isfinite()].amax()), count
