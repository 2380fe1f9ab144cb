"""A start at which the conditions share out the outcomes."""

import torch
from torch import Tensor

from bra.checks.settings import check_real


def covering_logits(conditions: int, outcomes: int, logit: float) -> Tensor:
    """Logits under which condition k mod m favours outcome π(k) mod n, k < max(m, n); others are 0.

    π is a random permutation, drawn by torch's default generator. Every outcome is favoured by some
    condition: where there are fewer conditions than outcomes, each favours several.

    Args:
        conditions: m.
        outcomes: n.
        logit: Of the favourites.

    Returns:
        (m, n).

    Raises:
        ValueError: If `logit` is negative or not finite.
    """
    check_logit(logit)
    pairs = torch.arange(max(conditions, outcomes))
    condition, outcome = pairs % conditions, torch.randperm(len(pairs)) % outcomes
    logits = torch.zeros(conditions, outcomes)
    logits[condition, outcome] = logit
    return logits


def check_logit(logit: float) -> None:
    """Raises ValueError if the logit of favourites is negative or not finite."""
    check_real(logit, "covering_logit", "finite and at least 0", lambda logit: logit >= 0)
