import csv
import math

import numpy as np
import pytest

pytest.importorskip("pybullet")

from bra.tasks.nao_mugs.jitter import Jitter
from bra.tasks.nao_mugs.lift import lift
from bra.tasks.nao_mugs.mugs import MUGS
from bra.tasks.nao_mugs.outcomes import SuccessMatrix, success_matrix
from bra.tasks.nao_mugs.scene import Scene

JITTER = Jitter(position=0.01, angle=10.0)
EXPECTED = np.array([[0, 0, 0, 0], [0, 1, 0, 1], [0, 0, 1, 1], [0, 1, 1, 1]])


@pytest.fixture(scope="module")
def scene():
    with Scene() as scene:
        yield scene


@pytest.fixture(scope="module")
def matrix(scene):
    return success_matrix(scene, trials=2, jitter=JITTER, seed=3)


def test_counts(matrix):
    np.testing.assert_array_equal(matrix.attempts, np.full((4, 4), 2))
    np.testing.assert_array_equal(matrix.successes, 2 * EXPECTED)
    np.testing.assert_array_equal(matrix.rates, EXPECTED)
    np.testing.assert_allclose(matrix.rise, 0.079 * EXPECTED, atol=2e-3)
    assert matrix.tilt.max() < math.radians(3)


def test_means_are_over_the_seeds_poses(scene, matrix):
    lifts = []
    for trial in (1, 0):  # in another order
        pose = JITTER.pose(np.random.default_rng((3, 1, 3, trial)).random(Jitter.NUMBERS))
        scene.place(MUGS[1], pose)
        lifts.append(lift(scene, 3, pose))
    assert matrix.rise[1, 3] == pytest.approx(np.mean([result.rise for result in lifts]), rel=1e-12)
    assert matrix.tilt[1, 3] == pytest.approx(np.mean([result.tilt for result in lifts]), rel=1e-12)


def test_csv(matrix, tmp_path):
    path = tmp_path / "outcomes.csv"
    matrix.write_csv(str(path))
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 16
    assert [row["mug"] for row in rows[::4]] == ["m0", "mL", "mR", "m2"]
    assert [row["action"] for row in rows[:4]] == ["a0", "aL", "aR", "a2"]
    assert [int(row["successes"]) for row in rows] == matrix.successes.ravel().tolist()
    assert float(rows[-1]["mean_rise_m"]) == pytest.approx(matrix.rise[3, 3], abs=1e-6)
    assert float(rows[-1]["mean_tilt_rad"]) == pytest.approx(matrix.tilt[3, 3], abs=1e-6)


def test_picture(tmp_path):
    successes = np.arange(16).reshape(4, 4)
    zero = np.zeros((4, 4))
    matrix = SuccessMatrix(np.full((4, 4), 15), successes, zero, zero, JITTER)
    picture = matrix.draw()
    picture.save(tmp_path / "matrix.png")
    assert (tmp_path / "matrix.png").stat().st_size > 5000
    matrix.successes[0, 1] = 15
    assert matrix.draw().tobytes() != picture.tobytes()
    assert matrix.draw().size == picture.size


def test_refuses(scene):
    with pytest.raises(ValueError, match="trials must be positive"):
        success_matrix(scene, 0, JITTER)
    with pytest.raises(ValueError, match="seed not negative"):
        success_matrix(scene, 1, JITTER, seed=-1)


@pytest.mark.slow
def test_a_hundred_trials_each(scene):
    matrix = success_matrix(scene, 100, JITTER)
    assert (matrix.successes[EXPECTED == 1] >= 95).all()
    assert (matrix.successes[EXPECTED == 0] == 0).all()
