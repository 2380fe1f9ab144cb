"""Projection of both channels onto the Blahut-Arimoto equations."""

import math

import torch
from gymnasium.spaces import Discrete
from torch import Tensor

from bra.channels.spaces import feature_count
from bra.distributions import log_probabilities
from bra.objective import Objective, sampled_objective
from bra.tasks import World
from bra.tasks.base import utility_table
from bra.tasks.finite import knows_signals
from bra.update_rules.base import Chain, UpdateRule


class Projection(UpdateRule):
    """Fits each channel to its own side of the self-consistent equations, by cross-entropy.

    The loss is

        −Σ_ξ w(ξ) Σ_x p*(x|ξ) log p_θ(x|ξ) − Σ_x p(x) Σ_a p*(a|x) log p_η(a|x)

    with targets from the current channels and marginals, held constant (Genewein, Leibfried,
    Grau-Moya & Braun 2015, section 4),

        p*(x|ξ) ∝ p(x) exp(β₁ ΔF(ξ,x)),  ΔF(ξ,x) = E_{p(a|x)}[U(ω,a)] − (1/β₂) KL(p(a|x) ‖ p(a))
        p*(a|x) ∝ p(a) exp(β₂ E[U(ω,a)|x]).

    Its gradient with respect to logits is p_θ − p* and p_η − p* (times w and p(x)). It vanishes
    where that of J does, and, unlike that of J, not where a percept or an action has merely become
    improbable; `docs/reaching_the_optimum.md` derives how the two belong together.

    Where a task's states are known and its sensor is noiseless, every update sees all of them,
    w = p(ω), and nothing is sampled. Otherwise w is uniform over the batch, p(x) comes from the
    chain's marginals, and E[U(ω,a)|x] is an average over batches in which encounter i of k updates
    ago weighs decayᵏ p(x|ξ_i). It belongs to the checkpoint.

    The utilities of all actions are asked of the task.

    Args:
        decay: Of the average E[U(ω,a)|x], per update; at least 0 and less than 1.

    Raises:
        ValueError: If `decay` is outside.
    """

    percept_value: Tensor
    percept_log_weight: Tensor

    def __init__(self, decay: float = 0.98) -> None:
        super().__init__()
        if not 0 <= decay < 1:
            raise ValueError(f"decay must be at least 0 and less than 1, got {decay}")
        self.decay = decay
        self.register_buffer("percept_value", torch.zeros(0, 0))
        self.register_buffer("percept_log_weight", torch.zeros(0))

    def check(self, chain: Chain) -> None:
        """Asks for percepts and actions that can be enumerated, and makes room for averages."""
        percepts, actions = chain.perception.outcome_space, chain.action.outcome_space
        for name, space in (("percepts", percepts), ("actions", actions)):
            if not isinstance(space, Discrete):
                raise ValueError(
                    f"Projection needs {name} that can be enumerated, got {space}; "
                    "use ScoreFunction"
                )
        if not knows_signals(chain.task):
            self.percept_value = torch.zeros(feature_count(percepts), feature_count(actions))
            self.percept_log_weight = torch.full((feature_count(percepts),), -math.inf)

    def sees_worlds(self, chain: Chain) -> bool:
        """Only where the task's signals are not all known."""
        return not knows_signals(chain.task)

    def loss(self, chain: Chain, world: World) -> tuple[Tensor, Objective[Tensor]]:
        """Both cross-entropies, over all states if they are known, else over the batch."""
        task, device = chain.task, world.state.device
        known = knows_signals(task)
        if knows_signals(task):
            world = World(*(part.to(device) for part in task.states()))
            log_weight = task.prior.to(device, torch.get_default_dtype()).log()
        else:
            count = len(world.state)
            log_weight = torch.full((count,), -math.log(count), device=device)
        percept_given = chain.perception(world.observation)
        log_percept = log_probabilities(percept_given)
        action_given = chain.action.forward_all()
        log_action = log_probabilities(action_given)

        with torch.no_grad():
            actions = action_given.enumerate_support(expand=False).flatten()
            utilities = utility_table(task, world.state, actions)
            log_joint = log_weight.unsqueeze(-1) + log_percept
            if known:
                log_percept_marginal = log_joint.logsumexp(0)
                value = (log_joint - log_percept_marginal).exp().T @ utilities
            else:
                marginal = chain.marginals.percept(task, chain.perception, percept_given, device)
                log_percept_marginal = log_probabilities(marginal)
                value = self._percept_value(log_joint, utilities)
            log_action_marginal = (log_percept_marginal.unsqueeze(-1) + log_action).logsumexp(0)

            weight, percept_marginal = log_weight.exp(), log_percept_marginal.exp()
            action_cost = divergence(log_action, log_action_marginal)
            utility_given = utilities @ log_action.exp().T
            free_energy = utility_given - action_cost / chain.beta_action
            percept_target = (log_percept_marginal + chain.beta_perception * free_energy).softmax(
                -1
            )
            action_target = (log_action_marginal + chain.beta_action * value).softmax(-1)

            expected_utility = (log_joint.exp() * utility_given).sum()
            perception_information = weight @ divergence(log_percept, log_percept_marginal)
            action_information = percept_marginal @ action_cost
            terms = Objective(
                sampled_objective(
                    expected_utility,
                    perception_information,
                    action_information,
                    chain.beta_perception,
                    chain.beta_action,
                ),
                expected_utility,
                perception_information,
                action_information,
            )
        perception_loss = -(weight @ (percept_target * log_percept).sum(-1))
        action_loss = -(percept_marginal @ (action_target * log_action).sum(-1))
        return perception_loss + action_loss, terms

    def _percept_value(self, log_joint: Tensor, utilities: Tensor) -> Tensor:
        """E[U(ω,a)|x], (X, A), after this batch has been averaged in.

        Args:
            log_joint: log w(ξ_i) p(x|ξ_i), (B, X).
            utilities: U(ω_i, a), (B, A).
        """
        log_batch = log_joint.logsumexp(0)
        log_new = log_batch + math.log(1 - self.decay)
        log_old = self.percept_log_weight + math.log(self.decay) if self.decay else -math.inf
        log_sum = torch.logaddexp(log_new, torch.as_tensor(log_old).to(log_new))
        self.percept_log_weight.copy_(log_sum)
        mean = (log_joint - log_batch).exp().T @ utilities
        share = (log_new - log_sum).exp().unsqueeze(-1)
        self.percept_value.add_(share * (mean - self.percept_value))  # vmap knows no lerp_
        return self.percept_value


def divergence(log_p: Tensor, log_q: Tensor) -> Tensor:
    """KL(p ‖ q) from logarithms, in nats; unlike from probabilities, finite at saturation.

    Args:
        log_p: (…, Y).
        log_q: (Y,).

    Returns:
        (…).
    """
    p = log_p.exp()
    return torch.where(p > 0, p * (log_p - log_q), 0.0).sum(-1)
