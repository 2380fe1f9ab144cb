"""One line for every wrong input: the key, what was given, what is accepted."""

import inspect
import re
import sys
from collections.abc import Iterable
from difflib import get_close_matches
from pkgutil import resolve_name
from typing import NoReturn

KINDS = {
    "data.task": ("task", "bra.tasks:Task"),
    "model.perception": ("channel", "bra.channels:Channel"),
    "model.action": ("channel", "bra.channels:Channel"),
    "model.update_rule": ("update rule", "bra.update_rules:UpdateRule"),
    "model.marginals": ("marginals", "bra.marginals:Marginals"),
    "model.perception_optimizer": ("optimizer", "torch.optim:Optimizer"),
    "model.action_optimizer": ("optimizer", "torch.optim:Optimizer"),
    "model.perception_scheduler": ("scheduler", "torch.optim.lr_scheduler:LRScheduler"),
    "model.action_scheduler": ("scheduler", "torch.optim.lr_scheduler:LRScheduler"),
    "critic": ("critic", "bra.critics:Critic"),
}
"""What stands at keys that name a class; those within another class stand without its key."""
BOOKKEEPING = (
    "Does not validate",
    "Subtypes:",
    "Errors:",
    "Given value",
    "Problem with given class_path",
    "Expected a path but",
    "Expected a <class 'NoneType'>",
    "Subclass types expect",
    "a class path (str)",
    "a dict with",
    'Parser key "',
)
"""How lines of jsonargparse begin that do not say what is wrong."""
UNKNOWN = (
    r"Option '(.+)' is not acc|unrecognized arguments: --([^=\s]+)|.+ not accept option '(.+)'"
)
MISSING = r"the following arguments are required: (?:\w+\.)?(data\.task|\w+)$"
NO_CLASS = (
    r"(?:Expected a dot import path string:|Unexpected import path format:) ?(\S*)"
    r"|Expected '(\S+)' to be a subclass"
)
EXPECTED = (
    rf"{NO_CLASS}|Expected a <class '(?:\w+\.)*(\w+)'>|Expected a typing.Literal(\[.+\])"
    r"|Not a valid subclass of|Not of type (Path)"
)


def fail(message: str) -> NoReturn:
    """Prints one line and exits with code 2."""
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    raise SystemExit(2)


def suggest(name: str, accepted: Iterable[str]) -> str:
    """The nearest accepted name if there is one, and the accepted names if they are few."""
    names = sorted(set(accepted))
    near = get_close_matches(name, names, n=1)
    parts = [f"did you mean {near[0]}?"] if near else []
    if len(names) <= 20:
        parts.append(f"expected one of {', '.join(names)}")
    elif not near:
        parts.append("see --help for the keys there are")
    return " ".join(parts)


def explain(message: str, accepted: Iterable[str] = ()) -> str:
    """Rewrites a message of jsonargparse as one line.

    Args:
        message: The message.
        accepted: Keys that the parser takes, to suggest one from.
    """
    if re.match(r"argument _seed\(seed_everything\)", message):
        return "model.seed is set by seed_everything; give --seed_everything a number"
    if missing := re.match(MISSING, message):
        return _missing(missing[1])
    unknown = re.match(UNKNOWN, message)
    if unknown:
        name = next(filter(None, unknown.groups()))
        return f"unknown key {name}; {suggest(name, accepted)}"
    head = re.match(r'Parser key "(.+?)":', message)
    key, text = (head[1], message[head.end() :]) if head else ("", message)
    reasons = [reason for line in text.splitlines() if (reason := _reason(line))]
    given = _first(r"class_path='([^']+)'", text) or _first(r"(?:Got|Given) value: (\S.*)", text)
    line = _wrong_class(key, reasons, given) or _wrong_value(reasons, given)
    if not key:
        return line
    return f"{key}.{line}" if re.match(r"[\w.]+: ", line) else f"{key}: {line}"


def _missing(key: str) -> str:
    """How to give what has to be given."""
    if key == "data.task":
        known = "such as PredatorPrey; bra help task lists them"
        return f"{key} is missing; give --config FILE, or --{key} and a class, {known}"
    return f"{key} is missing; give --{key} and its value"


def _reason(line: str) -> str:
    """What a line says, apart from the bookkeeping."""
    reason = re.sub(r"^Type .+ expects a function or a callable class: ", "", line.lstrip(" -"))
    return "" if reason.startswith(BOOKKEEPING) else re.sub(r"\.* Got value: .+", "", reason)


def _wrong_class(key: str, reasons: list[str], given: str) -> str:
    """If a class is not found, or is of the wrong kind: how to name one."""
    for reason in reasons:
        if re.match("No module named|module '.+' has no attribute|cannot import", reason):
            return f"cannot import {given}: {reason}; is its file beside the configuration?"
        name = re.match(NO_CLASS, reason)
        if name and key in KINDS:
            kind, base = KINDS[key]
            return unknown_class(name[1] or name[2], kind, resolve_name(base))
    return ""


def _wrong_value(reasons: list[str], given: str) -> str:
    """A constructor's own words, or else the types that are accepted."""
    types = [match for reason in reasons if (match := re.match(EXPECTED, reason))]
    if len(types) < len(reasons) or not types:
        return " ".join(reason for reason in reasons if not re.match(EXPECTED, reason))
    names = dict.fromkeys(
        f"one of {choices}" if choices else (name or "class path").replace("Sequence", "a list")
        for name, choices in ((match[3] or match[5], match[4]) for match in types)
    )
    return f"expected {' or '.join(names)}, got {given}"


def _first(pattern: str, text: str) -> str:
    match = re.search(pattern, text)
    return match[1] if match else ""


def unknown_class(name: str, kind: str, base: type) -> str:
    """Says which classes there are in place of one that there is not."""
    known = sorted({cls.__name__ for cls in concrete_subclasses(base)})
    return (
        f"{name} is no {kind}; {suggest(name, known)}, or the class path of your own, "
        f"such as my_module.MyClass"
    )


def concrete_subclasses(base: type) -> set[type]:
    """All imported classes derived from `base` that can be constructed."""
    found: set[type] = set()
    cls: type
    for cls in base.__subclasses__():
        found |= concrete_subclasses(cls)
        if not inspect.isabstract(cls) and not cls.__name__.startswith("_"):
            found.add(cls)
    return found
