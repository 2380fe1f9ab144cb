"""Scripts that start workers."""

import subprocess
import sys
from types import ModuleType

import pytest

from bra.tasks import PredatorPrey, RolloutDataModule

SCRIPT = """
from bra.processes.workers import worker_context
worker_context("bra.tasks")
print("made")
"""
GUARD = "if __name__ == '__main__': pass\n"


def test_a_script_without_guard_is_told_at_once(tmp_path):
    path = tmp_path / "script.py"
    for guard, code in (("", 1), (GUARD, 0)):
        path.write_text(SCRIPT + guard)
        done = subprocess.run(
            [sys.executable, str(path)], capture_output=True, text=True, timeout=120
        )
        assert done.returncode == code, done.stderr
        assert done.stdout == ("made\n" if guard else "")
        told = f"processes that import {path} and would train" in done.stderr
        assert told == (guard == "")


def test_workers_ask_for_the_guard(tmp_path, monkeypatch):
    script = ModuleType("__main__")
    script.__file__ = str(tmp_path / "script.py")
    monkeypatch.setitem(sys.modules, "__main__", script)
    data = RolloutDataModule(PredatorPrey(), workers=2)
    (tmp_path / "script.py").write_text("")
    with pytest.raises(ValueError, match=r"processes that import .*script\.py and would train"):
        data.train_dataloader()
    (tmp_path / "script.py").write_text(GUARD)
    assert data.train_dataloader().num_workers == 2
