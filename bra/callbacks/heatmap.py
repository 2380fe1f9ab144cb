"""Tables of probabilities as pictures, by Pillow: twenty times as fast as by matplotlib."""

import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

CELL = (36, 31)
"""Pixels of a cell, across and down. TensorBoard shows pictures some 320 pixels wide."""
MARGIN = 12
LETTERS, DIGITS = 13, 12
"""Pixels of names and of values."""
BLUES = "f7fbff deebf7 c6dbef 9ecae1 6baed6 4292c6 2171b5 08519c 08306b"
"""From 0 to 1, by ColorBrewer."""


def draw_heatmap(
    table: Tensor, rows: Sequence[str], columns: Sequence[str], title: str
) -> Image.Image:
    """A table of probabilities with names at its edges and values in its cells.

    White is 0 and dark blue 1; values below 0.005 are not written.

    Args:
        table: (rows, columns), values in [0, 1].
        rows: Names of the rows.
        columns: Names of the columns.
        title: Stands above.
    """
    letters = font(LETTERS)
    size = CELL[0] * len(columns), CELL[1] * len(rows)
    left = MARGIN + round(max(map(letters.getlength, rows))) + 6
    longest = max(map(letters.getlength, columns))
    upright = longest > CELL[0] - 4
    heading = ImageDraw.Draw(Image.new("L", (1, 1))).multiline_textbbox((0, 0), title, letters)
    top = MARGIN + round(heading[3]) + 8
    width = max(left + size[0], MARGIN + round(heading[2])) + MARGIN
    bottom = round(longest if upright else LETTERS) + MARGIN + 6
    picture = Image.new("RGB", (width, top + size[1] + bottom), "white")
    picture.paste(_cells(table.cpu().numpy()), (left, top))
    draw = ImageDraw.Draw(picture)
    draw.rectangle((left - 1, top - 1, left + size[0], top + size[1]), outline="black")
    draw.multiline_text((width / 2, MARGIN), title, "black", letters, anchor="ma", align="center")
    for number, name in enumerate(rows):
        middle = top + (number + 0.5) * CELL[1]
        draw.text((left - 6, middle), name, "black", letters, anchor="rm")
    for number, name in enumerate(columns):
        middle = left + (number + 0.5) * CELL[0]
        if upright:
            _write_upright(picture, (round(middle), top + size[1] + 6), name)
        else:
            draw.text((middle, top + size[1] + 6), name, "black", letters, anchor="ma")
    return picture


@functools.cache
def font(size: int) -> ImageFont.FreeTypeFont:
    """Letters, Greek ones too: Pillow's own font has none, matplotlib brings one."""
    import matplotlib

    return ImageFont.truetype(Path(matplotlib.get_data_path(), "fonts/ttf/DejaVuSans.ttf"), size)


def _cells(values: NDArray[np.float64]) -> Image.Image:
    """The table alone: its colours, and what is worth writing."""
    colours = np.frombuffer(bytes.fromhex(BLUES), np.uint8).reshape(-1, 3)
    places = np.linspace(0, 1, len(colours))
    levels = [np.interp(values, places, colour) for colour in colours.T]
    cells = Image.fromarray(np.stack(levels, -1).round().astype(np.uint8))
    cells = cells.resize((CELL[0] * cells.width, CELL[1] * cells.height), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(cells)
    for (row, column), value in np.ndenumerate(values):
        if value >= 0.005:
            middle = (column + 0.5) * CELL[0], (row + 0.5) * CELL[1]
            text = f"{value:.2f}".removeprefix("0")
            colour = "white" if value > 0.6 else "black"
            draw.text(middle, text, colour, font(DIGITS), anchor="mm")
    return cells


def _write_upright(picture: Image.Image, top: tuple[int, int], text: str) -> None:
    """Writes from below to the point `top`."""
    letters = font(LETTERS)
    line = Image.new("RGB", (round(letters.getlength(text)) + 1, LETTERS + 4), "white")
    ImageDraw.Draw(line).text((0, line.height / 2), text, "black", letters, anchor="lm")
    picture.paste(line.rotate(90, expand=True), (top[0] - line.height // 2, top[1]))
