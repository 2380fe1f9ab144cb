"""Reaching for a mug's handles with one hand or both, and lifting what they hold."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from bra.tasks.nao_mugs.kinematics import Array
from bra.tasks.nao_mugs.mugs import HANDLE_REACH, SIDES, Mug, Pose, Side, handle_centre
from bra.tasks.nao_mugs.robot import Robot
from bra.tasks.nao_mugs.scene import Scene

ACTIONS = ("a0", "aL", "aR", "a2")
"""Nothing, the left hand, the right hand, both."""
HANDS: tuple[tuple[Side, ...], ...] = ((), ("left",), ("right",), ("left", "right"))

REACH_X = (0.14, 0.21)  # m, for a mug in the middle that is not turned
REACH_Y = 0.02  # m to either side
REACH_YAW = math.radians(12)  # either way

RISE = 0.08  # m that the hands go up
RETREAT = 0.055  # m from the handle at which the straight approach begins
FOLDED = 0.151  # m between shoulder and grip point, the arm folded as far as it goes
CLOSED = 0.002  # m, target of the jaws: inside the bar, so that they press
EASED = 0.0055  # m, target of jaws that hold: pressing on would double the lift's cost in time
PRESS = 0.2  # N that each jaw must exert on the handle
ANCHOR = 0.009  # m along the bar from its centre to either anchor
RISEN = 0.05  # m that a lifted mug has risen at least
UPRIGHT = math.radians(45)  # that it is tilted at most

REACHING, APPROACHING, CLOSING, LIFTING, HOLDING = 168, 96, 64, 160, 120
"""Time steps of the phases."""
WATCH_EVERY = 8
"""Time steps between two looks of a spectator: 30 a second."""

# Left arm; the hand passes the table's edge outside and above.
WAY = ((1.35, 1.17, -1.75, -0.25, 0.0), (0.48, 1.20, -0.95, -1.15, 0.0))
GRASPING = (0.41, 0.27, -0.32, -1.11, 0.44)
MIRROR = np.array([1.0, -1.0, -1.0, -1.0, -1.0])  # the right arm's angles from the left one's


@dataclass(frozen=True)
class Outcome:
    """What a lift led to, after the hold.

    Attributes:
        success: The mug has risen more than 5 cm and is tilted less than 45°.
        rise: How far the middle of the cup has risen, m.
        tilt: Angle between the cup's axis and the vertical, rad.
        left_contact: Both jaws of the left hand pressed a handle, and the hand held it.
        right_contact: The same for the right hand.
        torques: What the motors of both arms' joints exert at the end of the hold, by name, Nm.
    """

    success: bool
    rise: float
    tilt: float
    left_contact: bool
    right_contact: bool
    torques: dict[str, float]

    @property
    def shoulder_torque(self) -> float:
        """The largest torque of a shoulder's motor, Nm."""
        return max(abs(torque) for name, torque in self.torques.items() if "Shoulder" in name)


@dataclass(frozen=True)
class Plan:
    """Angles of one arm at every time step of the phases in which it moves, (steps, 5), rad."""

    reach: Array
    approach: Array
    lift: Array


def reach(y: float, yaw: float) -> tuple[float, float]:
    """The range of x in which both hands get hold of a mug's handles, m.

    Measured: 0.14 to 0.21 m, less what the turn moves a handle and half of what the mug is aside.

    Args:
        y: Where the mug stands, m.
        yaw: How it is turned, rad.
    """
    margin = abs(HANDLE_REACH * math.sin(yaw)) + abs(y) / 2
    return REACH_X[0] + margin, REACH_X[1] - margin


def check_pose(pose: Pose) -> None:
    """Refuses mugs that stand where a hand cannot get hold of them.

    Raises:
        ValueError: If the pose is out of reach.
    """
    low, high = reach(pose.y, pose.yaw)
    if low <= pose.x <= high and abs(pose.y) <= REACH_Y and abs(pose.yaw) <= REACH_YAW:
        return
    at = f"x {pose.x:g} m, y {pose.y:g} m, yaw {math.degrees(pose.yaw):.3g}°"
    reachable = f"|y| at most {REACH_Y} m, |yaw| at most {math.degrees(REACH_YAW):.0f}°"
    if low < high:
        reachable += f", and x there from {low:.3f} to {high:.3f} m"
    raise ValueError(f"the hands do not reach a mug at {at}; expected {reachable}")


def lift(scene: Scene, action: int, pose: Pose, watch: Callable[[], None] | None = None) -> Outcome:
    """Goes to where the handles would be, closes the hands, and lifts what they hold.

    Call it right after `Scene.place`. Pre-grasp, approach, close, test of contact, lift by 8 cm,
    hold for 0.5 s. A hand holds only what it feels: both its jaws must press the same handle with
    more than 0.2 N. What it holds it lets go at the end.

    Args:
        scene: With a mug in place and the robot at rest.
        action: Index into `ACTIONS`.
        pose: Where the mug is believed to stand.
        watch: Called every 8 time steps, for pictures.

    Raises:
        ValueError: If the action is none, there is no mug, or the pose is out of reach.
    """
    if action not in range(len(ACTIONS)):
        raise ValueError(f"action must be 0 to {len(ACTIONS) - 1} for {ACTIONS}, got {action}")
    if scene.mug is None:
        raise ValueError("there is no mug to lift; call the scene's place first")
    check_pose(pose)
    robot, mug = scene.robot, scene.mug
    height = mug.position()[2]
    plans = {side: _plan(robot, pose, side) for side in HANDS[action]}
    if not plans:
        _wait(scene, HOLDING, watch)
        return _outcome(robot, mug, height, [])
    _follow(scene, {side: plan.reach for side, plan in plans.items()}, watch)
    _follow(scene, {side: plan.approach for side, plan in plans.items()}, watch)
    for side in plans:
        robot.grip(side, CLOSED)
    _wait(scene, CLOSING, watch)
    holding = [side for side in plans if feels_handle(robot, mug, side)]
    with _held(robot, mug, holding):
        _follow(scene, {side: plan.lift for side, plan in plans.items()}, watch)
        _wait(scene, HOLDING, watch)
        return _outcome(robot, mug, height, holding)


def feels_handle(robot: Robot, mug: Mug, side: Side) -> bool:
    """Whether both jaws of a hand press a handle of that side with more than 0.2 N."""
    links = {link: name for name, link in mug.handles.items()}
    for jaw in robot.arms[side].jaws:
        contacts = robot.client.getContactPoints(robot.body, mug.body, jaw)
        if sum(contact[9] for contact in contacts if links.get(contact[4]) == side) <= PRESS:
            return False
    return True


def _outcome(robot: Robot, mug: Mug, height: float, holding: list[Side]) -> Outcome:
    rise, tilt = float(mug.position()[2] - height), mug.tilt()
    return Outcome(
        success=rise > RISEN and tilt < UPRIGHT,
        rise=rise,
        tilt=tilt,
        left_contact="left" in holding,
        right_contact="right" in holding,
        torques=robot.torques(),
    )


def _plan(robot: Robot, pose: Pose, side: Side) -> Plan:
    """The way of one hand.

    Raises:
        ValueError: If the grip point stays more than 1 mm away from the handle.
    """
    chain = robot.arms[side].chain
    mirror = MIRROR if side == "right" else np.ones(5)
    bar = handle_centre(pose, side)
    grasp = chain.level(bar[None], mirror * GRASPING)
    if not grasp.distance[0] <= 1e-3:
        raise ValueError(
            f"the {side} hand stays {1e3 * grasp.distance[0]:.1f} mm away from the handle of a mug "
            f"at {pose}; expected less than 1 mm"
        )
    forward = chain.forward(grasp.angles)[0, :3, 0]
    back = bar - np.linspace(RETREAT, 0, 8)[:, None] * forward
    back[:-1] = _unfolded(back[:-1], forward, side, chain.root)
    up = bar + np.linspace(0, RISE, 9)[:, None] * [0, 0, 1]
    angles = chain.level(np.concatenate([back, up]), grasp.angles[0]).angles
    way = np.array([robot.rest(side), *(mirror * np.array(WAY)), angles[0]])
    return Plan(
        reach=_paced(way, REACHING),
        approach=_paced(angles[: len(back)], APPROACHING),
        lift=_paced(angles[len(back) :], LIFTING),
    )


def _unfolded(places: Array, forward: Array, side: Side, shoulder: Array) -> Array:
    """Places moved outwards, across the hand, until the arm can fold far enough to reach them."""
    across = SIDES[side] * np.array([-forward[1], forward[0], 0.0])
    away = places - shoulder
    along, missing = away @ across, FOLDED**2 - (away**2).sum(axis=1)
    # |away + t across| = FOLDED
    shift = np.sqrt(np.maximum(along**2 + missing, 0)) - along
    moved: Array = places + np.where(missing > 0, shift, 0)[:, None] * across
    return moved


def _paced(way: Array, steps: int) -> Array:
    """A way through postures at equal spacing, (steps, joints), from rest to rest: 3u² − 2u³."""
    time = np.arange(1, steps + 1) / steps
    places = (3 * time**2 - 2 * time**3) * (len(way) - 1)
    at = np.arange(len(way))
    return np.stack([np.interp(places, at, joint) for joint in way.T], axis=1)


def _follow(scene: Scene, ways: dict[Side, Array], watch: Callable[[], None] | None) -> None:
    steps = len(next(iter(ways.values())))
    for step in range(steps):
        for side, way in ways.items():
            scene.robot.move(side, way[step])
        scene.step()
        if watch is not None and (step + 1) % WATCH_EVERY == 0:
            watch()


def _wait(scene: Scene, steps: int, watch: Callable[[], None] | None) -> None:
    for _ in range(steps // WATCH_EVERY):
        scene.step(WATCH_EVERY)
        if watch is not None:
            watch()


@contextmanager
def _held(robot: Robot, mug: Mug, sides: list[Side]) -> Iterator[None]:
    """Ties the hands to the handles that they feel: two points each, free to turn about the bar."""
    ties = []
    for side in sides:
        ties += _tie(robot, mug, side)
        robot.grip(side, EASED)
    try:
        yield
    finally:  # before the mug they are on is removed
        for tie in ties:
            robot.client.removeConstraint(tie)


def _tie(robot: Robot, mug: Mug, side: Side) -> list[int]:
    client, gripper, handle = robot.client, robot.arms[side].gripper, mug.handles[side]
    bar = client.getLinkState(mug.body, handle)
    into_gripper = client.invertTransform(*client.getLinkState(robot.body, gripper)[:2])
    into_bar = client.invertTransform(*bar[:2])
    ties = []
    for along in (ANCHOR, -ANCHOR):
        point, _ = client.multiplyTransforms(bar[4], bar[5], (0, 0, along), (0, 0, 0, 1))
        # Constraints count from centres of mass.
        on_gripper, _ = client.multiplyTransforms(*into_gripper, point, (0, 0, 0, 1))
        on_bar, _ = client.multiplyTransforms(*into_bar, point, (0, 0, 0, 1))
        tie = client.createConstraint(
            robot.body,
            gripper,
            mug.body,
            handle,
            client.JOINT_POINT2POINT,
            (0, 0, 0),
            on_gripper,
            on_bar,
        )
        ties.append(int(tie))
    return ties
