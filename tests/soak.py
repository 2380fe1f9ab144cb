"""Kills trainings of every kind at random moments, and resets the robot, for as long as one likes.

    python tests/soak.py [--kinds KIND …] [--kills 20] [--resets 2000] [--seed 0]

Every kind of run is trained once without a cut. Then it is trained again, killed by SIGKILL after a
random time, resumed by `--ckpt_path last`, killed again, and so on, and at last left alone: it must
end with the same checkpoint, bit by bit. The robot's environment is reset; its memory must stay
flat. Ends with code 1 if something does not hold.
"""

import argparse
import contextlib
import gc
import json
import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

import torch

from bra.checkpoints.files import find_flaw
from bra.checkpoints.recipes import same_recipe
from bra.cli import main
from bra.tasks.nao_mugs.environment import NaoMugsEnv

CONFIGS = Path(__file__).parents[1] / "configs"
KINDS = {
    "projection": ["predator_prey", "--data.updates_per_epoch=300"],
    "gradient": [
        "predator_prey",
        "--data.updates_per_epoch=300",
        "--model.update_rule=ExactGradient",
    ],
    "score": ["predator_prey_online", "--data.updates_per_epoch=300"],
    "critic": ["predator_prey_critic", "--data.updates_per_epoch=300"],
    "population": ["predator_prey", "--data.updates_per_epoch=100", "--model.replicas=4"],
    "robot": [
        "nao_mugs_jitter",
        *("--data.updates_per_epoch=50", "--data.workers=2"),
        *("--data.task.bank=0", "--data.batch_size=4", "--data.evaluation_worlds=16"),
    ],
}
OFTEN = {"every_n_train_steps": 10, "save_last": True, "save_top_k": 1}
COMMON = [
    *("--trainer.max_epochs=8", "--trainer.enable_progress_bar=false"),
    *("--baseline=null", "--behaviour=null", "--frames=null"),
    f"--trainer.callbacks={json.dumps([{'class_path': 'ModelCheckpoint', 'init_args': OFTEN}])}",
]
SAME = ("state_dict", "optimizer_states", "lr_schedulers", "loops", "epoch", "global_step", "bra")
MOST = 2**12
"""KiB by which memory may grow over the second half of the resets."""


def start(kind: str, folder: Path) -> int:
    """Trains in a forked process, from the last checkpoint in the folder if there is one."""
    config, *words = KINDS[kind]
    resume = ["--ckpt_path=last"] if any(folder.rglob("last*.ckpt")) else []
    if process := os.fork():
        return process
    os.setsid()
    os.chdir(folder)
    with Path("said.txt").open("a") as said:
        os.dup2(said.fileno(), 1)
        os.dup2(said.fileno(), 2)
    code = 1
    with contextlib.suppress(SystemExit):
        main(["fit", f"--config={CONFIGS / config}.yaml", *words, *COMMON, *resume])
        code = 0
    os._exit(code)


def ended(process: int) -> bool:
    """Whether it has; if it failed, the soak ends."""
    pid, status = os.waitpid(process, os.WNOHANG)
    if pid and status:
        raise SystemExit(f"a run ended with status {status}")
    return bool(pid)


def finish(process: int) -> None:
    while not ended(process):
        time.sleep(0.05)


def newest(folder: Path) -> Path:
    return max(folder.rglob("last*.ckpt"), key=lambda path: path.stat().st_mtime)


def kill(kind: str, folder: Path, longest: float) -> bool:
    """Starts a run and kills it within so many seconds; whether it was still alive."""
    process = start(kind, folder)
    end = time.monotonic() + random.uniform(0, longest)
    while time.monotonic() < end:
        if ended(process):
            return False
        time.sleep(0.002)
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    flawed = [path for path in folder.rglob("*.ckpt") if find_flaw(path)]
    if flawed:
        raise SystemExit(f"damaged: {flawed}")
    return True


def soak(kind: str, kills: int) -> bool:
    """Whether a run that is killed again and again ends as one that is not."""
    with tempfile.TemporaryDirectory() as name:
        whole, cut = Path(name) / "whole", Path(name) / "cut"
        whole.mkdir()
        cut.mkdir()
        begin = time.monotonic()
        process = start(kind, whole)
        while not any(whole.rglob("last*.ckpt")) and not ended(process):
            time.sleep(0.02)
        setup = time.monotonic() - begin
        finish(process)
        training = time.monotonic() - begin - setup
        made = sum(kill(kind, cut, setup + 2 * training / kills) for _ in range(kills))
        finish(start(kind, cut))
        one, other = (torch.load(newest(folder), weights_only=True) for folder in (whole, cut))
        differ = [key for key in SAME if not same_recipe(one[key], other[key])]
    print(f"{kind}: {one['bra']['updates']} updates, {made} kills, {differ or 'all'} ", end="")
    print("differ" if differ else "equal bit by bit", flush=True)
    return not differ


def memory() -> int:
    """Resident memory, KiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") // 1024


def reset(resets: int) -> bool:
    """Whether memory stays flat over the second half of so many resets."""
    env = NaoMugsEnv()
    found = []
    for number in range(resets):
        env.reset()
        if number in (resets // 2, resets - 1):
            gc.collect()
            found.append(memory())
    env.close()
    print(f"{resets} resets: {found[1] - found[0]} KiB more over the second half")
    return found[1] - found[0] < MOST


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="See the top of the file.")
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=[*KINDS])
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--resets", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    random.seed(asked.seed)
    torch.set_num_threads(1)
    holds = [soak(kind, asked.kills) for kind in asked.kinds]
    holds += [reset(asked.resets)] if asked.resets else []
    sys.exit(not all(holds))
