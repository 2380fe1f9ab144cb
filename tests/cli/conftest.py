"""Commands run in an empty folder."""

import functools
import sys

import pytest
from jsonargparse import class_from_function


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])


@pytest.fixture(scope="session", autouse=True)
def one_class_of_models():
    """Each parser makes it anew, and reads the sources of all that calls it, pytest included."""
    with pytest.MonkeyPatch.context() as patch:
        kept = functools.cache(class_from_function)
        patch.setattr("lightning.pytorch.cli.class_from_function", kept)
        yield
