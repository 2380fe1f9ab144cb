"""The paper's on-line rule: a score-function gradient from sampled encounters."""

from typing import Literal, get_args

import torch
from torch import Tensor
from torch.distributions import Distribution

from bra.chain import Chain
from bra.channels.distributions import mixture, probabilities
from bra.checks.settings import check_count
from bra.objective import Objective, sampled_objective
from bra.tasks import FiniteTask, World
from bra.update_rules.base import UpdateRule

Baseline = Literal["none", "running", "leave-one-out"]

RUNNING_DECAY = 0.99


class ScoreFunction(UpdateRule):
    """∂J/∂θ = E[∂ log p(x|ξ)/∂θ · (j − b)], ∂J/∂η = E[∂ log p(a|x)/∂η · (j − b)].

    The rule of Peng, Genewein, Leibfried & Braun (IROS 2017), with N = batch size × `samples`
    encounters per update. The derivative of j itself vanishes in expectation, also through the
    marginals, because scores have zero mean; for the same reason a baseline b that does not
    depend on the encounter at hand changes the variance and not the mean. Tables of utilities that
    are far from 0 are counted from the `origins` of their task.

    Where actions look at the signal again, the score is that of p(a|x,ξ), and

        j = U(ω,a) − (1/β₁) log p(x|ξ)/p(x) − (1/β₂) log p(a|x)/p(a) − (1/β₃) log p(a|x,ξ)/p(a|x),

    whose mean over ω, x and a is J. Its derivative vanishes in expectation here too: p(a|x) =
    Σ_ξ p(ξ|x) p(a|x,ξ) is the distribution of a given x, whatever both channels are, so that
    E[∂ log p(a|x)|x] = ∂ Σ_a p(a|x) = 0, and so it is with p(a), p(x) and p(a|x,ξ).

    Args:
        samples: Percepts and actions drawn per world-state.
        baseline: "none" (the paper); "running", the mean of j over the last hundred updates or
            so, weights falling by 0.99 per update; or "leave-one-out", the mean of j over the
            other samples of the same world-state.

    Raises:
        ValueError: If `samples` is less than 1 (or 2 for leave-one-out), or `baseline` unknown.
    """

    running_sum: Tensor
    running_weight: Tensor
    looks = True

    def __init__(self, samples: int = 1, baseline: Baseline = "none") -> None:
        super().__init__()
        if baseline not in get_args(Baseline):
            raise ValueError(f"baseline must be none, running or leave-one-out, got {baseline!r}")
        check_count(samples, "samples")
        if baseline == "leave-one-out" and samples < 2:
            raise ValueError(f"a leave-one-out baseline needs samples ≥ 2, got {samples}")
        self.samples = samples
        self.baseline = baseline
        self.register_buffer("running_sum", torch.zeros(()))
        self.register_buffer("running_weight", torch.zeros(()))

    def loss(self, chain: Chain, world: World) -> tuple[Tensor, Objective[Tensor]]:
        """−mean[(log p(x|ξ) + log p(a|x)) (j − b)], j and b held constant."""
        percept_given = chain.perception(world.observation)
        drawn = chain.draw(percept_given, (self.samples,))
        percept_score = percept_given.log_prob(drawn).flatten()
        percept = drawn.flatten(0, 1)
        state, observation = (
            part.expand(self.samples, *part.shape).flatten(0, 1) for part in world
        )
        action_given = chain.act(percept, observation)
        action = chain.draw(action_given)
        action_score = action_given.log_prob(action)

        with torch.no_grad():
            task, origin = chain.task, torch.zeros(())
            if isinstance(task, FiniteTask):
                origin = task.origins.to(state.device)[state]
            utility = (task.utility(state, action) - origin).to(percept_score)
            percept_marginal = chain.marginals.percept(
                chain.task, chain.perception, percept_given, percept.device
            )
            shared = chain.shared_action(world.observation) if chain.looks else None
            if shared is None:
                action_marginal = chain.marginals.action(chain.action, percept_marginal)
                shared_score, direct_cost = action_score, None
            else:
                action_marginal = mixture(probabilities(percept_marginal), shared)
                shared_score = _score(shared, percept, action)
                direct_cost = action_score - shared_score
            perception_cost = percept_score - percept_marginal.log_prob(percept)
            costs = (perception_cost, shared_score - action_marginal.log_prob(action))
            prices = (chain.beta_perception, chain.beta_action)
            j = sampled_objective(utility, *costs, *prices, direct_cost, chain.beta_direct)
            advantage = j - self._baseline(j)
        loss = -((percept_score + action_score) * advantage).mean()
        known = [j, utility, *costs, direct_cost]
        means = torch.stack([term for term in known if term is not None]).mean(1)
        return loss, Objective(*means).raised(origin.double().mean())

    def _baseline(self, j: Tensor) -> Tensor | float:
        match self.baseline:
            case "running":
                # Known before this update, hence independent of its encounters.
                known = self.running_sum / self.running_weight.clamp_min(1 - RUNNING_DECAY)
                # Not by lerp_, which vmap does not know.
                self.running_sum.mul_(RUNNING_DECAY).add_((1 - RUNNING_DECAY) * j.mean())
                self.running_weight.mul_(RUNNING_DECAY).add_(1 - RUNNING_DECAY)
                return known
            case "leave-one-out":
                grouped = j.reshape(self.samples, -1)
                others = (grouped.sum(0) - grouped) / (self.samples - 1)
                return others.flatten()
        return 0.0


def _score(shared: Distribution, percept: Tensor, action: Tensor) -> Tensor:
    """Log p(a|x), (N,), of percepts (N,) and actions (N, …), from p(a|x) of batch shape (X,)."""
    of_all: Tensor = shared.log_prob(action.unsqueeze(1))
    return of_all.gather(1, percept.unsqueeze(1)).squeeze(1)
