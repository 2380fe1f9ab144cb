"""Tables of probabilities as pictures, by Pillow: many times as fast as by matplotlib."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw

from bra.pictures.letters import font, legible

CELL = (36, 31)
"""Least pixels of a cell, across and down. TensorBoard shows pictures some 320 pixels wide."""
MARGIN, GAP = 12, 6
BROAD = 480
"""Pixels beyond which letters are too small to be read once TensorBoard has shrunk a picture."""
LETTERS, DIGITS, LINE = 13, 12, 16
"""Pixels of names, of values, and from line to line."""
BLUES = "f7fbff deebf7 c6dbef 9ecae1 6baed6 4292c6 2171b5 08519c 08306b"
"""From 0 to 1, by ColorBrewer."""
GREY = "#a8a8a8", "#eeeeee"
"""Of names and of cells that stand for nothing."""


def draw_heatmap(
    table: NDArray[np.float64],
    rows: Sequence[str],
    columns: Sequence[str],
    title: str,
    texts: NDArray[np.str_] | None = None,
    void: NDArray[np.bool_] | None = None,
) -> Image.Image:
    """A table of shares with names at its edges and values in its cells; white is 0, dark blue 1.

    Args:
        table: (rows, columns), values in [0, 1].
        rows: Names of the rows, of a line or more.
        columns: Names of the columns; those of one line are written upright if they are long.
        title: Stands above.
        texts: What the cells say; None is the values, from 0.005 on.
        void: Cells that stand for nothing, (rows, columns): they are grey, and so are the names of
            rows and columns that have no others.
    """
    texts = _values(table) if texts is None else texts
    void = np.zeros(table.shape, bool) if void is None else void
    grey_rows, grey_columns = ([line.all() for line in lines] for lines in (void, void.T))
    names = [_write(name, "right", grey) for name, grey in zip(rows, grey_rows, strict=True)]
    feet = [_write(name, "center", grey) for name, grey in zip(columns, grey_columns, strict=True)]
    if max(foot.width for foot in feet) > CELL[0] and "\n" not in "".join(columns):
        feet = [foot.rotate(90, expand=True) for foot in feet]  # long names stand upright
    broadest = max(*(foot.width for foot in feet), *map(font(DIGITS).getlength, texts.flat))
    step = (
        max(CELL[0], round(broadest) + GAP),
        max(CELL[1], max(name.height for name in names) + GAP),
    )
    cells = _draw_cells(table, np.where(void, "", texts), void, step)
    heading = _write(title, "center")
    left = MARGIN + max(name.width for name in names) + GAP
    top = MARGIN + heading.height + GAP
    width = max(left + cells.width, MARGIN + heading.width) + MARGIN
    height = top + cells.height + GAP + max(foot.height for foot in feet) + MARGIN
    picture = Image.new("RGB", (width, height), "white")
    picture.paste(heading, ((width - heading.width) // 2, MARGIN))
    for number, name in enumerate(names):
        middle = top + number * step[1] + (step[1] - name.height) // 2
        picture.paste(name, (left - GAP - name.width, middle))
    for number, foot in enumerate(feet):
        middle = left + number * step[0] + (step[0] - foot.width) // 2
        picture.paste(foot, (middle, top + cells.height + GAP))
    frame = (left - 1, top - 1, left + cells.width, top + cells.height)
    ImageDraw.Draw(picture).rectangle(frame, outline="black")
    picture.paste(cells, (left, top))
    return picture


def beside(left: Image.Image, right: Image.Image) -> Image.Image:
    """Two pictures as one: side by side if that is no broader than `BROAD`, else one below."""
    if left.width + right.width <= BROAD:
        size, place = (left.width + right.width, max(left.height, right.height)), (left.width, 0)
    else:
        size, place = (max(left.width, right.width), left.height + right.height), (0, left.height)
    picture = Image.new("RGB", size, "white")
    picture.paste(left, (0, 0))
    picture.paste(right, place)
    return picture


def _values(table: NDArray[np.float64]) -> NDArray[np.str_]:
    written = [f"{value:.2f}".removeprefix("0") if value >= 0.005 else "" for value in table.flat]
    return np.array(written).reshape(table.shape)


def _draw_cells(
    table: NDArray[np.float64],
    texts: NDArray[np.str_],
    void: NDArray[np.bool_],
    step: tuple[int, int],
) -> Image.Image:
    """The table alone: its colours, and what its cells say."""
    across, down = step
    colours = np.frombuffer(bytes.fromhex(BLUES), np.uint8).reshape(-1, 3)
    places = np.linspace(0, 1, len(colours))
    levels = [np.interp(table, places, colour) for colour in colours.T]
    pixels = np.stack(levels, -1).round().astype(np.uint8)
    pixels[void] = ImageColor.getrgb(GREY[1])
    cells = Image.fromarray(pixels)
    size = across * cells.width, down * cells.height
    cells = cells.resize(size, Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(cells)
    for (row, column), text in np.ndenumerate(texts):
        middle = (column + 0.5) * across, (row + 0.5) * down
        colour = "white" if table[row, column] > 0.6 else "black"
        draw.text(middle, str(text), colour, font(DIGITS), anchor="mm")
    return cells


def _write(text: str, align: str, grey: bool | np.bool_ = False) -> Image.Image:
    """Lines of text on white."""
    lines = [legible(line, LETTERS) for line in text.split("\n")]
    widths = [round(own.getlength(line)) + 1 for line, own in lines]
    picture = Image.new("RGB", (max(widths), LINE * len(lines)), "white")
    draw, colour = ImageDraw.Draw(picture), GREY[0] if grey else "black"
    for number, ((line, own), width) in enumerate(zip(lines, widths, strict=True)):
        start = (max(widths) - width) / (2 if align == "center" else 1)
        draw.text((start, (number + 0.5) * LINE), line, colour, own, anchor="lm")
    return picture
