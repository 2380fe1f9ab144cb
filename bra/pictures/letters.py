"""Letters that pictures are written in."""

import functools
from pathlib import Path

from PIL import ImageFont

Font = ImageFont.FreeTypeFont
OTHERS = (
    *("NotoSansCJK-Regular.ttc", "DroidSansFallback.ttf", "wqy-zenhei.ttc"),
    *("PingFang.ttc", "Hiragino Sans GB.ttc", "msyh.ttc", "malgun.ttf", "YuGothM.ttc"),
    *("NotoEmoji-Regular.ttf", "Apple Symbols.ttf", "seguisym.ttf"),
)
"""Files of fonts that systems may have, for what ours lacks: Chinese, Japanese, Korean, symbols."""
UNKNOWN, NOTHING = "□", "\uffff"
"""What stands for a letter that no font has, and one that none has."""


@functools.cache
def font(size: int) -> Font:
    """Letters, Greek ones too, which Pillow's own font has not."""
    return ImageFont.truetype(str(Path(__file__).with_name("DejaVuSans.ttf")), size)


@functools.cache
def legible(text: str, size: int) -> tuple[str, Font]:
    """A text and a font for it: another one than ours where that lacks letters, or else with □."""
    known = next((f for f in [font(size), *_others(size)] if not lacking(text, f)), None)
    if known:
        return text, known
    lost = lacking(text, font(size))
    return "".join(UNKNOWN if letter in lost else letter for letter in text), font(size)


def lacking(text: str, known: Font) -> set[str]:
    """The letters of a text that a font draws like one that does not exist."""
    nothing = bytes(known.getmask(NOTHING))
    letters = {letter for letter in text if not letter.isspace()}
    return {letter for letter in letters if bytes(known.getmask(letter)) == nothing}


@functools.cache
def _others(size: int) -> list[Font]:
    found = []
    for name in OTHERS:
        try:
            found.append(ImageFont.truetype(name, size))
        except OSError:  # which the system does not have
            continue
    return found
