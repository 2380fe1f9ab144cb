"""Tables of utilities in CSV files."""

import csv
import math
import os


def read_utilities(path: str) -> tuple[list[list[float]], list[str], list[str]]:
    """Reads a CSV file of utilities: values (W, A), state names, action names.

    Raises:
        ValueError: With file and line, if the file is missing, empty, ragged or not numeric.
    """
    if os.path.exists(path) and not os.path.isfile(path):
        raise ValueError(f"cannot read utilities from {path}: it is a folder, device or pipe")
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            lines = csv.reader(file, skipinitialspace=True)
            rows = [(lines.line_num, row) for row in lines if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise ValueError(f"cannot read utilities from {path}: {reason}") from error
    if not rows:
        raise ValueError(f"{path} is empty; expected a header row of action names")
    header_line, header = rows[0]
    if len(header) < 2 or len(rows) < 2:
        raise ValueError(
            f"{path}, line {header_line}: expected a header row of action names and a row per "
            f"state, separated by commas, got {len(header) - 1} actions and {len(rows) - 1} states"
        )
    if all(_is_number(name) for name in header[1:]):
        raise ValueError(
            f"{path}, line {header_line}: expected a header row of action names, got {header}"
        )
    values, names = [], []
    for line, (name, *cells) in rows[1:]:
        if len(cells) != len(header) - 1:
            raise ValueError(
                f"{path}, line {line}: {len(cells)} values for {len(header) - 1} actions"
            )
        try:
            values.append([float(cell) for cell in cells])
        except ValueError as error:
            raise ValueError(f"{path}, line {line}: {error}; expected numbers") from error
        if any(math.isnan(value) or value == math.inf for value in values[-1]):
            raise ValueError(
                f"{path}, line {line}: utilities must be finite, or -inf for a forbidden action, "
                f"got {cells}"
            )
        names.append(name.strip())
    return values, names, [name.strip() for name in header[1:]]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
