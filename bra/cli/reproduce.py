"""`bra reproduce`: values of the literature beside what comes out here."""

from bra.cli.errors import suggest
from bra.reproductions import PROBLEMS, Problem


def reproduce(name: str = "") -> None:
    """Works a published problem out again and prints both numbers; without a name, lists them.

    Args:
        name: Of the problem.

    Raises:
        ValueError: If there is no such problem.
    """
    if not name:
        for known, problem in PROBLEMS.items():
            print(f"{known:19}{problem.title}")
        return
    if name not in PROBLEMS:
        raise ValueError(f"unknown problem {name}; {suggest(name, PROBLEMS)}")
    print(comparison(PROBLEMS[name]))


def comparison(problem: Problem) -> str:
    """The numbers of a problem as a table."""
    lines = [problem.title, f"source: {problem.source}", ""]
    lines.append(f"{'':44}{'reference':>12}{'here':>12}{'bound':>12}")
    for value in problem.solve():
        cells = (value.reference, value.found, value.bound)
        numbers = "".join(f"{'–' if cell is None else f'{cell:.6g}':>12}" for cell in cells)
        lines.append(f"{value.quantity:44}{numbers}")
    return "\n".join(lines)
