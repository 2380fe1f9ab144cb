"""Tables of utilities in CSV files."""

import csv
import io
import math
import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from bra.checks.words import amount

PRIOR = "prior"
"""Heading of a column of p(ω)."""
CORNERS = ("", "state", "states", "name", "names", "index", "id", "unnamed: 0")
"""Headings of a first column that names the states, be it by numbers."""
SUSPECTS = re.compile(
    r"index|unnamed: \d+|priors?|prob(abilit(y|ies))?|p\(.*\)"
    r"|(grand |sub)?totals?|sums?|means?|averages?",
    re.IGNORECASE,
)
"""Names of what people put beside states and actions."""
SEPARATORS = (",", ";", "\t")
NUMBER = re.compile(
    r"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|inf|infinity|nan)", re.ASCII | re.IGNORECASE
)
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+", re.ASCII)

Row = tuple[int, list[str]]
"""The line on which it ends, and its cells."""


@dataclass(frozen=True)
class CsvTable:
    """What a file says.

    Attributes:
        utilities: U(ω, a), (W, A).
        prior: p(ω), (W,), if the file has a column of that name.
        state_names: W names.
        action_names: A names.
    """

    utilities: list[list[float]]
    prior: list[float] | None
    state_names: list[str]
    action_names: list[str]


def read_utilities(path: str) -> CsvTable:
    """Reads a CSV file of utilities.

    Cells are separated by commas, semicolons or tabs. Numbers have decimal points; or decimal
    commas, where these can be nothing else.

    Raises:
        ValueError: With file, line and column, if the file is missing, empty, ragged or not
            numeric, or if names of states or actions are missing, twice there, or those of
            something else, such as a total.
    """
    text = _read(path)
    try:
        header, *rows = _rows(text, _separator(text))
        _check_shape(header, rows)
        line, (_, *columns) = header
        places = {f", line {line}, column {n + 2}": n for n in range(len(columns))}
        priors = [where for where, n in places.items() if columns[n].casefold() == PRIOR]
        of_prior = [places.pop(where) for where in priors[:1]]
        states = {f", line {n}, column 1": cells[0] for n, cells in rows}
        actions = {where: columns[n] for where, n in places.items()}
        check_names("a state", states)
        check_names("an action", actions)
        values = _numbers(rows, columns)
    except ValueError as error:
        raise ValueError(f"{_name(path)}{error}") from error
    prior = [row.pop(of_prior[0]) for row in values] if of_prior else None
    return CsvTable(values, prior, list(states.values()), list(actions.values()))


def _read(path: str) -> str:
    cannot = f"cannot read utilities from {_name(path)}"
    if os.path.exists(path) and not os.path.isfile(path):
        raise ValueError(f"{cannot}: it is a folder, device or pipe")
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            return file.read()
    except (OSError, UnicodeDecodeError) as error:
        no_text = "it is not UTF-8 text; save it as CSV in UTF-8"
        reason = error.strerror if isinstance(error, OSError) else no_text
        raise ValueError(f"{cannot}: {reason}") from error


def _name(path: str) -> str:
    """A path in one line, whatever it is made of."""
    return " ".join(path.split())


def _rows(text: str, separator: str) -> list[Row]:
    """Rows that are not blank.

    Raises:
        ValueError: If there are none, or quotation marks are not closed.
    """
    lines = csv.reader(
        io.StringIO(text, newline=""), delimiter=separator, skipinitialspace=True, strict=True
    )
    found = []
    try:
        for row in lines:
            cells = [cell.strip() for cell in row]
            if any(cells):
                found.append((lines.line_num, cells))
    except csv.Error as error:
        raise ValueError(
            f", line {lines.line_num}: {error}; is a quotation mark left open?"
        ) from error
    if not found:
        raise ValueError(" is empty; expected a header row of action names")
    return found


def _separator(text: str) -> str:
    """What separates the cells: of what the first row has of it, that which makes a table.

    Raises:
        ValueError: If two of them make one.
    """
    head = re.split("[\r\n]", text.lstrip("\r\n "), maxsplit=1)[0]
    marks = [mark for mark in SEPARATORS if mark in head]
    if len(marks) < 2:
        return marks[0] if marks else ","
    fitting = [mark for mark in marks if _is_table(text, mark)]
    if len(fitting) > 1:
        raise ValueError(
            f", line 1: cells may be separated by {fitting[0]!r} or by {fitting[1]!r}; "
            "put numbers and names that hold one of them in quotation marks"
        )
    return fitting[0] if fitting else marks[0]


def _is_table(text: str, separator: str) -> bool:
    try:
        header, *rows = _rows(text, separator)
    except ValueError:
        return False
    return all(
        len(cells) == len(header[1]) and all(map(_is_number, cells[1:])) for _, cells in rows
    )


def _is_number(cell: str) -> bool:
    return bool(NUMBER.fullmatch(cell) or DECIMAL_COMMA.fullmatch(cell))


def _check_shape(header: Row, rows: Sequence[Row]) -> None:
    """Makes sure that there is a row of names, a column of names, and as many cells in each row."""
    line, (corner, *columns) = header
    actions = sum(name.casefold() != PRIOR for name in columns)
    if not actions or not rows:
        raise ValueError(
            f", line {line}: expected a header row of action names and a row per state, cells "
            f"separated by commas, semicolons or tabs, got {amount(actions, 'action')} and "
            f"{amount(len(rows), 'state')}"
        )
    for below, cells in rows:
        if len(cells) != len(header[1]):
            raise ValueError(
                f", line {below}: {amount(len(cells) - 1, 'value')} for "
                f"{amount(len(columns), 'column')} of the header"
            )
    if corner.casefold() in CORNERS:
        return
    if all(map(_is_number, columns)):
        raise ValueError(f", line {line}: expected a header row of action names, got {header[1]}")
    if all(_is_number(cells[0]) for _, cells in rows):
        raise ValueError(
            f", line {rows[0][0]}, column 1: expected the name of a state, got {rows[0][1][0]}; "
            "the first column names the states: add one, or head it `state` if it does"
        )


def check_names(kind: str, names: dict[str, str]) -> None:
    """Makes sure that there are names, all of them different, and of nothing else.

    Args:
        kind: `a state` or `an action`.
        names: The names, by where they stand.

    Raises:
        ValueError: If they are not.
    """
    counts = Counter(names.values())
    for where, name in names.items():
        if not name.strip():
            raise ValueError(f"{where}: expected the name of {kind}, got a blank")
        if SUSPECTS.fullmatch(name):
            raise ValueError(
                f"{where}: {name!r} is hardly {kind}; leave it out, or rename it if it is; "
                "give probabilities of states as `prior`"
            )
        if counts[name] > 1:
            raise ValueError(f"{where}: {name!r} is there {counts[name]} times; rename it")


def check_labels(states: Sequence[str] | None, actions: Sequence[str] | None) -> None:
    """The same for labels of a table of pandas, where it has some.

    Raises:
        ValueError: See `check_names`.
    """
    for kind, labels in (("a state", states), ("an action", actions)):
        check_names(kind, {f"utilities, label {n}": name for n, name in enumerate(labels or ())})


def _numbers(rows: Sequence[Row], columns: Sequence[str]) -> list[list[float]]:
    """Cells as numbers."""
    cells = [cell for _, row in rows for cell in row[1:]]
    commas = [cell for cell in cells if DECIMAL_COMMA.fullmatch(cell)]
    points = any("." in cell for cell in cells)
    decimal = bool(commas) and not points and not all(map(THOUSANDS.fullmatch, commas))
    return [
        [
            _number(
                cell.replace(",", ".") if decimal else cell, f", line {line}, column {n} ({name})"
            )
            for n, (cell, name) in enumerate(zip(row[1:], columns, strict=True), 2)
        ]
        for line, row in rows
    ]


def _number(cell: str, where: str) -> float:
    if not NUMBER.fullmatch(cell):
        raise ValueError(f"{where}: expected a number such as 1000.5, got {cell!r}")
    value = float(cell)
    if math.isnan(value) or value == math.inf:
        raise ValueError(
            f"{where}: utilities must be finite, or -inf for a forbidden action, got {cell!r}"
        )
    return value
