"""Commands run in an empty folder."""

import shutil
import sys

import pytest
from commands import QUICK, TASK

from bra.cli import main


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """A folder in which a small agent was trained."""
    folder = tmp_path_factory.mktemp("finished")
    main(["fit", TASK, "--model.percepts=4", *QUICK, f"--trainer.default_root_dir={folder}"])
    return folder


@pytest.fixture
def checkpoint(finished, in_an_empty_folder):
    """That of such an agent, as if it had been trained here."""
    (logs,) = finished.iterdir()
    path = shutil.copytree(logs, logs.name)
    return f"{path}/version_0/checkpoints/last.ckpt"
