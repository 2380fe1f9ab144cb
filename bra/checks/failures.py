"""Errors that somebody's own class raises: whose they are, and when."""

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType

HOUSE = sys.stdlib_module_names | {
    *("bra", "torch", "lightning", "lightning_utilities", "torchmetrics", "jsonargparse"),
    *("numpy", "gymnasium", "tensorboard", "matplotlib", "PIL", "pybullet", "tqdm", "yaml"),
    *("fsspec", "packaging"),
}
"""Packages that are nobody's own: what `bra` is made of."""
RAISED = "raised by "
"""How the note begins."""


@contextmanager
def named(when: str) -> Iterator[None]:
    """Within, an error of somebody's own class gets a note of class, method and time.

    Args:
        when: Such as "in update 7".
    """
    try:
        yield
    except Exception as error:
        add_note(error, when)
        raise


def add_note(error: BaseException, when: str) -> None:
    """Notes who raised an error, unless that is noted already, or it is nobody's own."""
    found = own_traceback(error)
    if found is not None and not find_note(error):
        error.add_note(f"{RAISED}{_name(found.tb_frame)} {when}")


def find_note(error: BaseException) -> str:
    """The note of an error; empty if there is none."""
    lines = [*getattr(error, "__notes__", ()), *_sent(error)[-1:]]
    return next((line for line in lines if line.startswith(RAISED)), "")


def own_text(error: BaseException) -> str:
    """The traceback of code of one's own; of a worker process, all that it has sent."""
    if _sent(error):
        return str(error)
    return "".join(traceback.format_tb(own_traceback(error)))


def own_line(error: BaseException) -> str:
    """Kind and words of an error, and its note."""
    *_, said, note = _sent(error) or [f"{type(error).__name__}: {error}", find_note(error)]
    return f"{said}; {note}"


def _sent(error: BaseException) -> list[str]:
    """What a worker process has sent of an error and its note, in lines; empty if none has."""
    lines = str(error).strip().splitlines()
    return lines if len(lines) > 1 and lines[-1].startswith(RAISED) else []


def house_line(error: BaseException) -> str:
    """Kind and words of an error of a library, and which of its methods raised it.

    Empty if it is `bra` itself that did.
    """
    *_, (frame, _) = traceback.walk_tb(error.__traceback__)
    if _package(frame) == "bra":
        return ""
    return f"{type(error).__name__}: {error}; {RAISED}{_name(frame)}"


def own_traceback(error: BaseException | None) -> TracebackType | None:
    """The part of an error's traceback, or of its cause's, that lies in code of one's own."""
    seen: set[int] = set()  # what is raised again by another thread may be its own context
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        found = error.__traceback__
        while found is not None and _of_house(found.tb_frame):
            found = found.tb_next
        if found is not None:
            return found
        error = error.__cause__ or error.__context__
    return None


def _of_house(frame: FrameType) -> bool:
    return _package(frame) in HOUSE


def _package(frame: FrameType) -> str:
    return str(frame.f_globals.get("__name__", "")).partition(".")[0]


def _name(frame: FrameType) -> str:
    """Class and method; of other functions what they are called."""
    if "self" in frame.f_locals:
        return f"{type(frame.f_locals['self']).__name__}.{frame.f_code.co_name}"
    return frame.f_code.co_qualname
