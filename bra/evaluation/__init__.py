"""J and its terms for given channels, and what sampled entropies fall short by."""

from bra.evaluation.evaluation import Evaluation, evaluate_channels, evaluation_worlds

__all__ = ["Evaluation", "evaluate_channels", "evaluation_worlds"]
