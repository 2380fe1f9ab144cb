"""Clients of the Bullet physics engine: the one place that imports pybullet."""

import ctypes
import os
import sys
import weakref
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
        self._end = weakref.finalize(self, pybullet.disconnect, physicsClientId=self._id)
        self._end.atexit = False  # Bullet ends by itself with the process

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._pybullet, name)
        if isbuiltin(value):
            value = partial(value, physicsClientId=self._id)
        setattr(self, name, value)  # the next use finds it without coming here
        return value

    def close(self) -> None:
        """Ends the simulation; closing again does nothing."""
        self._end()
        self.__dict__ = {"_pybullet": self._pybullet, "_id": -1, "_end": self._end}

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
    # Bullet ends the whole process, or hangs, where it cannot open its window.
    if gui and not _has_display():
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


def _has_display() -> bool:
    """Whether an X server answers; elsewhere than on Linux it is left to Bullet."""
    if sys.platform != "linux":
        return True
    if not os.environ.get("DISPLAY"):
        return False
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError:
        return True
    x11.XOpenDisplay.restype = ctypes.c_void_p
    x11.XCloseDisplay.argtypes = [ctypes.c_void_p]
    display = x11.XOpenDisplay(None)
    if display:
        x11.XCloseDisplay(display)
    return bool(display)


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
