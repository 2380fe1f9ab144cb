"""What no memory holds."""

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from bra.checks import memory
from bra.checks.memory import limited_memory, missing_memory


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (
            lambda: torch.empty(2**50),
            "one piece more would take 4,194,304 GiB of memory, and there",
        ),
        (lambda: np.empty(2**50), "one piece more would take 8.00 PiB of memory, and there are"),
        (lambda: torch.empty(2**40, 2**40), "one piece would be larger than any memory"),
        (lambda: bytearray(2**60), "there is not enough memory"),
        (lambda: torch.empty(-1), ""),
    ],
)
def test_what_libraries_say(ask, said):
    with pytest.raises((MemoryError, RuntimeError)) as error:
        ask()
    line = missing_memory(error.value)
    assert line.startswith(said) and bool(line) == bool(said)


@pytest.mark.skipif(sys.platform != "linux", reason="asks the system for a limit")
def test_what_does_not_fit_is_an_error(monkeypatch):
    def ask():
        return torch.empty(2**28)

    (taken,) = (
        int(line.split()[1]) * 1024
        for line in Path("/proc/self/status").read_text().splitlines()
        if line.startswith("VmData")
    )
    monkeypatch.setattr(memory, "memory", lambda: int((taken + 2**28) / (1 - memory.KEPT)))
    with limited_memory(), pytest.raises(RuntimeError) as error:
        ask()
    assert missing_memory(error.value).startswith("one piece more would take 1 GiB of memory")
    assert len(ask()) == 2**28


def test_containers_have_less(monkeypatch, tmp_path):
    monkeypatch.setattr(memory, "GROUP", tmp_path / "max")
    whole = memory.memory()
    (tmp_path / "max").write_text("max\n")
    assert memory.memory() == whole
    (tmp_path / "max").write_text("1048576\n")
    assert memory.memory() == 2**20
    with pytest.raises(
        memory.TooLarge, match="would take more than 2 MiB of memory, and there are 1"
    ):
        memory.check_memory(2**21, "this")
