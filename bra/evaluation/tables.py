"""Both channels as tables over a support.

The support of an enumerable channel is all its outcomes; that of a density is a sample of its
marginal, on which p(y|c)/p(y) is exact and sums become Monte Carlo integrals.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.distributions import Distribution, Independent

from bra.chain import Chain
from bra.channels.distributions import Categorical, probabilities
from bra.objective import shared_part

SUPPORT_SIZE = 2048
"""Points by which the support of a density is sampled."""
LEAST = 1e-6
"""Least probability beyond a point."""


@dataclass(frozen=True)
class Tables:
    """The channels over C signals.

    Attributes:
        percept_given_signal: p(x|ξ), (C, X), float64.
        action_given_percept: p(a|x), (X, A), float64.
        second_look: p(a|x,ξ), (X, C, A), where actions look at the signal again, else None.
        actions: The support of the actions, (A, *event shape).
        enumerable_percepts: Whether percepts are no sample but all there are.
        enumerable_actions: Whether actions are.
    """

    percept_given_signal: Tensor
    action_given_percept: Tensor
    actions: Tensor
    enumerable_percepts: bool
    enumerable_actions: bool
    second_look: Tensor | None = None

    @property
    def action_given_signal(self) -> Tensor:
        """p(a|ξ) = Σ_x p(x|ξ) p(a|x), (C, A)."""
        if self.second_look is not None:
            return torch.einsum("cx,xca->ca", self.percept_given_signal, self.second_look)
        return self.percept_given_signal @ self.action_given_percept

    @property
    def pairs_given_signal(self) -> Tensor:
        """p(x,a|ξ), (C, X·A), of actions that look at the signal again."""
        return torch.einsum("cx,xca->cxa", self.percept_given_signal, self.second_look).flatten(1)


def tabulate_chain(chain: Chain, observation: Tensor, weights: Tensor) -> Tables:
    """The channels of a chain over signals ξ, (C, …), of weights (C,), float64, summing to one."""
    percept_given = chain.perception(observation)
    percepts, percept_table = tabulate(weights, percept_given)
    look = None
    if chain.looks:
        action_given = chain.second_look(observation)
        joint = weights.unsqueeze(-1) * percept_table
        actions, look = tabulate(joint.mT, action_given)
        action_table, _ = shared_part(joint, look)
    else:
        action_given = chain.action(percepts)
        actions, action_table = tabulate(weights @ percept_table, action_given)
    return Tables(
        percept_table,
        action_table,
        actions,
        percept_given.has_enumerate_support,
        action_given.has_enumerate_support,
        look,
    )


def tabulate(weights: Tensor, conditional: Distribution) -> tuple[Tensor, Tensor]:
    """A channel as a table over a support.

    For a density, the support y_t is a stratified sample of p(y) = Σ_c w_c p(y|c), each point
    standing for a mass v_t, and the table is v_t p(y_t|c)/p(y_t), rows normalised. Points of one
    condition follow each other, from one end of their distribution to the other.

    Args:
        weights: w_c, (*batch,), float64, summing to one.
        conditional: p(y|c), batch shape (*batch,).

    Returns:
        Support (Y, *event shape), and table (*batch, Y), float64, rows summing to one.
    """
    if conditional.has_enumerate_support:
        support = conditional.enumerate_support(expand=False).flatten()
        exact = conditional.double() if isinstance(conditional, Categorical) else conditional
        table = probabilities(exact).double()
        return support, table / table.sum(-1, keepdim=True)
    massive = weights > 0
    draws = -(-SUPPORT_SIZE // int(massive.sum()))
    support = spread(conditional, draws)[:, massive].transpose(0, 1).flatten(0, 1)
    mass = weights[massive].repeat_interleave(draws) / draws
    if len(mass) >= 2 * SUPPORT_SIZE:
        support = support[systematic(mass, SUPPORT_SIZE)]
        mass = torch.full_like(mass[:SUPPORT_SIZE], 1 / SUPPORT_SIZE)
    points = support.reshape(-1, *[1] * weights.ndim, *conditional.event_shape)
    log_density = conditional.log_prob(points).double().movedim(0, -1)
    log_joint = weights.log().unsqueeze(-1) + log_density
    log_marginal = torch.logsumexp(log_joint.flatten(0, -2), 0)
    return support, (mass.log() + log_density - log_marginal).softmax(-1)


def spread(conditional: Distribution, draws: int) -> Tensor:
    """So many draws for each condition, (draws, *batch shape, *event shape), evenly spread.

    One lies in each of so many equally probable parts of what a condition makes of each dimension,
    in order along the first of them; and among the draws of the same part, conditions share it out
    again (a Latin hypercube; McKay, Beckman & Conover 1979). Distributions without an inverse of
    their distribution function are drawn from as they are.
    """
    drawn = conditional.sample((draws,))
    base = conditional.base_dist if isinstance(conditional, Independent) else conditional
    shape = (draws, conditional.batch_shape.numel(), conditional.event_shape.numel())
    parts = torch.rand(shape).argsort(0)
    parts[..., :1] = torch.arange(draws)[:, None, None]
    within = (torch.rand(shape).argsort(1) + torch.rand(shape)) / shape[1]
    levels = ((parts + within) / draws).clamp(LEAST, 1 - LEAST).reshape(drawn.shape)
    try:
        found: Tensor = base.icdf(levels.to(drawn.device))
    except NotImplementedError:
        return drawn
    return found.to(drawn)


def systematic(mass: Tensor, count: int) -> Tensor:
    """So many numbers of points, each as often as its share of the mass, or the next whole number.

    Args:
        mass: Of the points, summing to one.
        count: How many.
    """
    levels = (torch.arange(count, dtype=mass.dtype, device=mass.device) + 0.5) / count
    return torch.searchsorted(mass.cumsum(0), levels).clamp(max=len(mass) - 1)
