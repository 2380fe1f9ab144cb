import numpy as np
import pytest

from bra.tasks.nao_mugs.mugs import MUGS, Pose
from bra.tasks.nao_mugs.scene import TABLE_EDGE, TABLE_HEIGHT, Scene

POSE = Pose(x=0.165, y=0.005, yaw=0.1)


@pytest.fixture(scope="module")
def scene():
    with Scene() as scene:
        yield scene


def trajectory(scene):
    """Mug and joints while the robot moves an arm and the mug is pushed."""
    client, mug = scene.client, scene.mug
    states = []
    for time in range(30):
        if time == 5:
            scene.robot.move("left", np.array([0.5, 0.2, -0.5, -0.6, 0.0]))
        if time == 10:
            force, point = [0.5, 0.1, 0.0], mug.position().tolist()
            client.applyExternalForce(mug.body, -1, force, point, client.WORLD_FRAME)
        scene.step(4)
        states += [*client.getBasePositionAndOrientation(mug.body)]
        states += [client.getJointState(scene.robot.body, j)[:2] for j in range(4)]
    return np.concatenate(states)


@pytest.mark.parametrize(("beyond", "height"), [(-1e-3, 0.0), (1e-3, TABLE_HEIGHT)])
def test_table_is_where_it_is_said_to_be(scene, beyond, height):
    x, y = TABLE_EDGE + beyond, 0.2
    _, _, _, point, _ = scene.client.rayTest([x, y, 1.0], [x, y, -1.0])[0]
    assert point[2] == pytest.approx(height, abs=1e-6)


def test_one_mug_at_a_time(scene):
    for kind in MUGS:
        mug = scene.place(kind, POSE)
        assert scene.mug is mug
        assert tuple(mug.handles) == kind.handles
    assert scene.client.getNumBodies() == 5  # table, floor, legs, robot, mug


def test_places_repeat_bit_by_bit_whatever_came_before(scene):
    scene.place(MUGS[3], POSE)
    expected = trajectory(scene)
    assert expected.std() > 0
    for kind in MUGS:
        mug = scene.place(kind, Pose(x=0.19, y=-0.01))
        point = mug.position().tolist()
        scene.client.applyExternalForce(mug.body, -1, [30, 5, 0], point, scene.client.WORLD_FRAME)
        scene.step(50)
        assert mug.position()[0] > 0.2
        frames = [[0.0, 0.0, 0.0]] * 3
        scene.client.createConstraint(
            scene.robot.body, 0, mug.body, -1, scene.client.JOINT_POINT2POINT, *frames
        )
        scene.step(10)
    scene.place(MUGS[3], POSE)
    assert np.array_equal(trajectory(scene), expected)
    with Scene() as fresh:
        fresh.place(MUGS[3], POSE)
        assert np.array_equal(trajectory(fresh), expected)


def test_a_simulation_is_replaced_before_it_has_grown(monkeypatch):
    monkeypatch.setattr("bra.tasks.nao_mugs.scene.LASTS", 2)
    with Scene() as scene, Scene() as fresh:
        first = scene.client
        for number in range(5):
            scene.place(MUGS[number % 4], Pose(x=0.19, y=-0.01))
            assert (scene.client is first) is (number < 2)
            assert scene.client.getNumBodies() == 5
        with pytest.raises(first.error, match="Not connected"):
            first.getNumBodies()
        scene.place(MUGS[3], POSE)
        fresh.place(MUGS[3], POSE)
        assert np.array_equal(trajectory(scene), trajectory(fresh))


def test_time_step_and_gravity(scene):
    mug = scene.place(MUGS[0], POSE)
    start = [POSE.x, POSE.y, 2.0]
    scene.client.resetBasePositionAndOrientation(mug.body, start, [0.0, 0.0, 0.0, 1.0])
    scene.step(60)  # 0.25 s; the sum of steps of 1/240 s falls t·(t + 1/240)·g/2
    fallen = 2.0 - mug.position()[2]
    assert fallen == pytest.approx(9.81 * 0.25 * (0.25 + 1 / 240) / 2, rel=0.03)  # air drag


def test_window_shows_robot_table_and_mug(scene):
    scene.place(MUGS[1], POSE)
    picture = scene.window(160, 120)
    assert (picture.shape, picture.dtype) == ((120, 160, 3), np.uint8)
    red, green, blue = picture.astype(int).reshape(-1, 3).T
    cup = (red > 2 * green) & (red > 2 * blue)
    shell = (red > 225) & (green > 225) & (blue > 225)
    table = (red > green + 20) & (green > blue + 20) & (blue > 60)
    assert 0.005 < cup.mean() < 0.05
    assert 0.01 < shell.mean() < 0.1
    assert 0.1 < table.mean() < 0.5
    assert not (picture[[0, -1]].min(-1) > 225).any()  # where there is no floor it is white
    assert np.array_equal(picture, scene.window(160, 120))


def test_a_missing_robot_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"missing\.urdf"):
        Scene(str(tmp_path / "missing.urdf"))
