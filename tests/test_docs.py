"""What the documentation shows runs."""

import importlib
import re
import sys
from pathlib import Path

import pytest
from pages import run_page

import bra

ROOT = Path(__file__).parents[1]
PAGES = [
    page.relative_to(ROOT).as_posix()
    for page in [ROOT / "README.md", *sorted(ROOT.glob("docs/*.md"))]
    if re.search(r"^```(python|bash)", page.read_text(encoding="utf-8"), re.M)
]


@pytest.mark.parametrize("page", PAGES)
def test_blocks_of_a_page_run_one_after_the_other(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    run_page(ROOT / page, updates=2)


@pytest.mark.parametrize("room", ["channels", "tasks", "update_rules", "critics", "callbacks"])
def test_the_reference_has_everything_public(room):
    pages = [page.read_text(encoding="utf-8") for page in ROOT.glob("docs/api/*.md")]
    listed = {name for page in pages for name in re.findall(r"^::: (\S+)", page, re.M)}
    short = {name.rpartition(".")[2] for name in listed}
    public = importlib.import_module(f"bra.{room}").__all__
    assert {name for name in public if name[0].isupper()} <= short
    assert {name for name in bra.__all__ if name[0].isupper()} <= short


def test_links_lead_somewhere():
    for page in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]:
        for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name} links {target}"
