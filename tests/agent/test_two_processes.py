"""Two processes on one machine, for real."""

import os
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


def run_together(*commands, timeout=120) -> list[str]:
    """What commands say that run side by side, each with variables of its own; leaves none."""
    runs = [
        subprocess.Popen(words, env=os.environ | own, stderr=subprocess.PIPE, text=True)
        for words, own in commands
    ]
    try:
        said = [run.communicate(timeout=timeout)[1] for run in runs]
        assert not any(run.returncode for run in runs), said
        return said
    finally:
        for run in runs:
            run.kill()


def test_two_processes_equal_one(tmp_path):
    words = [sys.executable, str(SCRIPT), str(tmp_path)]
    ranks = ({"LOCAL_RANK": str(rank), "NODE_RANK": "0"} for rank in range(2))
    port = free_port()
    said = run_together((words, {}), *(([*words, port], rank) for rank in ranks))
    alone, first, second = (torch.load(tmp_path / f"{name}.pt") for name in ("1_0", "2_0", "2_1"))
    for kind, state in alone.items():
        for name, tensor in state.items():
            assert torch.equal(tensor, first[kind][name]), (kind, name)
            assert torch.equal(tensor, second[kind][name]), (kind, name)
    line = "bra.agent.trained: updates are made one by one, uncompiled: several devices train"
    assert [text.splitlines().count(line) for text in said] == [0, len(alone), 0]
