"""Runs pages of the documentation and keeps the pictures that their runs draw.

python docs/draw.py own_table images
"""

import os
import shutil
import sys
import tempfile
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS.parent / "tests"))
PICTURES = {
    "own_table": "**/behaviour/p_action_given_state-*.png",
    "noisy_sensor": "**/behaviour/p_percept_given_state-*.png",
    "images": "**/observations/percept_and_action-*.png",
    "channels_and_rules": "rules.png",
    "plugins": "**/behaviour/p_action_given_state-*.png",
    "populations": "population.png",
    "notebooks": "behaviour.png",
    "searching": "search.png",
}
"""Of each page, which picture stands in it: the last of those that match."""


def draw(name: str) -> None:
    """Runs a page in a folder of its own."""
    from pages import run_page

    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        run_page(DOCS / f"{name}.md")
        *_, last = sorted(Path(folder).glob(PICTURES[name]))
        shutil.copy(last, DOCS / "pictures" / f"{name}.png")
        os.chdir(DOCS)


if __name__ == "__main__":
    for page in sys.argv[1:] or PICTURES:
        draw(page)
