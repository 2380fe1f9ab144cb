"""Mug lifting as a Gymnasium environment."""

import time
from collections.abc import Callable
from dataclasses import astuple, fields
from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from numpy.typing import NDArray

from bra.tasks.nao_mugs.camera import Light
from bra.tasks.nao_mugs.jitter import Jitter
from bra.tasks.nao_mugs.lift import check_pose, lift
from bra.tasks.nao_mugs.mugs import MUGS, Pose
from bra.tasks.nao_mugs.scene import Scene
from bra.tasks.nao_mugs.task import NO_LIFT, NaoMugs, Reward, check_reward

OPTIONS = ("mug", "pose", "light")


class NaoMugsEnv(gymnasium.Env[NDArray[np.float32], np.int64]):
    """One encounter an episode: the robot sees a mug, and executes one of the four actions.

    `gymnasium.make("bra/NaoMugs-v0")`. Observation: the camera's frame, (1, height, width) in
    [0, 1], or its contrast in [−1, 1]. Action: 0 no lift, 1 left, 2 right, 3 both hands. `info` of
    `reset` holds `mug`, `pose` (x, y in m, yaw in rad) and `light`; that of `step` holds `mug` and
    the fields of `Outcome`.

    `reset(options={…})` fixes what would be drawn: `mug` (a name or 0 … 3), `pose` (x, y, yaw) and
    `light` (a `Light`). The robot knows the mug's pose, and never which mug it is.

    Args:
        render_mode: "rgb_array" for pictures from `render()`, "human" for a window, or None.
        reward: "table" for U(ω, a), "physics" for U(ω, a) if the lift succeeds and else 0.
        settings: Other arguments of `bra.tasks.nao_mugs.NaoMugs`.

    Attributes:
        task: Prior, utilities, camera and jitter.
        scene: The simulation.
        spectator: Called 30 times a second of simulated time while the robot moves, or None.

    Raises:
        ValueError: As `NaoMugs`, or if the render mode is unknown.
        RuntimeError: If a window is asked for and there is no display.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]  # Gymnasium declares no ClassVar
        "render_modes": ["rgb_array", "human"],
        "render_fps": 30,
    }

    def __init__(
        self, render_mode: str | None = None, reward: Reward = "table", **settings: Any
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode must be rgb_array, human or None, got {render_mode!r}")
        self.render_mode = render_mode
        self.task = NaoMugs(**settings | {"bank": 0})  # every encounter is rendered anew
        self.reward = check_reward(reward)
        self.observation_space = self.task.observation_space
        self.action_space = self.task.action_space
        self.scene = Scene(self.task.robot, gui=render_mode == "human")
        self.spectator: Callable[[], None] | None = self._wait if render_mode == "human" else None
        self._encounter: tuple[int, Pose, Light] | None = None
        self._closed = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Puts a mug on the table, and looks at it.

        Args:
            seed: Of all that is drawn from now on; None goes on drawing.
            options: See the class.

        Raises:
            ClosedEnvironmentError: If the environment is closed.
            ValueError: If an option is unknown, or a mug, pose or light out of range.
        """
        if self._closed:
            raise ClosedEnvironmentError("the environment is closed; make a new one")
        super().reset(seed=seed)
        options = options or {}
        unknown = set(options) - set(OPTIONS)
        if unknown:
            raise ValueError(
                f"unknown options {sorted(map(str, unknown))}; expected {', '.join(OPTIONS)}"
            )
        # All is drawn whatever is fixed, so that options do not change later episodes.
        mug = int(self.np_random.choice(len(MUGS), p=self.task.prior.numpy()))
        uniform = self.np_random.random(Jitter.NUMBERS)
        noise = self.task.pixel_noise * self.np_random.standard_normal(self.observation_space.shape)
        mug = _mug(options["mug"]) if "mug" in options else mug
        pose = _pose(options["pose"]) if "pose" in options else self.task.jitter.pose(uniform)
        light = _light(options["light"]) if "light" in options else self.task.jitter.lamp(uniform)
        self.scene.place(MUGS[mug], pose)
        self._encounter = mug, pose, light
        frame = np.clip(self._look(light) + noise, 0.0, 1.0).astype(np.float32)
        return self._signal(frame), {"mug": MUGS[mug].name, "pose": astuple(pose), "light": light}

    def step(
        self, action: np.int64
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Executes an action, which ends the episode.

        Raises:
            ResetNeeded: If there is no mug to act on: before `reset`, or a second time after it.
            ValueError: If the action is not one of the four.
        """
        if self._encounter is None:
            raise ResetNeeded("no mug is on the table: call reset() before each step()")
        if not self.action_space.contains(action):
            raise ValueError(f"action must be 0, 1, 2 or 3, got {action!r}")
        chosen = int(action)
        mug, pose, light = self._encounter
        self._encounter = None
        outcome = lift(self.scene, chosen, pose, self.spectator)
        worth = self.reward == "table" or chosen == NO_LIFT or outcome.success
        utility = self.task.utilities[mug, chosen].item() if worth else 0.0
        info = {"mug": MUGS[mug].name} | {
            field.name: getattr(outcome, field.name) for field in fields(outcome)
        }
        return self._signal(self._look(light)), utility, True, False, info

    def render(self) -> NDArray[np.uint8] | None:
        """The scene from outside, (480, 640, 3), in the mode "rgb_array"."""
        return self.scene.window() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Ends the simulation; closing again does nothing."""
        self._closed, self._encounter = True, None
        self.scene.close()

    def _look(self, light: Light) -> NDArray[np.float32]:
        return self.task.camera.grey(self.scene.client, self.scene.robot.head_pose(), light)

    def _signal(self, frame: NDArray[np.float32]) -> NDArray[np.float32]:
        signal: NDArray[np.float32] = self.task.signal(torch.from_numpy(frame)).numpy()
        return signal

    def _wait(self) -> None:
        time.sleep(1 / self.metadata["render_fps"])


def _mug(mug: Any) -> int:
    names = [kind.name for kind in MUGS]
    if isinstance(mug, str) and mug in names:
        return names.index(mug)
    if isinstance(mug, int | np.integer) and not isinstance(mug, bool) and 0 <= mug < len(MUGS):
        return int(mug)
    raise ValueError(f"mug must be one of {', '.join(names)} or 0 to {len(MUGS) - 1}, got {mug!r}")


def _pose(pose: Any) -> Pose:
    try:
        x, y, yaw = map(float, astuple(pose) if isinstance(pose, Pose) else pose)
    except (TypeError, ValueError) as error:
        raise ValueError(f"pose must be x, y (m) and yaw (rad), got {pose!r}") from error
    check_pose(Pose(x, y, yaw))
    return Pose(x, y, yaw)


def _light(light: Any) -> Light:
    if not isinstance(light, Light):
        raise ValueError(f"light must be a bra.tasks.nao_mugs.Light, got {light!r}")
    return light
