import numpy as np
import pytest

pytest.importorskip("pybullet")

from bra.tasks.nao_mugs.bullet import connect
from bra.tasks.nao_mugs.dimensions import TORSO_HEIGHT
from bra.tasks.nao_mugs.kinematics import KinematicChain
from bra.tasks.nao_mugs.lift import GRASPING, MIRROR, RISE
from bra.tasks.nao_mugs.mugs import SIDES, Pose, handle_centre
from bra.tasks.nao_mugs.robot import Robot
from bra.tasks.nao_mugs.urdf import nao_urdf

BASE = (0.0, 0.0, TORSO_HEIGHT)


@pytest.fixture(scope="module")
def robot():
    client = connect()
    yield Robot(client)
    client.close()


def postures(chain, count, seed=0):
    return np.random.default_rng(seed).uniform(chain.lower, chain.upper, (count, len(chain.joints)))


def start(side):
    return np.array(GRASPING) * (MIRROR if side == "right" else 1)


@pytest.mark.parametrize("side", SIDES)
def test_forward_kinematics_equal_the_simulators(robot, side):
    arm = robot.arms[side]
    angles = postures(arm.chain, 100)
    frames = arm.chain.forward(angles)
    for posture, frame in zip(angles, frames, strict=True):
        for joint, angle in zip(arm.joints, posture, strict=True):
            robot.client.resetJointState(robot.body, joint, angle)
        position, orientation = robot.frame(arm.gripper)
        turn = np.reshape(robot.client.getMatrixFromQuaternion(orientation), (3, 3))
        np.testing.assert_allclose(frame[:3, 3], position, atol=1e-4)
        np.testing.assert_allclose(frame[:3, :3], turn, atol=1e-4)


def test_arms_mirror_each_other(robot):
    left, right = robot.arms["left"].chain, robot.arms["right"].chain
    angles = postures(left, 20)
    flip = np.diag([1.0, -1.0, 1.0, 1.0])
    np.testing.assert_allclose(
        right.forward(angles * MIRROR), flip @ left.forward(angles) @ flip, atol=1e-12
    )


@pytest.mark.parametrize("side", SIDES)
def test_grasps_of_jittered_mugs_are_met(robot, side):
    chain = robot.arms[side].chain
    jitter = np.random.default_rng(1).uniform(-1, 1, (200, 3)) * [0.01, 0.01, np.radians(10)]
    bars = np.array([handle_centre(Pose(0.17 + x, y, yaw), side) for x, y, yaw in jitter])
    for places in (bars, bars + np.array([0, 0, RISE])):
        solution = chain.level(places, start(side))
        assert solution.distance.max() < 1e-4
        assert solution.slant.max() < 1e-3
        assert solution.iterations < 30
        assert (solution.angles >= chain.lower).all() and (solution.angles <= chain.upper).all()
        frames = chain.forward(solution.angles)
        np.testing.assert_allclose(
            np.linalg.norm(frames[:, :3, 3] - places, axis=1), solution.distance, atol=1e-9
        )
        # The forearm points forwards and the bar stands upright between the jaws.
        assert (frames[:, 0, 0] > 0.3).all()
        np.testing.assert_allclose(frames[:, 2, 2], 1, atol=1e-5)


def test_solutions_do_not_depend_on_their_neighbours(robot):
    chain = robot.arms["left"].chain
    bars = np.array([handle_centre(Pose(x), "left") for x in (0.16, 0.17, 0.18)])
    together = chain.level(bars, start("left")).angles
    alone = [chain.level(bar[None], start("left")).angles[0] for bar in bars]
    np.testing.assert_allclose(together, alone, atol=1e-6)


def test_places_out_of_reach_are_reported(robot):
    chain = robot.arms["left"].chain
    far, near = [0.5, 0.098, 0.433], [0.1, 0.098, 0.433]
    solution = chain.level(np.array([far, near]), start("left"))
    assert solution.iterations == 100
    assert solution.distance[0] > 0.5 - (0.105 + 0.05595 + 0.05775)  # stretched
    assert solution.distance[1] > 0.146 - 0.1  # folded
    assert (solution.angles <= chain.upper).all() and (solution.angles >= chain.lower).all()


def test_refuses_unknown_links_and_joints():
    with pytest.raises(ValueError, match="no link LNose"):
        KinematicChain(nao_urdf(), "LNose", BASE)
    with pytest.raises(ValueError, match="LFinger must be revolute or fixed, got prismatic"):
        KinematicChain(nao_urdf(), "LFingerJaw", BASE)
