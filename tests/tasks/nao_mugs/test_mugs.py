import math

import numpy as np
import pytest

from bra.tasks.nao_mugs.bullet import connect
from bra.tasks.nao_mugs.furniture import TABLE_HEIGHT, furnish
from bra.tasks.nao_mugs.mugs import (
    CUP_HEIGHT,
    CUP_RADIUS,
    HANDLE_LENGTH,
    HANDLE_RADIUS,
    MUG_MASS,
    MUGS,
    SIDES,
    Mug,
    Pose,
    handle_centre,
)

TURNED = Pose(x=0.18, y=-0.01, yaw=math.radians(10))
MARGIN = 1e-4  # m, by which Bullet's boxes around shapes are too large


@pytest.fixture
def client():
    client = connect()
    client.setGravity(0.0, 0.0, -9.81)
    furnish(client)
    yield client
    client.close()


def extent(client, body, link):
    low, high = client.getAABB(body, link)
    return np.subtract(high, low)


def test_names_and_handles():
    assert [(kind.name, *kind.handles) for kind in MUGS] == [
        ("m0",),
        ("mL", "left"),
        ("mR", "right"),
        ("m2", "left", "right"),
    ]


@pytest.mark.parametrize("kind", MUGS, ids=lambda kind: kind.name)
def test_shape_and_mass(client, kind):
    mug = Mug.load(client, kind, Pose())
    assert extent(client, mug.body, -1) == pytest.approx(
        [2 * CUP_RADIUS, 2 * CUP_RADIUS, CUP_HEIGHT], abs=MARGIN
    )
    assert tuple(mug.handles) == kind.handles
    assert client.getNumJoints(mug.body) == len(kind.handles)
    for side, link in mug.handles.items():
        assert client.getJointInfo(mug.body, link)[12].decode() == f"{side}_handle"
        assert extent(client, mug.body, link) == pytest.approx(
            [2 * HANDLE_RADIUS, 2 * HANDLE_RADIUS, HANDLE_LENGTH], abs=MARGIN
        )
    masses = [client.getDynamicsInfo(mug.body, link)[0] for link in (-1, *mug.handles.values())]
    assert sum(masses) == pytest.approx(MUG_MASS)


@pytest.mark.parametrize(
    ("pose", "left", "right"),
    [
        (Pose(), (0.17, 0.06, 0.382), (0.17, -0.06, 0.382)),
        (Pose(0.15, 0.01, math.pi / 2), (0.09, 0.01, 0.382), (0.21, 0.01, 0.382)),
    ],
)
def test_handle_centres(pose, left, right):
    assert handle_centre(pose, "left") == pytest.approx(left)
    assert handle_centre(pose, "right") == pytest.approx(right)


@pytest.mark.parametrize("pose", [Pose(), TURNED])
def test_handles_are_where_they_are_said_to_be(client, pose):
    mug = Mug.load(client, MUGS[3], pose)
    for side in SIDES:
        place = client.getLinkState(mug.body, mug.handles[side])[0]
        assert place == pytest.approx(handle_centre(pose, side), abs=1e-6)


@pytest.mark.parametrize("mass", [0.1, 0.2, 0.3])
@pytest.mark.parametrize("kind", MUGS, ids=lambda kind: kind.name)
def test_a_mug_stays_where_it_is_put(client, kind, mass):
    mug = Mug.load(client, kind, TURNED, mass)
    stands = [TURNED.x, TURNED.y, TABLE_HEIGHT + CUP_HEIGHT / 2]
    assert mug.position() == pytest.approx(stands, abs=1e-9)
    for _ in range(240):
        client.stepSimulation()
        assert mug.position() == pytest.approx(stands, abs=1e-4)
        assert mug.tilt() < 1e-3
    assert np.linalg.norm(client.getBaseVelocity(mug.body)) < 5e-3


def test_a_moved_mug_stands_at_its_new_place(client):
    mug = Mug.load(client, MUGS[3], Pose())
    client.resetBasePositionAndOrientation(mug.body, [0.3, 0.1, 0.5], [0.5, 0.5, 0.5, 0.5])
    client.resetBaseVelocity(mug.body, [1.0, 1.0, 1.0], [1.0, 1.0, 1.0])
    assert mug.tilt() == pytest.approx(math.pi / 2)
    mug.move(TURNED)
    assert mug.position() == pytest.approx([TURNED.x, TURNED.y, 0.38])
    assert mug.tilt() == 0
    assert client.getBaseVelocity(mug.body) == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    place = client.getLinkState(mug.body, mug.handles["left"], computeForwardKinematics=1)[0]
    assert place == pytest.approx(handle_centre(TURNED, "left"), abs=1e-6)


def test_removing_a_mug_removes_its_constraints_only(client):
    kept, removed = Mug.load(client, MUGS[0], Pose(y=0.1)), Mug.load(client, MUGS[3], Pose())
    for mug in (kept, removed):
        frames = [[0.0, 0.0, 0.0]] * 3
        client.createConstraint(mug.body, -1, -1, -1, client.JOINT_FIXED, *frames)
    removed.remove()
    assert client.getNumConstraints() == 1
    assert client.getConstraintInfo(client.getConstraintUniqueId(0))[0] == kept.body
    assert client.getNumBodies() == 3


def test_a_mug_without_mass_for_the_cup_is_refused(client):
    with pytest.raises(ValueError, match=r"more than its 2 handles of 0.008 kg, got 0.01 kg"):
        Mug.load(client, MUGS[3], Pose(), mass=0.01)
