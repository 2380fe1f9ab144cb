"""Update rules: how encounters move the channels."""

from bra.chain import Chain
from bra.update_rules.base import UpdateRule
from bra.update_rules.exact_gradient import ExactGradient
from bra.update_rules.projection import Projection
from bra.update_rules.rivals import Rivals
from bra.update_rules.score_function import ScoreFunction

__all__ = ["Chain", "ExactGradient", "Projection", "Rivals", "ScoreFunction", "UpdateRule"]
