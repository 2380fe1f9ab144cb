"""What no memory holds is refused, or ends in one line."""

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import torch

GROUP = Path("/sys/fs/cgroup/memory.max")
"""Where Linux says how much a container may take."""
KEPT = 0.05
"""Share of the memory that is left to other programs."""
FAILED = re.compile(
    r"can't allocate memory: you tried to allocate (?P<bytes>\d+) bytes"
    r"|(?:Unable to|[Tt]ried to) allocate (?P<size>[\d.]+ \w?iB)"
    r"|calculation overflowed|multiplication overflow|array is too big|dimension size exceed"
)
"""How libraries say that they did not get memory."""


class TooLarge(ValueError):
    """What no memory holds."""


def memory() -> int:
    """Bytes that there are for this process and all others; 0 if nobody knows."""
    if not hasattr(os, "sysconf"):
        return 0
    found = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with suppress(OSError, ValueError):  # of other systems, or without a limit
        found = min(found, int(GROUP.read_text()))
    return found


def check_memory(size: int, what: str) -> None:
    """Refuses what this machine cannot hold, before it tries.

    Args:
        size: Bytes that it takes at least.
        what: The argument and its value.

    Raises:
        TooLarge: If there is less memory.
    """
    there = memory()
    if there and size > there:
        raise TooLarge(
            f"{what} would take more than {_gib(size)} of memory, and there are {_gib(there)}; "
            "take less"
        )


def missing_memory(error: BaseException) -> str:
    """How much memory an error says is missing, for one line; empty if it is of another kind."""
    found = FAILED.search(str(error))
    if found is None:
        return "there is not enough memory" if isinstance(error, MemoryError) else ""
    asked = _gib(int(found["bytes"])) if found["bytes"] else found["size"]
    if asked is None:
        return "one piece would be larger than any memory"
    return f"one piece more would take {asked} of memory, and there are {_gib(memory())} in all"


@contextmanager
def limited_memory() -> Iterator[None]:
    """Within, what does not fit into the machine's memory is an error.

    Otherwise the system would end this process, or another one, without a word. Drivers of GPUs map
    more than they use, so that nothing is limited where there is one.
    """
    if sys.platform != "linux" or torch.cuda.is_available():
        yield
        return
    import resource

    before = soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    others = [limit for limit in before if limit != resource.RLIM_INFINITY]
    most = min([int(memory() * (1 - KEPT)), *others])
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _gib(size: int) -> str:
    return f"{size / 2**30:,.0f} GiB" if size >= 2**30 else f"{size / 2**20:,.0f} MiB"
