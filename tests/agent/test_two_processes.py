"""Two processes on one machine, for real."""

import socket
import subprocess
import sys
from pathlib import Path

import torch

SCRIPT = Path(__file__).parents[1] / "two_processes.py"


def free_port() -> str:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return str(found.getsockname()[1])


def test_two_processes_equal_one(tmp_path):
    words = [sys.executable, str(SCRIPT), str(tmp_path), free_port()]
    done = subprocess.run(words, stderr=subprocess.PIPE, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    names = ("1_0", "2_0", "2_1")
    alone, first, second = (torch.load(tmp_path / f"{name}.pt") for name in names)
    for kind, state in alone.items():
        for name, tensor in state.items():
            assert torch.equal(tensor, first[kind][name]), (kind, name)
            assert torch.equal(tensor, second[kind][name]), (kind, name)
    line = "bra.agent.trained: updates are made one by one, uncompiled: several devices train"
    told = [(tmp_path / f"{name}.log").read_text().splitlines() for name in names]
    assert [lines.count(line) for lines in told] == [0, len(alone), 0]
