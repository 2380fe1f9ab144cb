"""J and its terms for given channels, and what sampled entropies fall short by."""

from bra.evaluation.evaluation import Evaluation, chain_terms, evaluate
from bra.evaluation.worlds import evaluation_worlds

__all__ = ["Evaluation", "chain_terms", "evaluate", "evaluation_worlds"]
