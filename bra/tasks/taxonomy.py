"""The taxonomy example of Genewein, Leibfried, Grau-Moya & Braun (2015): recommendations."""

from bra.tasks.finite import FiniteTask
from bra.tasks.observations import Code

ITEMS = 13
CLASSES, HALVES = 4, 2
ITEM, CLASS, HALF = 3.0, 2.2, 1.6


class Taxonomy(FiniteTask):
    """Thirteen customers, who like an item best, then its class of three, then its half.

    Item ω is worth 3 to customer ω, class ⌈ω/3⌉ 2.2, half ⌈ω/6⌉ 1.6, all else nothing; but
    customer 10 also likes class 3, and 13, who has no class or half, likes item 12, class 4 and
    half 2 as well. Uniform prior. From Genewein et al., Frontiers in Robotics and AI 2:27, 2015,
    doi 10.3389/frobt.2015.00027.

    Args:
        observations: What the agent sees of the customer, see `observation_table`.

    Raises:
        ValueError: If the observations are unknown.
    """

    def __init__(self, observations: Code = "onehot") -> None:
        super().__init__(
            [_likes(customer) for customer in range(1, ITEMS + 1)],
            observations=observations,
            state_names=[f"customer {number}" for number in range(1, ITEMS + 1)],
            action_names=[
                *(f"item {number}" for number in range(1, ITEMS + 1)),
                *(f"class {number}" for number in range(1, CLASSES + 1)),
                *(f"half {number}" for number in range(1, HALVES + 1)),
            ],
        )


def _likes(customer: int) -> list[float]:
    """U(ω,·) of a customer, counted from 1."""
    items, classes, halves = {customer}, {(customer + 2) // 3}, {(customer + 5) // 6}
    if customer == 10:
        classes.add(3)
    if customer == 13:
        items, classes, halves = {12, 13}, {4}, {2}
    return [
        *(ITEM * (number in items) for number in range(1, ITEMS + 1)),
        *(CLASS * (number in classes) for number in range(1, CLASSES + 1)),
        *(HALF * (number in halves) for number in range(1, HALVES + 1)),
    ]
