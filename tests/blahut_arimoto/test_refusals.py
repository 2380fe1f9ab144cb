import math

import numpy as np
import pytest
import torch
from problems import IDENTITY

from bra.blahut_arimoto import general, rate_distortion, serial

# Every state forbids the best actions of all others.
FORBIDDING = [[0.0 if a == w else -math.inf for a in range(3)] for w in range(3)]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"utilities": [1.0, 2.0]}, r"utilities must be a table.*got shape \(2,\)"),
        ({"utilities": []}, "utilities must be a table.*got shape"),
        ({"utilities": [[]]}, "utilities must be a table.*got shape"),
        ({"utilities": [[1.0, 2.0], [3.0]]}, r"rows of equal length, got \[\[1.0"),
        ({"utilities": "table"}, "utilities must be a table.*got 'table'"),
        ({"utilities": None}, "utilities must be a table.*got None"),
        ({"utilities": [[1.0, math.nan], [0.0, 1.0]]}, "got nan in row 0, column 1"),
        (
            {"utilities": [[1.0, 0.0], [math.inf, 1.0]]},
            "-inf for a.*got inf in row 1, column 0",
        ),
        ({"utilities": [[1.0, 0.0], [-math.inf, -math.inf]]}, "an action.*-inf for all of row 1"),
        ({"prior": [0.5, 0.6]}, "prior must sum to 1, got 1.1; divide"),
        ({"prior": [1.5, -0.5]}, r"prior must be finite and not negative, got \[1.5, -0.5\]"),
        ({"prior": [math.nan, 1.0]}, r"prior must be .*got \[nan, 1.0\]"),
        ({"prior": [0.2, 0.3, 0.5]}, r"each of 2 states, got shape \(3,\); None"),
        ({"prior": "even"}, "each of 2 states, got 'even'"),
        ({"beta": 0.0}, "beta must be positive and finite, got 0; .*large number"),
        ({"beta": -1.0}, "beta must be positive and finite, got -1"),
        ({"beta": [1.0, math.nan]}, "beta must be positive and finite, got nan"),
        ({"beta": math.inf}, "beta must be positive and finite, got inf"),
        ({"beta": [1.0, 1e-320]}, "price that numbers cannot hold, got 9.99989e-321"),
        ({"beta": []}, r"beta must hold at least one number, got shape \(0,\)"),
        ({"beta": "high"}, "beta must be a number or an array of numbers, got 'high'"),
    ],
)
def test_rate_distortion_refuses(arguments, words):
    accepted = {"utilities": IDENTITY, "prior": [0.5, 0.5], "beta": 1.0}
    with pytest.raises(ValueError, match=words) as caught:
        rate_distortion(**(accepted | arguments))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"utilities": [[1.0, math.nan]]}, "utilities must be finite"),
        ({"prior": [0.5, 0.6]}, "prior must sum to 1"),
        ({"percepts": 0}, "percepts must be a whole number of at least 1, got 0"),
        ({"percepts": 2.0}, "percepts must be .*got 2.0"),
        ({"percepts": True}, "percepts must be .*got True"),
        ({"percepts": 10**13}, "percepts 10,000,000,000,000 would take more than"),
        ({"percepts": torch.ones(2, 3)}, r"percepts must be .*got tensor\(\[\[1., 1., 1.\], \[1.,"),
        ({"restarts": 0}, "restarts must be .*got 0"),
        ({"restarts": "many"}, "restarts must be .*got 'many'"),
        ({"budget": 0}, "budget must be .*got 0"),
        ({"utilities": [[0.0, -math.inf], [-math.inf, 0.0]], "percepts": 1}, "one percept cannot"),
        ({"utilities": FORBIDDING}, "found no policy of 2 percepts that never takes a forbidden"),
        (
            {"utilities": FORBIDDING, "percepts": 3, "beta_action": 6e-309},
            "the information to do without them costs more than numbers can hold",
        ),
        ({"beta_perception": -2.0}, "beta_perception must be positive and finite, got -2"),
        ({"beta_action": math.inf}, "beta_action must be positive and finite, got inf"),
        (
            {"beta_perception": [1.0, 2.0], "beta_action": [1.0, 2.0, 3.0]},
            r"must broadcast against each other, got shapes \(2,\) and \(3,\)",
        ),
    ],
)
def test_serial_refuses(arguments, words):
    accepted = {
        "utilities": IDENTITY,
        "prior": None,
        "percepts": 2,
        "beta_perception": 1.0,
        "beta_action": 1.0,
    }
    with pytest.raises(ValueError, match=words) as caught:
        serial(**(accepted | arguments))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"beta_direct": -1.0}, "beta_direct must be positive, got -1; where .* free give inf"),
        ({"beta_direct": math.nan}, "beta_direct must be positive, got nan"),
        (
            {"beta_direct": "high"},
            "beta_direct must be a number or .*, got 'high'",
        ),
        ({"beta_perception": 0.0}, "beta_perception must be positive, got 0"),
        ({"beta_action": [1.0, 2.0], "beta_direct": [1.0] * 3}, r"broadcast.*\(2,\) and \(3,\)"),
        ({name: math.inf for name in ("beta_perception", "beta_action", "beta_direct")}, "argmax"),
        ({"percepts": 0}, "percepts must be a whole number of at least 1, got 0"),
        ({"budget": 0}, "budget must be .*got 0"),
    ],
)
def test_general_refuses(arguments, words):
    accepted = {
        "utilities": IDENTITY,
        "prior": None,
        "percepts": 2,
        "beta_perception": 1.0,
        "beta_action": 1.0,
        "beta_direct": 1.0,
    }
    with pytest.raises(ValueError, match=words) as caught:
        general(**(accepted | arguments))
    assert "\n" not in str(caught.value)


def test_numbers_of_numpy_are_numbers():
    counts = {"percepts": np.int64(2), "restarts": np.int32(2), "budget": np.int64(3)}
    assert serial(IDENTITY, None, beta_perception=3.0, beta_action=3.0, **counts).starts <= 3
