"""Poses and light around the usual ones."""

import math

import numpy as np
import pytest

from bra.tasks.nao_mugs import Light, Pose
from bra.tasks.nao_mugs.jitter import Jitter


def test_the_middle_is_the_usual():
    jitter = Jitter(0.01, 10.0, 0.3)
    assert jitter.pose(np.full(6, 0.5)) == Pose()
    assert jitter.lamp(np.full(6, 0.5)) == Light()
    assert not Jitter().varies and not Jitter(light=0.1).moves and Jitter(light=0.1).varies


def test_spreads():
    jitter = Jitter(0.01, 10.0, 0.3)
    numbers = np.random.default_rng(0).random((500, Jitter.NUMBERS))
    poses, lamps = [jitter.pose(row) for row in numbers], [jitter.lamp(row) for row in numbers]
    usual = Light().direction
    spread = np.array(
        [
            [
                (pose.x - 0.17) / 0.01,
                pose.y / 0.01,
                pose.yaw / math.radians(10),
                (lamp.direction[0] - usual[0]) / (0.3 * usual[2]),
                (lamp.direction[1] - usual[1]) / (0.3 * usual[2]),
                (lamp.strength - 1) / 0.3,
            ]
            for pose, lamp in zip(poses, lamps, strict=True)
        ]
    )
    np.testing.assert_allclose(spread, 2 * numbers - 1, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-0.01,), "position_jitter must be at least 0, got -0.01"),
        ((0.0, math.nan), "angle_jitter must be at least 0, got nan"),
        ((0.0, 0.0, 1.0), "light_jitter must be less than 1, got 1.0"),
        ((0.05,), "position_jitter 0.05 m .* out of reach: the hands do not reach .*; expected"),
        ((0.0, 60.0), "angle_jitter 60.0° put the mug out of reach: .*yaw. at most 12°"),
    ],
)
def test_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Jitter(*arguments)
