"""Secants of the entropy of action marginals, and which actions stand for each other."""

import numpy as np

from bra.blahut_arimoto.concave_envelope import Floats


def secant(low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Slopes m and intercepts i of the secants of −q log q between l and u > l."""
    below, above = _entropy(low), _entropy(high)
    slope = (above - below) / (high - low)
    return slope, below - slope * low


def secant_loss(low: Floats, high: Floats, q: Floats) -> Floats:
    """What the secants of −q log q between l and u leave out at q."""
    slope, intercept = secant(low, high)
    return _entropy(q) - slope * q - intercept


def _entropy(q: Floats) -> Floats:
    return -q * np.log(np.where(q > 0, q, 1))


def interchangeable(utilities: Floats, prior: Floats) -> list[list[int]]:
    """Classes of two actions or more, any of which may be exchanged along with some states."""

    def ordered(table: Floats) -> Floats:
        return table[np.lexsort(table.T)]

    table = np.column_stack((prior, utilities))
    classes: list[list[int]] = []
    for action in range(1, table.shape[1]):
        column = ordered(table[:, [0, action]])
        for members in classes:
            first = members[0]
            if np.array_equal(column, ordered(table[:, [0, first]])):
                swapped = table.copy()
                swapped[:, [first, action]] = table[:, [action, first]]
                if np.array_equal(ordered(swapped), ordered(table)):
                    members.append(action)
                    break
        else:
            classes.append([action])
    return [[action - 1 for action in members] for members in classes if len(members) > 1]
