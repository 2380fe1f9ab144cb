"""Heatmaps, read pixel by pixel."""

import numpy as np

from bra.pictures import beside, draw_heatmap

NAMES = ["mouse", "lion"], ["stay", "flee", "sing"]
TABLE = np.array([[0.25, 0.75, 0.0], [1.0, 0.001, 0.0]])


def cells(picture, shape):
    """The pixels of a heatmap's cells, (rows, columns, height, width, 3)."""
    pixels = np.asarray(picture)
    black = (pixels == 0).all(2)
    top, bottom = np.sort(black.sum(1).argsort()[-2:])  # the longest lines: the frame
    left, right = np.sort(black.sum(0).argsort()[-2:])
    table = pixels[top + 1 : bottom, left + 1 : right]
    rows, columns = shape
    down, across = table.shape[0] // rows, table.shape[1] // columns
    return table.reshape(rows, down, columns, across, 3).swapaxes(1, 2)


def written(shown):
    """Which cells have more than their colour."""
    return (shown != shown[:, :, 2:3, 2:3]).any((2, 3, 4)).tolist()


def test_cells_have_the_colours_of_their_values_and_say_them():
    shown = cells(draw_heatmap(TABLE, *NAMES, "p(a|ω)"), TABLE.shape)
    corners = shown[:, :, 2, 2]
    assert corners[1, 0].tolist() == [8, 48, 107]  # 1 is dark blue
    assert corners[0, 2].tolist() == [247, 251, 255]  # 0 is white
    assert corners[0, 0].sum() > corners[0, 1].sum() > corners[1, 0].sum()
    assert written(shown) == [[True, True, False], [True, False, False]]


def test_cells_say_what_they_are_told():
    texts = np.array([["", "", "a long text"], ["", "0/7", ""]])
    shown = cells(draw_heatmap(TABLE, *NAMES, "", texts), TABLE.shape)
    assert written(shown) == [[False, False, True], [False, True, False]]
    assert shown.shape[3] > 60


def test_what_stands_for_nothing_is_grey():
    void = np.array([[False, False, False], [True, True, True]])
    picture = draw_heatmap(TABLE, *NAMES, "p(a|x)", void=void)
    shown = cells(picture, TABLE.shape)
    assert (shown[1] == (238, 238, 238)).all()
    assert written(shown) == [[True, True, False], [False, False, False]]
    colours = {colour for _, colour in picture.getcolors(10**6)}
    assert (168, 168, 168) in colours  # the name
    assert (168, 168, 168) not in {c for _, c in draw_heatmap(TABLE, *NAMES, "").getcolors(10**6)}


def test_two_pictures_are_side_by_side_unless_that_is_too_broad():
    small, large = (draw_heatmap(TABLE, *NAMES, title) for title in ("", "a title " * 10))
    assert beside(small, small).size == (2 * small.width, small.height)
    assert beside(small, large).size == (large.width, small.height + large.height)


def test_there_is_room_for_names():
    picture = draw_heatmap(TABLE, *NAMES, "p(a|ω)")
    assert draw_heatmap(TABLE, ["mouse", "crocodile"], NAMES[1], "p(a|ω)").width > picture.width
    assert draw_heatmap(TABLE, NAMES[0], ["a song", "b", "c"], "p(a|ω)").height > picture.height
    assert draw_heatmap(TABLE, NAMES[0], ["a\nb", "b", "c"], "p(a|ω)").height > picture.height
    assert draw_heatmap(TABLE, *NAMES, "a title that is longer than all").width > picture.width


def test_letters_are_there():
    boxes = [draw_heatmap(TABLE, *NAMES, letter) for letter in "ωΩξβπµäéł–≥\U0010ffff"]
    assert len({picture.tobytes() for picture in boxes}) == len(boxes)
