"""Mug lifting as a task for an agent."""

import os
from typing import Any, Literal, get_args

import numpy as np
import torch
from gymnasium.spaces import Box
from jsonargparse.typing import Path_fr
from numpy.typing import NDArray
from torch import Generator, Tensor

from bra.checks.arrays import Array
from bra.checks.settings import check_flag, check_real, check_seed
from bra.checks.tables import check_table
from bra.randomness.draws import Streams
from bra.tasks.base import World
from bra.tasks.finite import FiniteTask
from bra.tasks.nao_mugs.camera import HEAD_AT_REST, Camera, HeadPose, Studio
from bra.tasks.nao_mugs.jitter import Jitter
from bra.tasks.nao_mugs.lift import ACTIONS
from bra.tasks.nao_mugs.mugs import MUGS
from bra.tasks.nao_mugs.outcomes import try_lifts
from bra.tasks.nao_mugs.scene import Scene

UTILITIES = (
    (5.0, 0.0, 0.0, 0.0),
    (0.0, 5.0, 0.0, 3.0),
    (0.0, 0.0, 5.0, 3.0),
    (0.0, 0.0, 0.0, 5.0),
)
NO_LIFT = 0
PHYSICS_TRIALS = 16
"""Poses at which every lift is executed, where the pose varies."""

Reward = Literal["table", "physics"]


class NaoMugs(FiniteTask):
    """A NAO robot sees a mug and does not lift it, or does so with its left, right or both hands.

    The mugs have no handle (m0), a left one (mL), a right one (mR) or both (m2); the actions are
    no lift (a0), left (aL), right (aR) and both hands (a2). The signal ξ is a grey frame of the
    robot's bottom camera, or its contrast. After Peng, Genewein, Leibfried & Braun (IROS 2017), who
    print their utilities as a picture only: every mug has one best action, and lifting a mug of one
    handle with both hands is worth somewhat less. The default table reproduces the three regimes
    that they describe.

    Without jitter every mug has one frame, as in the paper, rendered once. With jitter frames are
    rendered as they are drawn, which takes far longer than an update: `bank` renders so many of
    every mug when the task is made, for encounters to be drawn from. Held-back frames, on which J
    is measured, are always new.

    With the reward "physics" an action is worth its utility only if the robot, when it executes
    it, succeeds: all lifts are executed when the task is made, at one pose, or at 16 poses if the
    pose varies, of which each encounter takes one. `utilities` are then the expected ones.

    Args:
        utilities: U(ω, a), (4, 4), rows m0, mL, mR, m2, columns a0, aL, aR, a2; `UTILITIES` if
            None.
        prior: p(ω), (4,); uniform if None.
        width: Pixels of a frame across.
        height: Pixels of a frame down.
        supersampling: Pixels rendered for one pixel, across and down.
        position_jitter: Largest shift of the mug along x and along y, m.
        angle_jitter: Largest turn of the mug, degrees.
        light_jitter: Largest relative change of the light, see `Jitter`.
        bank: Frames per mug that are rendered in advance; 0 renders every encounter anew.
        pixel_noise: Standard deviation of normal noise on every pixel, whose range is [0, 1].
        contrast: Whether the signal is not a pixel's grey g but its Weber contrast against the mean
            ḡ of its frame, (g − ḡ)/ḡ, clipped to [−1, 1]: the strength of the light cancels.
        reward: "table" for U(ω, a), "physics" for U(ω, a) of successful lifts and else 0.
        robot: Path of a URDF with NAO's joints to be used instead of the project's own.

    Attributes:
        jitter: How encounters differ.
        successes: With the reward "physics", whether lifts succeeded, (4, 4, trials), else None.

    Raises:
        ImportError: If pybullet cannot be imported.
        ValueError: If the table is not 4 × 4, a size, spread or the reward is out of range, or
            the robot does not serve.
    """

    successes: Tensor | None

    def __init__(
        self,
        utilities: Array | None = None,
        prior: Array | None = None,
        width: int = 16,
        height: int = 12,
        supersampling: int = 1,
        position_jitter: float = 0.0,
        angle_jitter: float = 0.0,
        light_jitter: float = 0.0,
        bank: int = 0,
        pixel_noise: float = 0.0,
        contrast: bool = False,
        reward: Reward = "table",
        robot: Path_fr | str | None = None,
    ) -> None:
        self._table = table = check_table(
            UTILITIES if utilities is None else utilities, "utilities"
        )
        if table.shape != (len(MUGS), len(ACTIONS)):
            raise ValueError(
                f"utilities must be a table of 4 mugs and 4 actions, got {tuple(table.shape)}"
            )
        check_reward(reward)
        check_real(pixel_noise, "pixel_noise", "at least 0", lambda noise: noise >= 0)
        check_seed(bank, "bank")
        check_flag(contrast, "contrast")
        self.camera = Camera(width, height, supersampling)
        self.jitter = Jitter(position_jitter, angle_jitter, light_jitter)
        self.pixel_noise = pixel_noise
        self.contrast = contrast
        self.robot = None if robot is None else os.path.abspath(os.fspath(robot))
        self._head_pose = HEAD_AT_REST if self.robot is None else _head_pose(self.robot)
        self._studio: Studio | None = None
        self.successes = None
        if reward == "physics":
            self.successes = execute_lifts(self.jitter, self.robot)
            table = table * self.successes.double().mean(-1)
        super().__init__(
            table,
            prior,
            observations=Box(
                -1.0 if contrast else 0.0, 1.0, shape=(1, height, width), dtype=np.float32
            ),
            state_names=[kind.name for kind in MUGS],
            action_names=ACTIONS,
        )
        self._bank: Tensor | None = None
        if not self.jitter.varies:
            self._bank = self._render_each(np.full((1, Jitter.NUMBERS), 0.5))
            if not pixel_noise:
                self.observations = self.signal(self._bank[:, 0])
        elif bank:
            self._bank = self._render_each(np.random.default_rng(0).random((bank, Jitter.NUMBERS)))
        if self._studio is not None:  # seldom needed again, and some 30 MB
            self._studio.close()
            self._studio = None

    def init_arguments(self) -> dict[str, Any]:
        """The robot's path in full."""
        given = super().init_arguments()
        return given | {"robot": self.robot} if type(self).__init__ is NaoMugs.__init__ else given

    def sample(self, count: int, generator: Generator) -> World:
        """Draws mugs from the prior, and frames of them, from the bank if there is one."""
        if self._bank is None:
            return super().sample(count, generator)
        numbers = torch.rand(2 * count, dtype=torch.double, generator=generator)
        state, frames = self._banked(self._bank, numbers)
        return World(state, self._signal(frames, generator))

    def sample_streams(self, count: int, streams: Streams, update: int) -> World:
        """Draws for all streams in one go where frames are rendered and without noise."""
        if self._bank is None or self.pixel_noise:
            return super().sample_streams(count, streams, update)
        state, frames = self._banked(self._bank, streams.uniform(update, 2 * count))
        return World(state, self.signal(frames))

    def _banked(self, bank: Tensor, numbers: Tensor) -> tuple[Tensor, Tensor]:
        """Mugs and frames of the bank, by one half of the numbers in [0, 1) each."""
        of_mugs, of_frames = numbers.chunk(2, -1)
        state = self._states_at(of_mugs)
        return state, bank[state, (of_frames * bank.shape[1]).long()]

    def observe(self, state: Tensor, generator: Generator) -> Tensor:
        """New frames of mugs, (batch,) to (batch, 1, height, width)."""
        if self._bank is not None and not self.jitter.varies:
            return self._signal(self._bank[state, 0], generator)
        size = (len(state), Jitter.NUMBERS)
        uniform = torch.rand(size, generator=generator, dtype=torch.double)
        return self._signal(self._render(state.numpy(), uniform.numpy()), generator)

    def signal(self, frames: Tensor) -> Tensor:
        """What the agent is given of grey frames, (…, 1, height, width) both."""
        if not self.contrast:
            return frames
        mean = frames.mean((-1, -2), keepdim=True).clamp_min(torch.finfo(frames.dtype).tiny)
        return (frames / mean - 1.0).clamp(-1.0, 1.0)

    def _signal(self, frames: Tensor, generator: Generator) -> Tensor:
        if self.pixel_noise:
            noise = torch.randn(frames.shape, generator=generator)
            frames = (frames + self.pixel_noise * noise).clamp(0.0, 1.0)
        return self.signal(frames)

    def utility(self, state: Tensor, action: Tensor) -> Tensor:
        """U(ω, a); with the reward "physics", of a lift at one of the poses drawn at random."""
        if self.successes is None:
            return super().utility(state, action)
        shape = (state + action).shape
        trial = torch.randint(self.successes.shape[-1], shape, device=state.device)
        succeeded = self.successes.to(state.device)[state, action, trial]
        return self._table.to(state.device, torch.get_default_dtype())[state, action] * succeeded

    def _render(self, mugs: NDArray[np.int64], uniform: NDArray[np.float64]) -> Tensor:
        """Frames (N, 1, height, width) of N mugs at poses and in light by N × 6 numbers."""
        if self._studio is None:  # one in every process that renders
            self._studio = Studio(self.camera, self._head_pose)
        frames = np.empty((len(mugs), *self.observation_space.shape), dtype=np.float32)  # type: ignore[misc]  # a Box has a shape
        for frame, mug, numbers in zip(frames, mugs, uniform, strict=True):
            pose, lamp = self.jitter.pose(numbers), self.jitter.lamp(numbers)
            frame[:] = self._studio.grey(MUGS[mug], pose, lamp)
        return torch.from_numpy(frames)

    def _render_each(self, uniform: NDArray[np.float64]) -> Tensor:
        """Frames (4, N, 1, height, width) of every mug at N poses."""
        return torch.stack(
            [self._render(np.full(len(uniform), mug), uniform) for mug in range(len(MUGS))]
        )

    def __getstate__(self) -> dict[str, Any]:
        """A simulation belongs to its process."""
        return self.__dict__ | {"_studio": None}


def check_reward(reward: Reward) -> Reward:
    """The reward, if it is one."""
    if reward not in get_args(Reward):
        raise ValueError(f"reward must be table or physics, got {reward!r}")
    return reward


def execute_lifts(jitter: Jitter, robot: str | None) -> Tensor:
    """Whether each action succeeds on each mug, (4, 4, trials).

    One trial if the pose is always the same, since lifts repeat to the last bit, else 16. There
    is nothing to fail in not lifting.
    """
    with Scene(robot) as scene:
        outcomes = try_lifts(scene, PHYSICS_TRIALS if jitter.moves else 1, jitter)
    successes = np.vectorize(lambda outcome: outcome.success)(outcomes)
    successes[:, NO_LIFT] = True
    return torch.from_numpy(successes)


def _head_pose(robot: str) -> HeadPose:
    with Scene(robot) as scene:
        return scene.robot.head_pose()
