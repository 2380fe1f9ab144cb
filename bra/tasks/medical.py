"""The medical example of Genewein, Leibfried, Grau-Moya & Braun (2015): specialists."""

from typing import Literal, get_args

from bra.tasks.finite import FiniteTask
from bra.tasks.observations import Code

DISEASES = ("h1", "h2", "l1", "l2", "l3", "l4")
TREATMENTS = (*DISEASES, "l12", "l34", "h", "l")
UTILITIES = (
    (3.0, 0.9, 0, 0, 0, 0, 0, 0, 1.5, 0),
    (0.9, 3.0, 0, 0, 0, 0, 0, 0, 1.5, 0),
    (0, 0, 3.0, 1.5, 0, 0, 2.5, 0, 0, 1.5),
    (0, 0, 1.5, 3.0, 0, 0, 2.5, 0, 0, 1.5),
    (0, 0, 0, 0, 3.0, 1.5, 0, 2.5, 0, 1.5),
    (0, 0, 0, 0, 1.5, 3.0, 0, 2.5, 0, 1.5),
)
PRIORS = {"uniform": None, "heart-heavy": (0.3, 0.3, 0.1, 0.1, 0.1, 0.1)}

Frequencies = Literal["uniform", "heart-heavy"]


class Medical(FiniteTask):
    """Two diseases of the heart and four of the lung, with treatments that differ in scope.

    A treatment is for one disease, for two of the lung (l12, l34), or for the heart or the lung.
    From Genewein et al., Frontiers in Robotics and AI 2:27, 2015, doi 10.3389/frobt.2015.00027.

    Args:
        frequencies: "uniform", or "heart-heavy" with h1 and h2 three times as likely as others.
        observations: What the agent sees of the disease, see `observation_table`.

    Raises:
        ValueError: If the frequencies or the observations are unknown.
    """

    def __init__(self, frequencies: Frequencies = "uniform", observations: Code = "onehot") -> None:
        if frequencies not in get_args(Frequencies):
            raise ValueError(f"frequencies must be uniform or heart-heavy, got {frequencies!r}")
        super().__init__(
            UTILITIES,
            PRIORS[frequencies],
            observations,
            state_names=DISEASES,
            action_names=TREATMENTS,
        )
