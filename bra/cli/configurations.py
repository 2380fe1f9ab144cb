"""The configuration files that a command line names, looked at before torch is loaded."""

import itertools
from collections.abc import Sequence
from pathlib import Path

import yaml

from bra.cli.errors import fail

BESIDE = "# classes beside: "
"""Marks, in a saved configuration, where to look for the classes that it names."""


def configuration_files(args: Sequence[str]) -> list[Path]:
    """The files that a command line names, in order."""
    files = []
    for arg, following in itertools.pairwise([*args, ""]):
        option, _, value = arg.partition("=")
        if option in ("--config", "-c"):
            if not value and (not following or following.startswith("-")):
                fail("--config needs a file")
            files.append(Path(value or following))
    return files


def configuration_folders(args: Sequence[str]) -> list[str]:
    """The folders of these files, and those that a run's saved configuration names."""
    folders: list[str] = []
    for file in configuration_files(args):
        folders.append(str(file.resolve().parent))
        lines = file.read_text(encoding="utf-8").splitlines()
        folders += [line.removeprefix(BESIDE) for line in lines if line.startswith(BESIDE)]
    return list(dict.fromkeys(folders))


def check_configuration(file: Path) -> None:
    """Ends the command if a file cannot be read, or is no YAML of sections."""
    if file.exists() and not file.is_file():
        fail(f"config: {file} is no file, but a folder, device or pipe; give a YAML file")
    try:
        content = yaml.compose(file.read_text(encoding="utf-8"))
    except OSError as error:
        fail(f"config: cannot read {file}: {error.strerror}")
    except UnicodeDecodeError as error:
        fail(f"config: cannot read {file}: not UTF-8 ({error})")
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        fail(f"config: {file}, line {line}, is no YAML: {error.problem}")
    except yaml.YAMLError as error:
        fail(f"config: {file} is no YAML: {error}")
    if content is not None and not isinstance(content, yaml.MappingNode):
        fail(f"config: {file} must hold sections such as `data:` and `model:`")
