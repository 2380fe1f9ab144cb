import math
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("pybullet")

from bra.tasks.nao_mugs.dimensions import ARM
from bra.tasks.nao_mugs.lift import (
    ACTIONS,
    REACH_YAW,
    _plan,
    check_pose,
    feels_handle,
    lift,
    reach,
)
from bra.tasks.nao_mugs.mugs import MUGS, SIDES, Pose
from bra.tasks.nao_mugs.scene import TIME_STEP, Scene

EXPECTED = [
    [False, False, False, False],
    [False, True, False, True],
    [False, False, True, True],
    [False, True, True, True],
]
CORNER = Pose(0.16, 0.01, math.radians(10))


@pytest.fixture(scope="module")
def scene():
    with Scene() as scene:
        yield scene


def outcome(scene, mug, action, pose, believed=None):
    scene.place(MUGS[mug], pose)
    return lift(scene, action, believed or pose)


@pytest.mark.parametrize("mug", range(4))
def test_the_table_of_outcomes(scene, mug):
    outcomes = [outcome(scene, mug, action, Pose()) for action in range(len(ACTIONS))]
    assert [result.success for result in outcomes] == EXPECTED[mug]
    for action, result in enumerate(outcomes):
        # Which hands hold: those that are used and find a handle.
        assert result.left_contact == (action in (1, 3) and MUGS[mug].left)
        assert result.right_contact == (action in (2, 3) and MUGS[mug].right)
        if result.success:
            assert 0.075 < result.rise < 0.082
            assert result.tilt < math.radians(3)
        else:
            assert abs(result.rise) < 1e-3
            assert result.tilt < 1e-2
        efforts = {f"{p}{joint.name[1:]}": joint.effort for joint in ARM for p in "LR"}
        assert all(abs(torque) <= efforts[name] for name, torque in result.torques.items())


@pytest.mark.parametrize(
    "x, y, degrees",
    [
        (0.16, 0.01, 10),
        (0.165, 0.005, -8),
        pytest.param(0.18, -0.01, 10, marks=pytest.mark.slow),
    ],
)
def test_mugs_elsewhere(scene, x, y, degrees):
    pose = Pose(x, y, math.radians(degrees))
    for mug, action in ((1, 1), (1, 2), (2, 3), (3, 3)):
        assert outcome(scene, mug, action, pose).success == EXPECTED[mug][action]


def test_the_edge_of_the_reach(scene):
    for y, yaw in ((0.0, 0.0), (0.01, math.radians(10)), (-0.02, REACH_YAW)):
        for x in (reach(y, yaw)[0] + 1e-9, reach(y, yaw)[1] - 1e-9):
            result = outcome(scene, 3, 3, Pose(x, y, yaw))
            assert result.success and result.left_contact and result.right_contact


def test_nothing_moves_without_an_action(scene):
    result = outcome(scene, 3, 0, CORNER)
    assert abs(result.rise) < 1e-4
    assert result.tilt < 1e-3
    assert result.shoulder_torque < 0.2
    assert scene.mug.position()[:2] == pytest.approx((CORNER.x, CORNER.y), abs=1e-4)


def test_a_hand_in_the_wrong_place_holds_nothing(scene):
    result = outcome(scene, 3, 1, Pose(0.20), believed=Pose(0.15))
    assert not result.success
    assert not result.left_contact


def test_two_hands_are_better_than_one(scene):
    one, two = (outcome(scene, 3, action, Pose()) for action in (1, 3))
    assert two.tilt < one.tilt
    assert two.shoulder_torque < one.shoulder_torque


def test_lifts_repeat_bit_by_bit(scene):
    first = outcome(scene, 3, 3, CORNER)
    single = outcome(scene, 1, 1, Pose(0.175))
    outcome(scene, 0, 2, Pose(0.18, -0.01))
    outcome(scene, 2, 3, CORNER)
    assert outcome(scene, 3, 3, CORNER) == first
    assert outcome(scene, 1, 1, Pose(0.175)) == single


def test_lifts_repeat_in_a_fresh_scene(scene):
    first = outcome(scene, 3, 3, CORNER)
    with Scene() as other:
        assert outcome(other, 3, 3, CORNER) == first


@pytest.mark.slow  # imports everything once more
def test_lifts_repeat_in_a_fresh_process(scene):
    code = (
        "from bra.tasks.nao_mugs.lift import lift\n"
        "from bra.tasks.nao_mugs.mugs import MUGS, Pose\n"
        "from bra.tasks.nao_mugs.scene import Scene\n"
        "with Scene() as scene:\n"
        f"    pose = {CORNER!r}\n"
        "    scene.place(MUGS[3], pose)\n"
        "    print(repr(lift(scene, 3, pose)))\n"
    )
    outcome(scene, 0, 1, Pose())
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == repr(outcome(scene, 3, 3, CORNER))


def test_the_hands_let_go_in_the_end(scene):
    assert outcome(scene, 3, 3, Pose()).success
    assert scene.client.getNumConstraints() == 0
    scene.step(240)
    assert scene.mug.position()[2] < 0.42  # it fell back


def test_hands_at_rest_feel_nothing(scene):
    scene.place(MUGS[3], Pose())
    scene.step()
    assert not any(feels_handle(scene.robot, scene.mug, side) for side in SIDES)


def test_a_spectator_sees_thirty_pictures_a_second(scene):
    scene.place(MUGS[3], Pose())
    heights = []
    watched = lift(scene, 3, Pose(), lambda: heights.append(scene.mug.position()[2]))
    assert len(heights) == 76
    assert max(heights) - heights[0] == pytest.approx(watched.rise, abs=2e-3)
    assert outcome(scene, 3, 3, Pose()) == watched


@pytest.mark.parametrize("pose", [Pose(), CORNER, Pose(0.18, -0.01, -CORNER.yaw)])
def test_hands_touch_nothing_but_handles(scene, pose):
    mug = scene.place(MUGS[3], pose)
    touched = set()

    def watch():
        for contact in scene.client.getContactPoints(scene.robot.body):
            touched.add((contact[2], contact[4]))

    lift(scene, 3, pose, watch)
    assert touched == {(mug.body, link) for link in mug.handles.values()}


@pytest.mark.parametrize("side", SIDES)
def test_plans_keep_to_the_joints_limits(scene, side):
    chain = scene.robot.arms[side].chain
    fastest = np.array([joint.velocity for joint in ARM[:5]])
    for pose in (Pose(), CORNER, Pose(0.18, -0.01, -CORNER.yaw)):
        plan = _plan(scene.robot, pose, side)
        way = np.concatenate([[scene.robot.rest(side)], plan.reach, plan.approach, plan.lift])
        assert (way >= chain.lower).all() and (way <= chain.upper).all()
        assert (np.abs(np.diff(way, axis=0)) / TIME_STEP < fastest).all()


@pytest.mark.parametrize("action", [-1, 4])
def test_refuses_unknown_actions(scene, action):
    scene.place(MUGS[0], Pose())
    with pytest.raises(ValueError, match=f"action must be 0 to 3 .* got {action}"):
        lift(scene, action, Pose())


def test_refuses_an_empty_table():
    with Scene() as scene, pytest.raises(ValueError, match="no mug to lift"):
        lift(scene, 1, Pose())


def test_reach():
    assert reach(0.0, 0.0) == (0.14, 0.21)
    low, high = reach(-0.01, math.radians(-10))
    assert low == pytest.approx(0.14 + 0.005 + 0.06 * math.sin(math.radians(10)))
    assert high == pytest.approx(0.35 - low)
    for x in (0.16, 0.18):  # what jitter of 1 cm and 10° asks for
        check_pose(Pose(x, -0.01, math.radians(-10)))


@pytest.mark.parametrize(
    "pose",
    [Pose(0.13), Pose(0.22), Pose(y=0.03), Pose(yaw=0.3), Pose(yaw=math.pi), Pose(math.nan)],
)
def test_refuses_mugs_out_of_reach(scene, pose):
    with pytest.raises(ValueError, match=r"do not reach .* expected .y. at most 0\.02 m"):
        check_pose(pose)
    scene.place(MUGS[3], Pose())
    with pytest.raises(ValueError, match="do not reach"):
        lift(scene, 0, pose)
