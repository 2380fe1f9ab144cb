"""Names of any letters can be seen."""

import numpy as np
import pytest
from PIL import ImageFont

from bra.pictures import draw_heatmap, letters


@pytest.fixture(autouse=True)
def forget():
    """What was found out with the fonts of a test."""
    letters.legible.cache_clear()
    yield
    letters.legible.cache_clear()


def test_what_no_font_has_is_a_box(monkeypatch):
    monkeypatch.setattr(letters, "_others", lambda size: [])
    assert letters.legible("β₁ 水 🦁", 13) == ("β₁ □ □", letters.font(13))
    assert letters.legible("$1_$ é", 13)[0] == "$1_$ é"


def test_a_font_of_the_system_takes_over(monkeypatch):
    other = ImageFont.truetype(letters.font(13).path, 12)
    monkeypatch.setattr(letters, "_others", lambda size: [other])
    monkeypatch.setattr(letters, "lacking", lambda text, known: set() if known is other else {"水"})
    assert letters.legible("水", 13) == ("水", other)


def test_pictures_show_that_there_is_a_name(monkeypatch):
    monkeypatch.setattr(letters, "_others", lambda size: [])
    named = np.asarray(draw_heatmap(np.eye(1), ["鼠"], ["a"], "")).astype(int)
    blank = np.asarray(draw_heatmap(np.eye(1), [" "], ["a"], "")).astype(int)
    assert (named < 128).sum() > (blank < 128).sum() + 20
