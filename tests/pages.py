"""Does what a page of the documentation says, from its first block to its last."""

import os
import re
import runpy
import shlex
import sys
import tomllib
from pathlib import Path

from bra.cli import main

BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```', re.S | re.M)


def run_page(page: Path, updates: int | None = None) -> None:
    """In the current folder: files are written, Python and the lines of `bra` and `python` run.

    Epochs have so many updates, or as many as the page says. Sketches, which are `py`, do not run.
    """
    folder, known = Path.cwd(), {"__name__": "__main__"}
    text = page.read_text(encoding="utf-8")
    if updates:
        text = re.sub(r"(updates_per_epoch(: |=))\d+", rf"\g<1>{updates}", text)
    sys.path.insert(0, str(folder))
    try:
        for language, title, block in BLOCK.findall(text):
            if title:
                write(folder / title, block)
            elif language == "python":
                exec(compile(block, str(page), "exec"), known)
            elif language == "bash":
                run_lines(block)
    finally:
        sys.path.remove(str(folder))


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    if path.name == "pyproject.toml":
        install(path)


def install(path: Path) -> None:
    """What pip would leave behind of a package: where it lies, and its entry points."""
    project = tomllib.loads(path.read_text(encoding="utf-8"))["project"]
    lines = [
        line
        for group, entries in project["entry-points"].items()
        for line in (f"[{group}]", *(f"{name} = {value}" for name, value in entries.items()))
    ]
    info = path.parent / f"{project['name'].replace('-', '_')}.egg-info"
    info.mkdir()
    (info / "PKG-INFO").write_text(f"Name: {project['name']}\nVersion: {project['version']}\n")
    (info / "entry_points.txt").write_text("\n".join(lines))
    sys.path.insert(0, str(path.parent))


def run_lines(block: str) -> None:
    for line in block.replace("\\\n", " ").splitlines():
        words = shlex.split(os.path.expandvars(line), comments=True)
        if words[:1] == ["bra"]:
            main([*words[1:], *quiet(words[1])])
        elif words[:1] == ["python"]:
            runpy.run_path(words[1], run_name="__main__")


def quiet(command: str) -> list[str]:
    bar = "--trainer.enable_progress_bar=false"
    return [bar] if command in ("fit", "test", "validate", "predict") else []
