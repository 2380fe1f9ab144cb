"""How long the paper's protocol takes as a whole command, the first time and later.

    python benchmarks/online.py [--repeats 3]

Runs `bra fit --config configs/predator_prey_online.yaml`, 100 000 updates of one encounter each, in
fresh processes of one thread. *Cold* starts with empty caches, of ours and of torch's, and so
compiles; *warm* finds the code. Prints seconds by the clock, and what compiling takes.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from startup import COMMAND, HERE, processor

FIT = ("fit", f"--config={HERE / 'configs/predator_prey_online.yaml'}")


def run(folder: Path, caches: Path) -> float:
    """Seconds of the whole command, whose compiled code is kept in `caches`."""
    own = {"XDG_CACHE_HOME": str(caches), "TMPDIR": str(caches), "OMP_NUM_THREADS": "1"}
    quiet = ("--trainer.enable_progress_bar=false", f"--trainer.default_root_dir={folder}")
    start = time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", COMMAND, *FIT, *quiet],
        env={**os.environ, **own, "TORCHINDUCTOR_CACHE_DIR": str(caches / "inductor")},
        check=True,
        capture_output=True,
    )
    return time.perf_counter() - start


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--repeats", type=int, default=3)
    repeats = parser.parse_args().repeats
    cold, warm = [], []
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as name:
            caches = Path(name) / "caches"
            caches.mkdir()
            cold.append(run(Path(name), caches))
            warm.append(run(Path(name), caches))
    first, later = statistics.median(cold), statistics.median(warm)
    print(f"{processor()}, one thread, medians of {repeats}\n")
    print(f"cold {first:.1f} s, warm {later:.1f} s; compiling takes {first - later:.1f} s")


if __name__ == "__main__":
    main()
