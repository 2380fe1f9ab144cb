"""How fast frames come, and how long training waits for them.

    python benchmarks/streaming.py

Frames per second of jittered 16 × 12 frames (±1 cm, ±10°, light) for 0, 1 and 2 workers, drawn as
fast as they come, and the share of the training time that passes between two updates, in batches
of 64. Before that, what a frame costs with the robot in the simulation. Prints a table.
"""

import argparse
import time

import lightning.pytorch as pl
import torch

import bra
from bra.channels import MLP, Multinomial
from bra.tasks import NaoMugs, RolloutDataModule
from bra.tasks.nao_mugs import MUGS, Pose
from bra.tasks.nao_mugs.camera import Camera
from bra.tasks.nao_mugs.scene import Scene

JITTER = {"position_jitter": 0.01, "angle_jitter": 10.0, "light_jitter": 0.3}
BATCH = 64


def whole_scene(count: int) -> float:
    """Milliseconds per frame with the robot in the simulation."""
    camera = Camera()
    with Scene() as scene:
        scene.place(MUGS[3], Pose())
        head = scene.robot.head_pose()
        start = time.perf_counter()
        for _ in range(count):
            camera.grey(scene.client, head)
        return 1e3 * (time.perf_counter() - start) / count


def stream(task: NaoMugs, workers: int, updates: int) -> float:
    """Frames per second, workers started."""
    module = RolloutDataModule(task, BATCH, updates_per_epoch=updates + 8, workers=workers)
    batches = iter(module.train_dataloader())
    for _ in range(8):
        next(batches)
    start = time.perf_counter()
    for _ in batches:
        pass
    return BATCH * updates / (time.perf_counter() - start)


class Waiting(pl.Callback):
    """Adds up the time between the end of one update and the start of the next."""

    def __init__(self) -> None:
        self.waited = 0.0
        self.start = self.end = 0.0
        self.updates = 0

    def on_train_batch_start(self, *_: object) -> None:
        """The wait is over."""
        now = time.perf_counter()
        self.updates += 1
        if self.updates == 9:  # workers have started
            self.start = now
        elif self.updates > 9:
            self.waited += now - self.end

    def on_train_batch_end(self, *_: object) -> None:
        """The wait begins."""
        self.end = time.perf_counter()


def train(task: NaoMugs, workers: int, updates: int) -> tuple[float, float]:
    """Milliseconds per update, and the share of them that passes between updates."""
    agent = bra.Agent(task, MLP, Multinomial, percepts=4, seed=0)
    waiting = Waiting()
    trainer = pl.Trainer(
        max_epochs=1,
        logger=False,
        callbacks=[waiting],
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        num_sanity_val_steps=0,
        limit_val_batches=0,
    )
    module = RolloutDataModule(task, BATCH, updates_per_epoch=updates + 8, workers=workers)
    trainer.fit(agent, module)
    total = waiting.end - waiting.start
    return 1e3 * total / updates, waiting.waited / total


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--updates", type=int, default=300)
    updates = parser.parse_args().updates
    torch.set_num_threads(1)
    tasks = {
        "rendered anew": NaoMugs(**JITTER),
        "from a bank": NaoMugs(**JITTER, bank=2048),
        "fixed": NaoMugs(),
    }
    print(f"a frame of the whole scene: {whole_scene(500):.2f} ms")
    print("| frames | workers | frames/s | ms per update of 64 | waiting |")
    print("|---|---|---|---|---|")
    for name, task in tasks.items():
        for workers in (0, 1, 2):
            rate = stream(task, workers, updates)
            step, share = train(task, workers, updates)
            print(f"| {name} | {workers} | {rate:,.0f} | {step:.1f} | {share:.0%} |")


if __name__ == "__main__":
    main()
