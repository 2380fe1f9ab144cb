"""Projection of both channels onto the Blahut-Arimoto equations."""

import copy
import math
from dataclasses import replace
from typing import Any

import torch
from gymnasium.spaces import Discrete
from torch import Tensor
from torch.distributions import Distribution

from bra.chain import Chain
from bra.channels.distributions import log_probabilities
from bra.channels.spaces import feature_count
from bra.checks.settings import check_part, check_real, in_updates
from bra.critics import Critic, Exploration, StatePosterior
from bra.marginals import average_in, mean_action, posterior
from bra.objective import Objective
from bra.tasks import FiniteStateTask, Task, World, knows_signals
from bra.tasks.base import from_best
from bra.tasks.finite import utility_table
from bra.tasks.signals import over_signals
from bra.update_rules.base import UpdateRule
from bra.update_rules.rivals import Aim, Rivals
from bra.update_rules.targets import FLOOR, cross_entropy, project, project_looks


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
    w = p(ω), and nothing is sampled; likewise all signals, w = p(s), where the task gives p(s|ω).
    Otherwise w is uniform over the batch, p(x) comes from the chain's marginals, and
    E[U(ω,a) − max U(ω,·)|x] is an average over batches in which encounter i of k updates ago weighs
    decayᵏ p(x|ξ_i). It belongs to the checkpoint.

    Where the sensor of known states is noisy, E[U(ω,a)|ξ] takes the place of U(ω,a), by a
    `StatePosterior` that is learnt beside the channels: p* is no linear function of U, and the mean
    of p* over the states behind a signal would have perception guess each of them as often as it
    occurs. Where states are not known, a critic does as much.

    The utilities of all actions are asked of the task; or they are those of a critic, which learns
    them from the actions that are taken. Then the utility of no other action is ever asked for, the
    known states lend their signals and p(ω) only, and E[U] and J as an update sees them are those
    that the critic promises.

    Actions that look at the signal again are fitted to p*(a|x,ξ), see `targets.project_looks`, with
    weights w(ξ) p(x): what a specialist would do for those who are not sent to him decides who is.
    p(a|x) then comes from where p(x) does. A critic need not see the percept, which is made from
    the signal alone: E[U(ω,a)|ξ,x] = E[U(ω,a)|ξ].

    With `rivals`, the targets of the first part of a run come from tables that compete for the
    best meaning of the percepts; see there.

    Args:
        decay: Of the average E[U(ω,a)|x], per update; at least 0 and less than 1.
        critic: Learns the utilities; None asks the task for them.
        exploration: How often actions are uniform, for the critic's sake; None for never.
        rivals: Meanings of the percepts that compete at first, for tasks whose signals are known;
            None leaves the channels to their start.

    Raises:
        ValueError: If `decay` is outside, or there is exploration and no critic.
    """

    percept_value: Tensor
    percept_log_weight: Tensor
    looks = True
    _seen: Task | None = None  # the task, with signals for states where p(s|ω) is known

    def __init__(
        self,
        decay: float = 0.98,
        critic: Critic | None = None,
        exploration: Exploration | None = None,
        rivals: Rivals | None = None,
    ) -> None:
        super().__init__()
        expected = "at least 0 and less than 1"
        check_real(decay, "decay", expected, lambda decay: 0 <= decay < 1)
        check_part(critic, Critic, "critic")
        check_part(exploration, Exploration, "exploration")
        check_part(rivals, Rivals, "rivals")
        if exploration and not critic:
            raise ValueError("exploration serves a critic, got none; add one or leave it out")
        self.decay, self.critic, self.exploration = decay, copy.deepcopy(critic), exploration
        self.rivals = copy.deepcopy(rivals)
        self.states: StatePosterior | None = None
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
        self._seen = seen = over_signals(chain.task)
        if not knows_signals(seen) and not chain.looks:
            self.percept_value = torch.zeros(feature_count(percepts), feature_count(actions))
            self.percept_log_weight = torch.full((feature_count(percepts),), -math.inf)
        if self.critic:
            self.critic.check(chain.task)
        elif isinstance(seen, FiniteStateTask) and not seen.noiseless:
            self.states = StatePosterior(seen)
        if self.rivals:
            self._check_rivals(self.rivals, chain)

    def _task(self, chain: Chain) -> Task:
        """That of the chain; with signals for states where it says how they come about."""
        return self._seen or over_signals(chain.task)

    def _check_rivals(self, rivals: Rivals, chain: Chain) -> None:
        if not knows_signals(self._task(chain)):
            raise ValueError(
                f"rivals compete over known states and signals, which {type(chain.task).__name__} "
                "has not; leave them out"
            )
        spaces = (chain.perception.outcome_space, chain.action.outcome_space)
        rivals.make_room(*map(feature_count, spaces))

    def settle(self, run: int) -> None:
        """The lengths of the exploration."""
        self.exploration = self.exploration and self.exploration.settled(run)

    def given_arguments(self) -> dict[str, Any]:
        """As given, with the exploration's lengths as they were settled."""
        given = super().given_arguments()
        return given | ({"exploration": self.exploration} if self.exploration else {})

    def metrics(self) -> dict[str, float]:
        """`critic/rmse`, by how much utilities surprise the critic."""
        return {"critic/rmse": self.critic.rmse} if self.critic else {}

    def sees_worlds(self, chain: Chain) -> bool:
        """Where the task's signals are not all known, or a critic learns from encounters."""
        return self.critic is not None or not knows_signals(self._task(chain))

    def loss(self, chain: Chain, world: World) -> tuple[Tensor, Objective[Tensor]]:
        """Both cross-entropies, over all states if they are known, else over the batch."""
        if self.critic:
            self._encounter(self.critic, chain, world)
        if (task := self._task(chain)) is not chain.task:
            chain = replace(chain, task=task)
        observation, utilities, level, log_weight = self._problem(chain, world)
        percept_given = chain.perception(observation)
        looks, action_given = chain.looks, chain.responses(observation)
        log_percept, log_action = map(log_probabilities, (percept_given, action_given))
        weight = log_weight.exp()
        with torch.no_grad():
            log_joint = log_weight.unsqueeze(-1) + log_percept
            log_marginal = self._log_marginal(chain, log_joint, percept_given)
            tables = (log_weight, log_percept, log_action, log_marginal)
            if looks:
                log_shared = self._log_shared(chain, log_joint, action_given)
                targets = project_looks(chain, *tables, log_shared, utilities)
            else:
                log_shared = log_action
                value = self._percept_value(chain, log_joint, log_marginal, utilities)
                targets = project(chain, *tables, utilities, value)
            aim = Aim(targets.percept, targets.action, log_marginal.exp())
            if self.rivals:
                found = (log_shared, log_marginal, log_weight, utilities)
                aim = self.rivals.guide(aim, chain, *found)
        action_error = cross_entropy(aim.action, log_action)
        action_loss = aim.weight @ (action_error @ weight if looks else action_error)
        loss = weight @ cross_entropy(aim.percept, log_percept) + action_loss
        if self.exploration:  # the channels wait for the critic
            loss = loss * (chain.update >= in_updates(self.exploration.uniform_updates))
        return loss, targets.terms.raised(level)

    @torch.no_grad()
    def _problem(self, chain: Chain, world: World) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """What the channels are fitted on.

        Returns:
            ξ (B, …); U(ω,a) − max U(ω,·), (B, A); E[max U(ω,·)], (), float64; log w(ξ) (B,).
        """
        task, device = chain.task, world.state.device
        actions = torch.arange(feature_count(chain.action.outcome_space), device=device)
        if knows_signals(task):
            state, observation = (part.to(device) for part in task.states())
            weight = task.prior.to(device)
        else:
            state, observation = world
            if self.critic:
                observation = self.critic.recall(observation, chain.uniform)
            count = len(observation)
            weight = torch.full((count,), 1 / count, dtype=torch.double, device=device)
        if self.critic:
            utilities = self.critic(observation)
        elif self.states:
            every = torch.arange(self.states.count, device=device)
            shares = self.states.learn(observation, state)
            utilities = shares @ utility_table(task, every, actions).double()
        else:
            utilities = utility_table(task, state, actions)
        regrets, best = from_best(utilities)
        return observation, regrets, weight @ best, weight.log().to(regrets)

    @torch.no_grad()
    def _encounter(self, critic: Critic, chain: Chain, world: World) -> None:
        """Acts once in every world, and lets the critic learn from what comes of it."""
        percept = chain.draw(chain.perception(world.observation))
        action = chain.draw(chain.act(percept, world.observation))
        if self.exploration:
            kind = {"dtype": torch.get_default_dtype(), "device": action.device}
            other, explores = chain.uniform((2, *action.shape), **kind)
            chance = self.exploration.probability(chain.update)
            actions = feature_count(chain.action.outcome_space)
            action = torch.where(explores < chance, (other * actions).long(), action)
        utility = chain.task.utility(world.state, action).double()
        critic.take(world.observation, action, utility, chain.uniform)

    def _log_marginal(self, chain: Chain, log_joint: Tensor, percept_given: Distribution) -> Tensor:
        """Log p(x), (X,)."""
        if knows_signals(chain.task):
            return log_joint.logsumexp(0)
        parts = (chain.task, chain.perception, percept_given, log_joint.device)
        return log_probabilities(chain.marginals.percept(*parts))

    def _log_shared(self, chain: Chain, log_joint: Tensor, second_look: Distribution) -> Tensor:
        """Log p(a|x), (X, A), where actions look at the signal again."""
        known = knows_signals(chain.task)
        mean = mean_action if known else chain.marginals.shared_action
        return log_probabilities(mean(log_joint, second_look)).clamp(min=math.log(FLOOR))

    def _percept_value(
        self, chain: Chain, log_joint: Tensor, log_marginal: Tensor, utilities: Tensor
    ) -> Tensor:
        """E[U(ω,a) − max U(ω,·)|x], (X, A), with this batch where signals are not all known.

        Args:
            chain: What is trained.
            log_joint: log w(ξ_i) p(x|ξ_i), (B, X).
            log_marginal: log p(x), (X,).
            utilities: U(ω_i,a) − max U(ω_i,·), (B, A).
        """
        if knows_signals(chain.task):
            return posterior(log_joint, log_marginal).mT @ utilities
        average = (self.percept_value, self.percept_log_weight)
        average_in(*average, log_joint, utilities, self.decay)
        return self.percept_value
