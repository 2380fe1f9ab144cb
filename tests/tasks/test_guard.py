"""Scripts that start workers."""

import subprocess
import sys

SCRIPT = """
from bra.tasks import PredatorPrey, RolloutDataModule
RolloutDataModule(PredatorPrey(), workers=2).train_dataloader()
print("made")
"""


def test_a_script_without_guard_is_told_at_once(tmp_path):
    path = tmp_path / "script.py"
    for guard, code in (("", 1), ("if __name__ == '__main__': pass\n", 0)):
        path.write_text(SCRIPT + guard)
        done = subprocess.run(
            [sys.executable, str(path)], capture_output=True, text=True, timeout=120
        )
        assert done.returncode == code, done.stderr
        told = f"processes that import {path} and would train" in done.stderr
        assert told == (guard == "")
