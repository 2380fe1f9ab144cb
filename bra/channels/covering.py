"""A start at which the conditions share out the outcomes."""

import math

import torch
from torch import Tensor


def covering_logits(conditions: int, outcomes: int, logit: float) -> Tensor:
    """Logits under which condition c favours outcome π(c) mod `outcomes`; all others are 0.

    π is a random permutation, drawn by torch's default generator. With no fewer conditions than
    outcomes every outcome is favoured by some condition; with fewer, each condition favours
    another outcome.

    Args:
        conditions: m.
        outcomes: n.
        logit: Of the favourite.

    Returns:
        (m, n).

    Raises:
        ValueError: If `logit` is negative or not finite.
    """
    if not 0 <= logit < math.inf:
        raise ValueError(f"covering_logit must be finite and at least 0, got {logit}")
    favourite = torch.randperm(max(conditions, outcomes))[:conditions] % outcomes
    return logit * torch.nn.functional.one_hot(favourite, outcomes).to(torch.get_default_dtype())
