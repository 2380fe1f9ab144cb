"""The configuration files that a command line names, looked at before torch is loaded."""

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml

from bra.cli.errors import fail

BESIDE = "# classes beside: "
"""Marks, in a saved configuration, where to look for the classes that it names."""
SECTIONS = ("data", "model", "trainer")
OF_CLASSES = {"class_path", "init_args", "dict_kwargs"}
"""What may be said of a class."""
MOST_BY_ALIASES = 100_000
"""Values that aliases may add to those that are written out."""


class Flaw(yaml.MarkedYAMLError):  # type: ignore[misc]  # has no types
    """What is wrong with a configuration that is YAML.

    Args:
        node: Where it is.
        problem: What it is.
    """

    def __init__(self, node: yaml.Node, problem: str) -> None:
        super().__init__(None, None, problem, node.start_mark)


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
        _check_sections(compose(file.read_text(encoding="utf-8")))
    except OSError as error:
        fail(f"config: cannot read {file}: {error.strerror}")
    except UnicodeDecodeError as error:
        fail(f"config: cannot read {file}: not UTF-8 ({error}); save it as UTF-8")
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        no_yaml = "" if isinstance(error, Flaw) else ", is no YAML"
        fail(f"config: {file}, line {line}{no_yaml}: {error.problem}")
    except yaml.YAMLError as error:
        fail(f"config: {file} is no YAML: {error}")
    except ValueError as error:
        fail(f"config: {file} {error}")


def hollow_keys(args: Sequence[str]) -> Iterator[list[str]]:
    """Keys that hold an empty mapping, which parsers overlook, in files and on the command line."""
    for file in configuration_files(args):
        yield from _hollow(compose(file.read_text(encoding="utf-8")), [])
    for key, text in _written_out(args):
        yield from _hollow(compose(text), key.split("."))


def check_arguments(args: Sequence[str]) -> None:
    """Ends the command if a mapping or a list on the command line is no such YAML as in a file."""
    for key, text in _written_out(args):
        try:
            compose(text)
        except Flaw as error:
            fail(f"{key}: {error.problem}")
        except yaml.YAMLError:
            continue  # what is no YAML may be text


def _written_out(args: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Keys whose values are mappings or lists, and these, as the command line has them."""
    for arg, following in itertools.pairwise([*args, ""]):
        key, _, value = arg.partition("=")
        text = (value or following).lstrip()
        if key.startswith("--") and text.startswith(("{", "[")):
            yield key.strip("-+"), text


def _hollow(node: yaml.Node | None, path: list[str]) -> Iterator[list[str]]:
    if isinstance(node, yaml.SequenceNode):
        for item in node.value:
            yield from _hollow(item, path)
    elif isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            yield from _hollow(value, [*path, key.value])
        if not node.value:
            yield path


def is_known(config: Any, path: Sequence[str]) -> bool:
    """Whether a parsed configuration has a key; in a list, any of its items."""
    if isinstance(config, list):
        return any(is_known(item, path) for item in config)
    if not path or path[0] in ("init_args", "dict_kwargs"):
        return len(path) < 2 or is_known(config, path[1:])
    parts = [config, config.get("init_args")] if hasattr(config, "get") else []
    return any(path[0] in part and is_known(part[path[0]], path[1:]) for part in parts if part)


def compose(text: str) -> yaml.Node | None:
    """The nodes of YAML that says everything once, and comes to an end.

    Raises:
        yaml.YAMLError: If keys are there twice, aliases stand for too much, or it is no YAML.
    """
    sizes: dict[int, int] = {}

    def size(node: yaml.Node) -> int:
        if id(node) not in sizes:
            sizes[id(node)] = MOST_BY_ALIASES * len(text)  # as long as it is within itself
            sizes[id(node)] = 1 + sum(map(size, _parts(node)))
        if sizes[id(node)] > len(sizes) + MOST_BY_ALIASES:
            raise Flaw(node, "its aliases stand for more than a configuration holds")
        return sizes[id(node)]

    try:
        root = yaml.compose(text)
        if root is not None:
            size(root)
    except RecursionError:
        raise yaml.YAMLError("it is nested too deeply") from None
    return root


def _parts(node: yaml.Node) -> list[yaml.Node]:
    """What a node holds."""
    if not isinstance(node, yaml.MappingNode):
        return list(node.value) if isinstance(node, yaml.SequenceNode) else []
    keys: set[str] = set()
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise Flaw(key, "expected the name of a key, got a list or a mapping")
        if key.value in keys:
            raise Flaw(key, f"the key {key.value!r} is there twice")
        keys.add(key.value)
    if "class_path" in keys and (others := keys - OF_CLASSES):
        key = next(key for key, _ in node.value if key.value in others)
        raise Flaw(key, f"{key.value} beside class_path; what a class is given is in init_args")
    return [part for pair in node.value for part in pair]


def _check_sections(root: yaml.Node | None) -> None:
    if not isinstance(root, yaml.MappingNode):
        raise ValueError("must hold sections such as `data:` and `model:`")
    for key, value in root.value:
        if not key.tag.endswith(":str"):
            raise Flaw(key, f"expected the name of a section, got {key.value}")
        if key.value in SECTIONS and not isinstance(value, yaml.MappingNode):
            text = value.value if isinstance(value, yaml.ScalarNode) else "a list"
            if isinstance(value, yaml.ScalarNode) and Path(text).suffix:
                continue  # the name of a file
            raise Flaw(
                key,
                f"section {key.value!r} must hold keys and values, got {text or 'nothing'}; leave "
                "it out if there are none",
            )
