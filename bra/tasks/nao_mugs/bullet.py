"""Clients of the Bullet physics engine: the one place that imports pybullet."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from inspect import isbuiltin
from types import ModuleType
from typing import Any, NoReturn


class BulletClient:
    """pybullet's functions and constants, with the functions bound to one simulation.

    Called without an id, pybullet's functions silently use simulation 0. pybullet ships a client
    of this kind, which prints to stdout whenever one is made.

    Args:
        pybullet: The module.
        mode: `DIRECT`, or `GUI` for a window.
    """

    def __init__(self, pybullet: ModuleType, mode: int) -> None:
        self._pybullet = pybullet
        self._id = pybullet.connect(mode)

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._pybullet, name)
        if isbuiltin(value):
            value = partial(value, physicsClientId=self._id)
        setattr(self, name, value)  # the next use finds it without coming here
        return value

    def close(self) -> None:
        """Ends the simulation; closing again does nothing."""
        if self._id >= 0:
            self._pybullet.disconnect(physicsClientId=self._id)
            self._id = -1
            self.__dict__ = {"_pybullet": self._pybullet, "_id": -1}

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "a Bullet client cannot leave its process; connect inside the process that uses it"
        )


def connect(gui: bool = False) -> BulletClient:
    """A new, empty simulation.

    Args:
        gui: Opens a window, which needs a display, instead of running without one.

    Raises:
        ImportError: If pybullet cannot be imported.
        RuntimeError: If a window is asked for and there is no display.
    """
    # Bullet ends the whole process where it cannot open its window.
    if gui and sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise RuntimeError("no display for the window; leave --gui out, or set DISPLAY")
    try:
        with _quiet_stderr():
            import pybullet
    except ImportError as error:
        raise ImportError(
            f"NaoMugs needs pybullet, which cannot be imported ({error}); "
            "install it with `pip install pybullet`"
        ) from error
    return BulletClient(pybullet, pybullet.GUI if gui else pybullet.DIRECT)


@contextmanager
def _quiet_stderr() -> Iterator[None]:
    """Silences the C library, which announces its build time when it is imported."""
    stderr = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(nowhere)
        os.close(stderr)
