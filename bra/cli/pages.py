"""What keys and settings look like on a page of help."""

import inspect
import re
import textwrap
import types
from argparse import Action, ArgumentParser
from collections.abc import Iterable
from typing import Any, Literal, Union, get_args, get_origin

from docstring_parser import parse
from jsonargparse import Unset

from bra.cli.errors import KINDS

WIDTH, INDENT = 100, " " * 6
OWN = {
    "seed_everything": "Seed of all that is drawn.",
    "ckpt_path": "Checkpoint to go on from, or to evaluate: a path, `last` or `best`.",
    "weights_only": "Whether checkpoints may hold plain data and tensors only, as ours do.",
    "verbose": "Whether Lightning prints what it was given to log.",
    "return_predictions": "Of no use here; predictions are written to `rollouts.csv`.",
}
"""What Lightning tells at length."""
SECTIONS = {
    "": "command",
    "data": "world",
    "model": "agent",
    "trainer": "Lightning's trainer",
    "monitors": "monitors, each of which `null` turns off",
}
TRAINER_KEYS = (
    "max_epochs",
    "max_steps",
    "max_time",
    "accelerator",
    "devices",
    "precision",
    "logger",
    "callbacks",
    "gradient_clip_val",
    "enable_progress_bar",
    "enable_checkpointing",
    "default_root_dir",
)
"""What of its keys is explained; of others there are names."""


def keys_page(parser: ArgumentParser) -> str:
    """The keys of a command with their types and defaults."""
    known: dict[str, list[str]] = {section: [] for section in SECTIONS}
    others = []
    for action in parser._actions:
        if not (action.option_strings and hasattr(action, "_typehint")) or _is_help(action):
            continue
        section, _, name = action.dest.rpartition(".")
        if section == "trainer" and name not in TRAINER_KEYS:
            others.append(name)
        elif isinstance(getattr(action.default, "class_path", None), str):
            text = (action.help or "").removesuffix(" `null` turns it off.")
            known["monitors"].append(_entry(f"  --{action.dest}", text))
        else:
            known[section].append(_key(action))
    if others:
        known["trainer"].append(_entry("  and", ", ".join(others)))
    configured = any(action.dest == "config" for action in parser._actions)
    keys = "[--config FILE] [--KEY VALUE ...]" if configured else "[--KEY VALUE ...]"
    lines = [f"usage: {parser.prog.replace(' [options]', '')} {keys}"]
    lines += ["", *textwrap.wrap(parser.description or "", WIDTH)]
    for section, entries in known.items():
        if entries:
            lines += ["", f"{SECTIONS[section]}:", *entries]
    foot = "`bra help` lists tasks, channels, rules and other classes, and their settings."
    return "\n".join([*lines, "", foot]) + "\n"


def class_page(cls: type) -> str:
    """What a class is, and its settings."""
    return "\n".join([f"{cls.__name__}: {summary(cls)}", *settings(cls)])


def summary(cls: type) -> str:
    """The first line of its docstring."""
    return (inspect.getdoc(cls) or "").partition("\n")[0]


def settings(cls: type) -> list[str]:
    """An entry for each argument that a configuration can give."""
    texts = {p.arg_name: p.description or "" for p in parse(inspect.getdoc(cls) or "").params}
    entries = []
    for parameter in inspect.signature(cls).parameters.values():
        if parameter.name in ("condition_space", "outcome_space") or parameter.kind in (
            parameter.VAR_KEYWORD,
            parameter.VAR_POSITIONAL,
        ):
            continue
        needed = parameter.default is parameter.empty
        default = "" if needed else f" = {_plain(parameter.default)}"
        head = f"  {parameter.name}: {type_text(parameter.annotation)}{default}"
        entries.append(_entry(head, texts.get(parameter.name, "")))
    return entries


def type_text(hint: Any) -> str:
    """A type as people write it."""
    if isinstance(hint, str):
        return hint
    if get_origin(hint) in (Union, types.UnionType):
        return " or ".join(_unique(type_text(part) for part in get_args(hint)))
    if get_origin(hint) is Literal:
        return " or ".join(_unique(map(str, get_args(hint))))
    if hint is type(None):
        return "null"
    if arguments := get_args(hint):
        if isinstance(arguments[0], list):  # a function
            return f"{type_text(arguments[1])} class"
        inner = ", ".join(_unique(map(type_text, arguments)))
        return f"{type_text(get_origin(hint))} of {inner}"
    name = getattr(hint, "__name__", str(hint))
    return {"Sequence": "list", "str": "text", "bool": "true or false"}.get(name, name)


def _unique(texts: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(texts))


def _is_help(action: Action) -> bool:
    return any(option.endswith(".help") for option in action.option_strings)


def _key(action: Any) -> str:
    """An entry; of what Lightning explains the first sentence."""
    kind = KINDS.get(action.dest, (type_text(action._typehint),))[0]
    kind = textwrap.shorten(kind, 60, placeholder=" …")
    needless = action.default is None or action.default is Unset
    shown = "" if needless else f", {_plain(action.default)}"
    text = OWN.get(action.dest, action.help or "")
    if action.dest.startswith("trainer"):
        text = re.split(r"\.\s", text)[0]
    return _entry(f"  --{action.dest}  ({kind}{shown})", text)


def _plain(default: Any) -> str:
    text = {True: "true", False: "false", None: "null"}.get(default) if _simple(default) else None
    return text or getattr(default, "__name__", None) or str(default)


def _simple(value: Any) -> bool:
    return value is None or isinstance(value, bool)


def _entry(head: str, text: str) -> str:
    body = " ".join(text.replace("``", "`").split())
    lines = textwrap.wrap(body, WIDTH, initial_indent=INDENT, subsequent_indent=INDENT)
    return "\n".join([head, *lines])
