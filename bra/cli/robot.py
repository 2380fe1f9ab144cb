"""Commands that let the robot act: `bra rollout` and `bra outcomes`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from bra.agent.agent import Agent
from bra.agent.run_folder import new_file
from bra.checks.settings import check_count
from bra.checks.words import amount
from bra.cli.functions import load_agent, run_folder
from bra.randomness.generators import counted
from bra.tasks.nao_mugs import MUGS, NaoMugs
from bra.tasks.nao_mugs.environment import NaoMugsEnv
from bra.tasks.nao_mugs.film import Film
from bra.tasks.nao_mugs.jitter import Jitter
from bra.tasks.nao_mugs.lift import ACTIONS
from bra.tasks.nao_mugs.outcomes import SuccessMatrix, success_matrix
from bra.tasks.nao_mugs.scene import Scene
from bra.tasks.observations import grey_levels

FRAMES_APART = 3
"""A film shows every third of the 30 moments a second at which a spectator is called."""


class Encounter(NamedTuple):
    """What came of one episode."""

    mug: str
    percept: int
    action: str
    outcome: str
    utility: float


def rollout(
    ckpt_path: str,
    episodes: int = 12,
    seed: int = 0,
    film: Sequence[int] | None = None,
    folder: str | None = None,
    gui: bool = False,
    trusted: Sequence[str] | str = (),
) -> None:
    """Lets a trained agent see mugs and lift them, and reports on every encounter.

    Prints mug, percept, action, outcome and utility per episode, and a table of what was done to
    which mug. Writes `rollout.gif`, and `rollout.mp4` where there is a program `ffmpeg`.

    Args:
        ckpt_path: Checkpoint of an agent whose task is NaoMugs.
        episodes: Number of encounters.
        seed: Of mugs, poses, light, percepts and actions.
        film: Numbers of the episodes to film, the first being 1; [] films none, None the first
            four.
        folder: Where the film goes; None is the folder of the run that the checkpoint is from.
        gui: Opens the simulator's window.
        trusted: Module of one's own, or a list of them, that may be imported for the checkpoint's
            classes.

    Raises:
        ValueError: If the file is no checkpoint of such an agent, or an episode to be filmed is
            not among those played.
        RuntimeError: If a window is asked for and there is no display.
    """
    check_count(episodes, "episodes")
    if seed < 0:
        raise ValueError(f"seed must be at least 0, got {seed}")
    film = range(1, min(episodes, 4) + 1) if film is None else film
    strangers = [number for number in film if not 1 <= number <= episodes]
    if strangers:
        raise ValueError(f"film must name episodes from 1 to {episodes}, got {strangers}")
    agent, task = load_robot(ckpt_path, trusted)
    target = Path(folder) if folder else run_folder(Path(ckpt_path))
    target.mkdir(parents=True, exist_ok=True)
    env = NaoMugsEnv("human" if gui else None, **task.init_arguments())
    movie = Film()
    encounters = []
    print(f"{'episode':>7}  {'mug':4}{'percept':9}{'action':8}{'outcome':20}{'utility':>7}")
    for number in range(1, episodes + 1):
        encounter = play(agent, env, seed, number, movie if number in film else None)
        encounters.append(encounter)
        mug, percept, action, outcome, utility = encounter
        print(f"{number:>7}  {mug:4}{f'x{percept}':9}{action:8}{outcome:20}{utility:7.2f}")
    env.close()
    print(f"\n{action_table(encounters, task)}")
    if movie.frames:
        write_film(movie, target)


def load_robot(path: str, trusted: Sequence[str] | str) -> tuple[Agent, NaoMugs]:
    """A checkpoint's agent, and its task, if these are mugs."""
    agent = load_agent(path, trusted)
    if not isinstance(agent.task, NaoMugs):
        raise ValueError(
            f"rollout shows agents of NaoMugs, this one's task is {type(agent.task).__name__}; "
            "use bra predict"
        )
    return agent, agent.task


def outcomes(
    trials: int = 100,
    position_jitter: float = 0.01,
    angle_jitter: float = 10.0,
    seed: int = 0,
    robot: str | None = None,
    folder: str = ".",
) -> None:
    """Measures which action lifts which mug, as `outcomes.csv` and `outcomes.png`.

    Args:
        trials: Executed lifts per mug and action.
        position_jitter: Largest shift of the mug along x and along y, m.
        angle_jitter: Largest turn of the mug, degrees.
        seed: Of the poses.
        robot: Path of a URDF to be used instead of the project's own robot.
        folder: Where the files go.

    Raises:
        ValueError: If a number is out of range, or the robot does not serve.
    """
    jitter = Jitter(position_jitter, angle_jitter)
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    with Scene(robot) as scene:
        matrix = success_matrix(scene, trials, jitter, seed)
    table, picture = new_file(target, "outcomes.csv"), new_file(target, "outcomes.png")
    matrix.write_csv(str(table))
    matrix.draw().save(picture)
    print(success_table(matrix))
    print(f"written to {table} and {picture}")


def play(agent: Agent, env: NaoMugsEnv, seed: int, number: int, movie: Film | None) -> Encounter:
    """One episode, filmed if there is a film to take it."""
    frame, seen = env.reset(seed=seed if number == 1 else None)
    with counted(seed, number, "rollout", torch.device("cpu")):
        percept, action = (int(part) for part in agent.act(torch.from_numpy(frame)))
    mug, done = seen["mug"], env.task.action_names[action]
    lines = [f"episode {number}: {mug}", f"percept x{percept}", f"action {done}"]
    waiting = env.spectator
    view = grey_levels(env.observation_space, torch.from_numpy(frame)).numpy()
    moments = 0

    def spectator() -> None:
        nonlocal moments
        if waiting is not None:
            waiting()
        if movie is not None and moments % FRAMES_APART == 0:
            movie.take(env.scene.window(), view, lines)
        moments += 1

    env.spectator = spectator
    _, utility, _, _, info = env.step(np.int64(action))
    env.spectator = waiting
    outcome = describe(done, info)
    if movie is not None:
        movie.take(env.scene.window(), view, [*lines, outcome, f"utility {utility:g}"])
        movie.hold(seconds=1.0)
    return Encounter(mug, percept, done, outcome, float(utility))


def describe(action: str, info: dict[str, Any]) -> str:
    """An outcome in a few words."""
    if action == "a0":
        return "left alone"
    if info["success"]:
        return f"lifted {100 * info['rise']:.1f} cm"
    if not (info["left_contact"] or info["right_contact"]):
        return "no handle in hand"
    return f"lost: risen {100 * info['rise']:.1f} cm"


def action_table(encounters: Sequence[Encounter], task: NaoMugs) -> str:
    """How often each action met each mug, how often it lifted it, and the mean utility."""
    lines = ["mug \\ action" + "".join(f"{name:>6}" for name in task.action_names)]
    lines[0] += f"{'lifted':>9}{'mean U':>8}"
    for mug in task.state_names:
        met = [encounter for encounter in encounters if encounter.mug == mug]
        counts = (sum(one.action == action for one in met) for action in task.action_names)
        cells = "".join(f"{count or '·':>6}" for count in counts)
        lifted = sum(one.outcome.startswith("lifted") for one in met)
        mean = f"{sum(one.utility for one in met) / len(met):.2f}" if met else ""
        lines.append(f"{mug:12}{cells}{f'{lifted}/{len(met)}':>9}{mean:>8}")
    total = sum(encounter.utility for encounter in encounters) / len(encounters)
    lines.append(f"mean utility of {amount(len(encounters), 'episode')}: {total:.3f}")
    return "\n".join(lines)


def success_table(matrix: SuccessMatrix) -> str:
    """Successful lifts of all, per mug and action."""
    lines = ["mug \\ action" + "".join(f"{name:>9}" for name in ACTIONS)]
    for mug, succeeded, tried in zip(MUGS, matrix.successes, matrix.attempts, strict=True):
        cells = (f"{part}/{whole}" for part, whole in zip(succeeded, tried, strict=True))
        lines.append(f"{mug.name:12}" + "".join(f"{cell:>9}" for cell in cells))
    return "\n".join(lines)


def write_film(movie: Film, folder: Path) -> None:
    """Writes all kinds of film that can be written here, and says where."""
    gif, mp4 = new_file(folder, "rollout.gif"), new_file(folder, "rollout.mp4")
    movie.write_gif(gif)
    if movie.write_mp4(mp4):
        print(f"film: {gif}, {mp4}")
    else:
        mp4.unlink()
        print(f"film: {gif} (no ffmpeg for an MP4)")
