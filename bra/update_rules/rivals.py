"""Meanings of percepts that compete before the channels settle on one."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from bra.chain import Chain
from bra.channels.distributions import log_normalise
from bra.checkpoints.recipes import Rebuildable
from bra.checks.settings import check_count
from bra.update_rules.sweeps import sweep_chain

FAVOUR = 5.0
"""Logit by which a percept of a fresh rival favours its action."""
KEPT = 0.02
"""Share of the targets that specialists keep from what stays."""
CERTAIN = 30.0
"""Logit of the action that all percepts of the best constant action take."""
MARGIN = 1e-3
"""By how much a rival has to be better, as a share of what information is worth at most.

The same optimum under other names of percepts is no better, whatever the rounding. The best
constant action needs no margin: it is what no agent should fall short of.
"""


class Aim(NamedTuple):
    """What the channels are fitted to.

    Attributes:
        percept: p*(x|ω), (W, X).
        action: p*(a|x), (X, A), or p*(a|x,ω), (X, W, A).
        weight: p(x) by which the rows of p*(a|x) weigh, (X,).
    """

    percept: Tensor
    action: Tensor
    weight: Tensor


class Rivals(Rebuildable, nn.Module):
    """Meanings that percepts might take, tried one after the other in tables beside the channels.

    Which optimum the projection rule ends at is decided early, by which percept comes to stand for
    which action. Here the channels' own start is swept by the self-consistent equations, and so is
    a rival: percepts that share out a random part of the actions. After `sweeps` updates, one sweep
    in each, the one of higher J stays, and the next rival comes up. The last of them is the best
    that percepts which mean nothing allow: the best constant action, or, where actions look at the
    state again, one channel. The channels are meanwhile fitted to what stays, and let go little by
    little in the `lead` updates after that: targets are a mixture of probabilities, those of what
    stays with the share s, the rule's own with 1 − s,

        s = min(1, max(0, settled − update) / lead),   settled = count · sweeps + lead.

    From there on the rule knows its own channels alone, as ever, and what they cannot represent is
    theirs to settle. Where actions look at the state again s ends at 0.02: what networks do not
    fit exactly adds up there, and their own targets would not hold them.

    J is exact, at the prices of the update and with the utilities that the rule knows: those of the
    task or what a critic has learnt so far. A sweep costs as much as the targets do.

    Args:
        count: Rivals that come up.
        sweeps: Sweeps of each.
        lead: Updates over which the channels are let go after that.

    Raises:
        ValueError: If a number is less than 1.
    """

    log_action: Tensor
    log_marginal: Tensor

    def __init__(self, count: int = 60, sweeps: int = 10, lead: int = 600) -> None:
        super().__init__()
        self.count = check_count(count, "rivals count")
        self.sweeps = check_count(sweeps, "rivals sweeps")
        self.lead = check_count(lead, "rivals lead")
        self.register_buffer("log_action", torch.zeros(2, 0, 0))
        self.register_buffer("log_marginal", torch.zeros(2, 0))

    @property
    def settled(self) -> int:
        """Updates after which the channels go their own way, or are led no less."""
        return self.count * self.sweeps + self.lead

    def make_room(self, percepts: int, actions: int) -> None:
        """Creates the tables: of what stays, and of its rival."""
        self.log_action = torch.zeros(2, percepts, actions)
        self.log_marginal = torch.zeros(2, percepts)

    def guide(
        self,
        aim: Aim,
        chain: Chain,
        log_action: Tensor,
        log_marginal: Tensor,
        log_weight: Tensor,
        utilities: Tensor,
    ) -> Aim:
        """Sweeps both tables once, lets them meet when it is time, and says where to go.

        Args:
            aim: Where the rule would go by itself.
            chain: Gives prices, number of the update and random numbers.
            log_action: log p(a|x) of the channels, (X, A); where actions look again, the mean.
            log_marginal: log p(x) of the channels, (X,).
            log_weight: log p(ω), (W,).
            utilities: U(ω,a), (W, A).
        """
        update = torch.as_tensor(chain.update, device=log_weight.device)
        value = log_weight.exp() @ utilities
        compete = update < self.count * self.sweeps
        begins = torch.stack([update == 0, compete & (update % self.sweeps == 0)])
        last = update >= (self.count - 1) * self.sweeps
        silent = torch.zeros_like(value) if chain.looks else CERTAIN * _is_best(value)
        rival = torch.where(last, log_normalise(silent), self._fresh(chain, log_action))
        flat = torch.full_like(log_marginal, 1 / len(log_marginal)).log()
        found = sweep_chain(
            chain,
            torch.where(begins[:, None, None], torch.stack([log_action, rival]), self.log_action),
            torch.where(begins[:, None], torch.stack([log_marginal, flat]), self.log_marginal),
            log_weight,
            utilities,
        )
        worth = log_weight.exp() @ utilities.amax(-1) - value.amax()
        own, other = found.objective
        meet = compete & ((update + 1) % self.sweeps == 0)
        loses = meet & (other > own + torch.where(last, 0.0, MARGIN * worth))
        self.log_action.copy_(_let_win(loses, found.log_action))
        self.log_marginal.copy_(_let_win(loses, found.log_marginal))
        least = KEPT if chain.looks else 0.0
        share = ((self.settled - update.to(log_weight)) / self.lead).clamp(least, 1)
        response = found.log_action if found.log_look is None else found.log_look
        led = (found.log_percept[0], response[0], found.log_marginal[0])
        return Aim(*(_mixed(p, log.exp(), share) for log, p in zip(led, aim, strict=True)))

    def _fresh(self, chain: Chain, like: Tensor) -> Tensor:
        """Log p(a|x), (X, A), of percepts that share out k ~ U{1 … A} actions, but for noise."""
        percepts, actions = like.shape
        kind = {"dtype": like.dtype, "device": like.device}
        size = 1 + (chain.uniform((1,), **kind) * actions).long()
        order = chain.uniform((actions,), **kind).argsort()
        favourite = order[torch.arange(percepts, device=like.device) % size]
        favours = favourite.unsqueeze(-1) == torch.arange(actions, device=like.device)
        noise = 4 * chain.uniform((percepts, actions), **kind)
        return log_normalise(FAVOUR * favours + noise)


def _mixed(own: Tensor, led: Tensor, share: Tensor) -> Tensor:
    """Own probabilities, of which a share () is led."""
    return torch.lerp(own, led.to(own), share.to(own))


def _is_best(value: Tensor) -> Tensor:
    """1 for the action of the highest value, (A,), else 0."""
    best = torch.arange(len(value), device=value.device) == value.argmax()
    return best.to(value.dtype)


def _let_win(loses: Tensor, tables: Tensor) -> Tensor:
    """Both tables, with the second in the first one's place if that has lost."""
    return torch.stack([torch.where(loses, tables[1], tables[0]), tables[1]])
