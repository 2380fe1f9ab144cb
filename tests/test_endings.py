"""How processes ended, as far as it is known."""

import pytest

from bra.processes.workers import said_of


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (0, "ended with exit code 0"),
        (3, "ended with exit code 3"),
        (-11, "was killed by signal 11 (SIGSEGV)"),
        (-15, "was killed by signal 15 (SIGTERM)"),
        (-63, "was killed by signal 63 (of no name)"),
        (255, "ended, or the one that starts them did, and nobody knows why"),
    ],
)
def test_how_processes_ended(code, said):
    assert said_of(code) == said


def test_memory_is_one_reason_to_be_killed():
    said = said_of(-9)
    assert said.startswith("was killed by signal 9 (SIGKILL); the system does so if memory runs")
