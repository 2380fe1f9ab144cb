"""Imports run downhill, and nothing is loaded that is not used."""

import ast
import functools
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "bra"
FLOORS = [  # from the top down; rooms of one floor know nothing of each other
    {"__main__"},
    {"cli"},
    {"reproductions"},
    {"callbacks"},
    {"population"},
    {"agent"},
    {"blocks"},
    {"update_rules"},
    {"critics", "evaluation", "frontiers"},
    {"chain"},
    {"marginals", "objective", "cooling", "budgets"},
    {"channels", "tasks", "blahut_arimoto"},
    {"information", "randomness", "checkpoints", "pictures", "processes"},
    {"checks"},
]
HEIGHT = {room: -depth for depth, rooms in enumerate(FLOORS) for room in rooms}
ROOMS = {
    path.stem
    for path in PACKAGE.iterdir()
    if path.suffix == ".py" or (path / "__init__.py").exists()
}
USED_IN_PLACES = {"matplotlib", "pybullet", "scipy", "tensorboard", "torchvision"}
WITH_LIGHTNING = {
    "agent",
    "callbacks",
    "cli",
    "population",
    "reproductions",
    "tasks/datamodule.py",
}


@functools.cache
def parsed(path):
    return ast.parse(path.read_text(encoding="utf-8")).body


def imported_names(path, top_level=False):
    """What a file imports, apart from what only type checkers see."""
    nodes = list(parsed(path))
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        elif not (top_level and isinstance(node, ast.FunctionDef)):
            nodes += ast.iter_child_nodes(node)


def files():
    """Each file of the package, its name within it, and its room."""
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        if name != "__init__.py":
            yield path, name, name.partition("/")[0].removesuffix(".py")


def test_every_room_has_a_floor():
    assert {room for _, _, room in files()} <= HEIGHT.keys()


def test_imports_run_downhill():
    uphill = [
        f"{name} imports {imported}"
        for path, name, room in files()
        for imported in imported_names(path)
        if imported.startswith("bra.")
        and (other := imported.split(".")[1]) != room
        and HEIGHT.get(other, 1) >= HEIGHT[room]
    ]
    assert not uphill


def test_blahut_arimoto_knows_only_information_and_checks():
    known = {
        imported.split(".")[1]
        for path, _, room in files()
        if room == "blahut_arimoto"
        for imported in imported_names(path)
        if imported.startswith("bra.")
    }
    assert known <= {"blahut_arimoto", "information", "checks"}


def test_what_takes_long_is_imported_where_it_is_used():
    top = [
        (name, room, {i.split(".")[0] for i in imported_names(path, top_level=True)})
        for path, name, room in files()
    ]
    assert not [(name, heavy) for name, _, found in top if (heavy := found & USED_IN_PLACES)]
    assert not [
        name
        for name, room, found in top
        if "lightning" in found and not WITH_LIGHTNING & {name, room}
    ]


def test_a_part_loads_what_it_needs():
    parts = {
        "bra": "torch numpy gymnasium lightning",
        "bra.blahut_arimoto": "gymnasium lightning torch._dynamo",
        "bra.tasks, bra.channels, bra.critics, bra.update_rules, bra.information": (
            "lightning torch._dynamo"
        ),
    }
    code = "".join(f"import sys, {modules}; print(*sys.modules)\n" for modules in parts)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for absent, loaded in zip(parts.values(), done.stdout.splitlines(), strict=True):
        assert not {*absent.split(), *USED_IN_PLACES}.intersection(loaded.split())


def test_public_names_are_there_when_they_are_asked_for():
    import bra

    assert {*bra.__all__} <= {*dir(bra)}
    assert all(getattr(bra, name) for name in bra.__all__)
    assert bra.marginals.RunningMarginals  # a module that nobody has imported by name
    with pytest.raises(AttributeError, match="module 'bra' has no attribute 'Agnet'"):
        assert bra.Agnet
    with pytest.raises(AttributeError, match=r"module 'bra.tasks' has no attribute 'Worlds'"):
        assert bra.tasks.Worlds


def test_the_command_is_run_by_its_packages_alone():
    guard = '\nif __name__ == "__main__"'
    runnable = {name for path, name, _ in files() if guard in path.read_text(encoding="utf-8")}
    # Those that `__init__` has imported already would run twice.
    assert runnable == {"__main__.py", "cli/__main__.py"}
