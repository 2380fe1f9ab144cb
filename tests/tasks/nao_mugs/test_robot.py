import re
import xml.etree.ElementTree as ElementTree

import pytest

pytest.importorskip("pybullet")

from bra.tasks.nao_mugs.bullet import connect
from bra.tasks.nao_mugs.dimensions import (
    BOTTOM_CAMERA,
    HEAD_JOINTS,
    JAW_OPENING,
    arm_joints,
    rest_posture,
)
from bra.tasks.nao_mugs.robot import Robot
from bra.tasks.nao_mugs.urdf import nao_urdf


@pytest.fixture(scope="module")
def client():
    client = connect()
    yield client
    client.close()


@pytest.fixture(scope="module")
def robot(client):
    return Robot(client)


def test_masses():
    masses = {
        link.get("name"): float(link.find("inertial/mass").get("value"))
        for link in ElementTree.fromstring(nao_urdf()).iter("link")
    }
    assert sum(masses.values()) == pytest.approx(5.305, abs=0.005)
    arm = sum(mass for name, mass in masses.items() if name[0] == "L" and name != "LLeg")
    assert arm == pytest.approx(0.0930 + 0.1578 + 0.0648 + 0.0776 + 0.1853, abs=1e-6)


def test_both_sides_weigh_the_same(client, robot):
    mass = {}
    for i in range(client.getNumJoints(robot.body)):
        name = client.getJointInfo(robot.body, i)[12].decode()
        mass[name] = client.getDynamicsInfo(robot.body, i)[0]
    for name in mass:
        if name[0] == "R":
            assert mass[name] == mass["L" + name[1:]]


def test_only_primitive_shapes():
    shapes = {geometry[0].tag for geometry in ElementTree.fromstring(nao_urdf()).iter("geometry")}
    assert shapes <= {"sphere", "cylinder", "capsule", "box"}


def test_standing_heights(client, robot):
    for name in arm_joints("left")[:2]:
        assert robot.frame(robot.joints[name])[0] == pytest.approx((0, 0.098, 0.433), abs=1e-6)
    assert robot.frame(robot.joints["RShoulderPitch"])[0][1] == pytest.approx(-0.098, abs=1e-6)
    position, orientation = robot.head_pose()
    assert position == pytest.approx((0, 0, 0.4595), abs=2e-4)
    camera, _ = client.multiplyTransforms(position, orientation, BOTTOM_CAMERA[0], (0, 0, 0, 1))
    assert camera == pytest.approx((0.05071, 0, 0.477), abs=5e-4)
    top, sole = 0.0, 1.0
    for shape in client.getVisualShapeData(robot.body):
        link, kind, size, place = shape[1], shape[2], shape[3], shape[5]
        if link < 0:  # the torso
            continue
        height = robot.frame(link)[0][2] + place[2]
        name = client.getJointInfo(robot.body, link)[12]
        if name == b"Head" and kind == client.GEOM_SPHERE:
            top = max(top, height + size[0])
        if name == b"LLeg" and kind == client.GEOM_BOX:
            sole = min(sole, height - size[2] / 2)
    assert top == pytest.approx(0.570, abs=1e-3)
    assert sole == pytest.approx(0, abs=1e-3)


def test_rest_and_reset_are_exact(client, robot):
    posture = rest_posture()
    for _ in range(20):
        client.stepSimulation()
    client.resetJointState(robot.body, robot.joints["LElbowRoll"], -1.0)
    robot.reset()
    for name, angle in posture.items():
        position, velocity = client.getJointState(robot.body, robot.joints[name])[:2]
        assert (position, velocity) == (angle, 0.0)
    for name in ("LFinger", "LThumb", "RFinger", "RThumb"):
        assert client.getJointState(robot.body, robot.joints[name])[0] == JAW_OPENING


def test_motors_hold_the_arms_against_gravity(client):
    client.resetSimulation()
    client.setGravity(0, 0, -9.81)
    robot = Robot(client)
    for _ in range(240):
        client.stepSimulation()
    for name, angle in rest_posture().items():
        assert client.getJointState(robot.body, robot.joints[name])[0] == pytest.approx(
            angle, abs=1e-3
        )
    torques = robot.torques()
    assert list(torques) == [*arm_joints("left"), *arm_joints("right")]
    assert 0 < max(map(abs, torques.values())) < 0.3


def test_a_description_by_path(client, tmp_path):
    path = tmp_path / "own.urdf"
    transmission = '<transmission name="t"><joint name="LWristYaw"/></transmission>'
    path.write_text(nao_urdf().replace("</robot>", transmission + "</robot>"))
    robot = Robot(client, str(path))
    assert set(HEAD_JOINTS) < set(robot.joints)
    assert robot.arms["left"].chain.joints == arm_joints("left")


def test_refuses_a_path_that_does_not_exist(client, tmp_path):
    path = tmp_path / "none.urdf"
    with pytest.raises(ValueError, match=re.escape(f"cannot read a robot from {path}: No such")):
        Robot(client, str(path))


def test_refuses_what_is_no_urdf(client, tmp_path):
    path = tmp_path / "own.urdf"
    path.write_text("<robot")
    with pytest.raises(ValueError, match="it is no URDF"):
        Robot(client, str(path))


def test_names_missing_joints(client, tmp_path):
    path = tmp_path / "own.urdf"
    path.write_text(nao_urdf().replace('"LWristYaw"', '"Wrist"').replace("RThumb", "RFoo"))
    with pytest.raises(ValueError, match=r"LWristYaw \(revolute\), RThumb \(prismatic\); add"):
        Robot(client, str(path))


def test_refuses_what_bullet_cannot_load(client, tmp_path):
    path = tmp_path / "own.urdf"
    path.write_text(
        nao_urdf().replace('"torso"/><child link="LLeg"', '"nowhere"/><child link="LLeg"')
    )
    with pytest.raises(ValueError, match="Bullet cannot load"):
        Robot(client, str(path))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</robot>", '<link name="apart"/></robot>', r"one root link, the torso, got torso, apart"),
        ('<axis xyz="1 0 0"/>', '<axis xyz="0 0 0"/>', r"have no axis to turn about"),
    ],
)
def test_robots_that_cannot_be(tmp_path, old, new, message):
    path = tmp_path / "broken.urdf"
    path.write_text(nao_urdf().replace(old, new), encoding="utf-8")
    client = connect()
    with pytest.raises(ValueError, match=message):
        Robot(client, str(path))
    client.close()
