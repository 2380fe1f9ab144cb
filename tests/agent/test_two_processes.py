"""Two processes on one machine, for real."""

import os
import socket

import torch
from two_processes import start_two, train_all

from bra.processes.endings import PARENT


def free_port() -> str:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return str(found.getsockname()[1])


def test_two_processes_equal_one(tmp_path, monkeypatch):
    monkeypatch.setenv(PARENT, str(os.getpid()))
    two = start_two(tmp_path, free_port())
    try:
        train_all(tmp_path)
        for process in two:
            process.join(120)
        assert [process.exitcode for process in two] == [0, 0]
    finally:
        for process in two:
            process.kill()
    names = ("1_0", "2_0", "2_1")
    alone, first, second = (torch.load(tmp_path / f"{name}.pt") for name in names)
    for kind, state in alone.items():
        for name, tensor in state.items():
            assert torch.equal(tensor, first[kind][name]), (kind, name)
            assert torch.equal(tensor, second[kind][name]), (kind, name)
    line = "updates are made one by one, uncompiled: several devices train"
    told = [(tmp_path / f"{name}.log").read_text().splitlines() for name in names]
    assert [lines.count(line) for lines in told] == [0, len(alone), 0]
