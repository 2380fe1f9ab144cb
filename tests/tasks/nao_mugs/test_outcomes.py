import csv
import math

import numpy as np
import pytest

pytest.importorskip("pybullet")

from bra.tasks.nao_mugs.lift import lift
from bra.tasks.nao_mugs.mugs import MUGS
from bra.tasks.nao_mugs.outcomes import SuccessMatrix, jittered_pose, success_matrix
from bra.tasks.nao_mugs.scene import Scene

EXPECTED = np.array([[0, 0, 0, 0], [0, 1, 0, 1], [0, 0, 1, 1], [0, 1, 1, 1]])


@pytest.fixture(scope="module")
def scene():
    with Scene() as scene:
        yield scene


@pytest.fixture(scope="module")
def reports():
    return []


@pytest.fixture(scope="module")
def matrix(scene, reports):
    return success_matrix(
        scene, trials=2, seed=3, report=lambda done, of: reports.append((done, of))
    )


def test_counts(matrix):
    np.testing.assert_array_equal(matrix.attempts, np.full((4, 4), 2))
    np.testing.assert_array_equal(matrix.successes, 2 * EXPECTED)
    np.testing.assert_array_equal(matrix.rates, EXPECTED)
    np.testing.assert_allclose(matrix.rise, 0.079 * EXPECTED, atol=2e-3)
    assert matrix.tilt.max() < math.radians(3)


def test_means_are_over_the_seeds_poses(scene, matrix):
    lifts = []
    for trial in (1, 0):  # in another order
        pose = jittered_pose(0.01, math.radians(10), (3, 1, 3, trial))
        scene.place(MUGS[1], pose)
        lifts.append(lift(scene, 3, pose))
    assert matrix.rise[1, 3] == pytest.approx(np.mean([result.rise for result in lifts]), rel=1e-12)
    assert matrix.tilt[1, 3] == pytest.approx(np.mean([result.tilt for result in lifts]), rel=1e-12)


def test_poses():
    poses = [jittered_pose(0.01, 0.2, (0, 1, 2, trial)) for trial in range(500)]
    spread = np.array([[pose.x - 0.17, pose.y, pose.yaw] for pose in poses]) / [0.01, 0.01, 0.2]
    assert np.abs(spread).max() <= 1
    # Uniform on [-1, 1]: deviations 1/√3; bounds of five standard errors, 3e-6 to fail by chance.
    np.testing.assert_allclose(spread.mean(axis=0), 0, atol=5 / math.sqrt(3 * 500))
    np.testing.assert_allclose(spread.std(axis=0), 1 / math.sqrt(3), atol=0.06)
    assert poses[0] == jittered_pose(0.01, 0.2, (0, 1, 2, 0))
    assert poses[0] != jittered_pose(0.01, 0.2, (1, 1, 2, 0))


def test_reports(matrix, reports):
    assert reports == [(done, 32) for done in range(1, 33)]


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
    matrix = SuccessMatrix(np.full((4, 4), 15), successes, zero, zero, 0.01, math.radians(10))
    figure = matrix.draw()
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.texts] == [f"{count}/15" for count in range(16)]
    assert [label.get_text() for label in axes.get_yticklabels()][1] == "mL\nleft"
    assert "15 trials each, mug placed within ±1 cm, ±10°" in figure.get_suptitle()
    figure.savefig(tmp_path / "matrix.png")
    assert (tmp_path / "matrix.png").stat().st_size > 5000


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"trials": 0}, "trials must be positive"),
        ({"seed": -1}, "seed not negative"),
        ({"position_jitter": -0.01}, "jitter must not be negative"),
        ({"angle_jitter": math.nan}, "jitter must not be negative"),
        ({"position_jitter": 0.05}, "do not reach"),
        ({"angle_jitter": 1.0}, "do not reach"),
    ],
)
def test_refuses(scene, arguments, message):
    with pytest.raises(ValueError, match=message):
        success_matrix(scene, **arguments)


@pytest.mark.slow
def test_a_hundred_trials_each(scene):
    matrix = success_matrix(scene, trials=100)
    print(matrix.successes)
    assert (matrix.successes[EXPECTED == 1] >= 95).all()
    assert (matrix.successes[EXPECTED == 0] == 0).all()
