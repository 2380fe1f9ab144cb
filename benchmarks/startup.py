"""How long every command takes until it answers, or until it trains.

    python benchmarks/startup.py [runs] [another checkout, such as an older one [its Python]]

Prints medians over fresh processes, in seconds of wall time and of CPU, of this checkout and of the
other one, whose processes take turns. *First update* is `bra fit` of predator-prey with all its
monitors, ended when the first update is about to be made.
"""

import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import lightning.pytorch as pl

Seconds = tuple[float, float]
"""Of wall time, and of CPU."""
HERE = Path(__file__).parents[1]
COMMAND = "from bra.cli import main; main()"
FIT = ("fit", f"--config={HERE / 'configs/predator_prey.yaml'}")
CASES: dict[str, tuple[str, ...]] = {
    "`import torch`": ("import torch",),
    "`import lightning.pytorch`": ("import lightning.pytorch",),
    "`import bra`": ("import bra",),
    "`import bra.blahut_arimoto`": ("import bra.blahut_arimoto",),
    "`import bra.tasks`": ("import bra.tasks",),
    "`bra --help`": (COMMAND, "--help"),
    "a command that there is not": (COMMAND, "fti"),
    "a configuration that there is not": (COMMAND, "fit", "--config=nowhere.yaml"),
    "`bra fit --help`": (COMMAND, "fit", "--help"),
    "a key that there is not": (COMMAND, *FIT, "--model.persepts=3"),
    "**first update**": (COMMAND, *FIT, "--trainer.callbacks+=startup.Stop"),
}


class Stop(pl.Callback):
    """Ends the process when the first update is about to be made."""

    def on_train_batch_start(self, *_: Any) -> None:
        """Ends it."""
        os._exit(0)


def processor() -> str:
    """The processor's name."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if sys.platform == "linux" else []
    names = (line.partition(": ")[2] for line in lines if line.startswith("model name"))
    return next(names, platform.processor())


def measure(
    python: str, arguments: tuple[str, ...], checkout: Path, folder: str, code: int
) -> Seconds:
    """One process, which has to end with this code."""
    path = f"{checkout}{os.pathsep}{HERE / 'benchmarks'}"
    environment = os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    command = [python, "-c", *arguments]
    start = time.perf_counter()
    process = subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != code:
        raise RuntimeError(f"{command} ended with code {process.returncode}, not {code}")
    return wall, usage.ru_utime + usage.ru_stime


def main(runs: int = 7, before: str = "", python: str = sys.executable) -> None:
    """Prints a table."""
    pythons = {Path(before).resolve(): python} if before else {}
    pythons[HERE] = sys.executable
    checkouts = list(pythons)
    print(f"{processor()}, Python {platform.python_version()}\n")
    titles = ["before, s", "now, s"] if before else ["s"]
    print("| until | " + " | ".join(f"{title} | CPU" for title in titles) + " |")
    print("|---|" + "---|---|" * len(checkouts))
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in CASES.items():
            times: dict[Path, list[Seconds]] = {each: [] for each in checkouts}
            for run in range(runs + 1):
                for checkout in checkouts:
                    code = 2 if "there is not" in name else 0
                    seconds = measure(pythons[checkout], arguments, checkout, folder, code)
                    if run:  # the first may compile Python
                        times[checkout].append(seconds)
            cells = [
                f"{statistics.median(column):.2f}"
                for checkout in checkouts
                for column in zip(*times[checkout], strict=True)
            ]
            print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]), *sys.argv[2:])
