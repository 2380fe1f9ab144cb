"""One line for every wrong input: the key, what was given, what is accepted."""

import inspect
import re
from collections.abc import Iterable
from difflib import get_close_matches

from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from bra.channels import Channel
from bra.critics import Critic
from bra.marginals import Marginals
from bra.tasks import Task
from bra.update_rules import UpdateRule

KINDS: dict[str, tuple[str, type]] = {
    "data.task": ("task", Task),
    "model.perception": ("channel", Channel),
    "model.action": ("channel", Channel),
    "model.update_rule": ("update rule", UpdateRule),
    "model.marginals": ("marginals", Marginals),
    "model.perception_optimizer": ("optimizer", Optimizer),
    "model.action_optimizer": ("optimizer", Optimizer),
    "model.perception_scheduler": ("scheduler", LRScheduler),
    "model.action_scheduler": ("scheduler", LRScheduler),
    "critic": ("critic", Critic),
}
"""What stands at keys that name a class; those within another class stand without its key."""


def explain(message: str, accepted: Iterable[str] = ()) -> str:
    """Rewrites a message of jsonargparse as one line.

    Args:
        message: The message.
        accepted: Keys that the parser takes, to suggest one from.
    """
    key = _first(r'Parser key "([^"]+)"', message)
    unknown = (
        _first(r"Option '([^']+)' is not accepted", message)
        or _first(r"does not accept option '([^']+)'", message)
        or _first(r"^unrecognized arguments: --([^=\s]+)", message)
    )
    if unknown:
        return f"unknown key {unknown}; {suggest(unknown, accepted)}"
    given = _first(r"Namespace\(class_path='([^']+)'", message) or _first(
        r"(?:Got value|Given value): (\S+)$", message
    )
    inner = (
        _first(r"Problem with given class_path '[^']+':\n\s*(.+)", message)
        or _first(r"expects a function or a callable class: (.+?)\.+ Got value: ", message)
        or _first(r"expects a function or a callable class: (the following .+)", message)
    )
    if inner and re.match("No module named|module '.+' has no attribute", inner):
        return f"{key}: cannot import {given}: {inner}; is its file beside the configuration?"
    if key in KINDS:
        name = _first(r"Expected a dot import path string: (\S+)", message)
        if inner and inner.endswith(f"subclass of <class '{KINDS[key][1].__name__}'>"):
            name = given
        if name:
            return f"{key}: {unknown_class(name, *KINDS[key])}"
    if inner and not key:
        return inner
    if inner:  # the words of a class's own parser, which went through here before
        return f"{key}.{inner}" if re.match(r"[\w.]+: ", inner) else f"{key}: {inner}"
    return _one_line(message)


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


def _one_line(message: str) -> str:
    """Joins the lines, with Python's type names and jsonargparse's bookkeeping left out."""
    given = _first(r"Given value: (?!Namespace)(.+)", message)
    message = re.sub(r'Parser key "([^"]+)":', r"\1:", message)
    message = re.sub(r"\n *Given value type:.*|\n *Given value:.*|\n *Subtypes:.*", "", message)
    message = re.sub(r"(\n *- |\n *|^)Does not validate against any of the Union.*", "", message)
    message = re.sub(r"\n *- Expected a path but .* either not accessible or invalid", "", message)
    message = re.sub(r"\n *Errors:", "", message)
    message = re.sub(r"<class '(?:[\w.]*\.)?(\w+)'>", r"\1", message)
    classes = r"(Expected a dot import path string|Unexpected import path format): \S+"
    message = re.sub(classes, "Expected a class path", message)
    message = message.replace("Expected a typing.Literal", "expected one of ")
    message = re.sub(r"\n *- expected one of ", " or one of ", message)
    message = re.sub(r"\n *- Expected a ", " or ", message)
    message = re.sub(r"Expected an? ", "expected ", message).replace("NoneType", "null")
    message = message.replace("or class path or class path", "or class path")
    message = message.replace(". Got value: ", ", got ")
    line = " ".join(message.split()).replace(": or ", ": expected ").removeprefix("- ")
    line = line.replace("expected Sequence", "expected a list")
    if "expected" not in line:  # a constructor's own words, to which null is no alternative
        line = re.sub("( or null)+$", "", line)
    return f"{line}, got {given}" if given else line


def _first(pattern: str, message: str) -> str | None:
    match = re.search(pattern, message, re.MULTILINE)
    return match.group(1) if match else None
