"""Optima of the literature."""

import pytest

from bra.cli import main
from bra.reproductions import EXPERIMENTS, PROBLEMS


@pytest.mark.parametrize("name", PROBLEMS)
def test_what_comes_out_is_what_was_published(name):
    values = PROBLEMS[name].solve()
    known = [value for value in values if value.reference is not None]
    for value in known:
        digits = len(f"{value.reference:.7g}".partition(".")[2])
        assert value.found == pytest.approx(value.reference, abs=0.51 * 10**-digits), value
    for value in values:
        assert value.bound is None or value.bound >= value.found - 1e-12
    assert len(known) == len(values) or "figures" in PROBLEMS[name].source or name.startswith("pol")


def test_the_command_lists_and_compares(capsys):
    main(["reproduce"])
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert listed == [*PROBLEMS, *EXPERIMENTS]
    main(["reproduce", "pricing"])
    out = capsys.readouterr().out
    assert "Review of Economic Studies" in out
    (line,) = (line for line in out.splitlines() if line.startswith("J "))
    assert line.split() == ["J", "0.0920102", "0.0920102", "0.0920102"]


def test_an_unknown_problem_is_one_line(capsys):
    with pytest.raises(SystemExit) as exit_:
        main(["reproduce", "pricinf"])
    assert exit_.value.code == 2
    assert "unknown problem pricinf; did you mean pricing?" in capsys.readouterr().err
