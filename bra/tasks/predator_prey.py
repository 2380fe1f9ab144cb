"""The predator-prey example of Genewein, Leibfried, Grau-Moya & Braun (2015)."""

from typing import Literal, get_args

from bra.tasks.finite import FiniteTask
from bra.tasks.observations import Code

SIZES = (2, 3, 4, 6, 7, 8, 10, 11, 12)

HUNTING_ACTIONS = ("su2", "su3", "su4", "am6", "am7", "am8", "ambush", "sneak", "flee")
HUNTING = (
    (3.5, 2.4, 2.4, 2.3, 2.3, 2.3, 2.3, 3.0, 0.5),
    (2.4, 3.5, 2.4, 2.3, 2.3, 2.3, 2.3, 3.0, 0.5),
    (2.4, 2.4, 3.5, 2.3, 2.3, 2.3, 2.3, 3.0, 0.5),
    (1.5, 1.5, 1.5, 2.3, 1.84, 1.84, 2.3, 1.5, 0.5),
    (1.5, 1.5, 1.5, 1.84, 2.3, 1.84, 2.3, 1.5, 0.5),
    (1.5, 1.5, 1.5, 1.84, 1.84, 2.3, 2.3, 1.5, 0.5),
    *[(0.0,) * 8 + (5.0,)] * 3,
)

MATING_ACTIONS = ("display", "flee")
MATING = (
    *[(1.0, 1.0)] * 3,
    (2.5, 1.0),
    (0.5, 4.0),
    (4.0, 0.5),
    *[(0.0, 5.0)] * 3,
)

Variant = Literal["hunting", "mating"]


class PredatorPrey(FiniteTask):
    """Nine animals, known by their size: three small, three medium, three large ones.

    "hunting": sneak up on small animals (su2, su3, su4 for one each, sneak for any), ambush
    medium ones (am6, am7, am8, ambush), flee from large ones. "mating": display or flee.
    Uniform prior. Utilities from Genewein et al., Frontiers in Robotics and AI 2:27, 2015,
    doi 10.3389/frobt.2015.00027.

    Args:
        variant: "hunting" or "mating".
        observations: What the agent sees of the size: its 4-bit code as 0/1 ("binary", the
            paper's sensor) or ±1 ("bipolar"), or which animal it is ("onehot", "index").

    Raises:
        ValueError: If the variant or the observations are unknown.
    """

    def __init__(self, variant: Variant = "hunting", observations: Code = "binary") -> None:
        if variant not in get_args(Variant):
            raise ValueError(f"variant must be hunting or mating, got {variant!r}")
        hunting = variant == "hunting"
        super().__init__(
            HUNTING if hunting else MATING,
            observations=observations,
            state_names=[f"size {size}" for size in SIZES],
            action_names=HUNTING_ACTIONS if hunting else MATING_ACTIONS,
            state_numbers=SIZES,
        )
