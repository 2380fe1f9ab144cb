"""`bra help`: the classes that a configuration can name, and their settings."""

from collections.abc import Mapping
from difflib import get_close_matches
from pkgutil import resolve_name

from bra.callbacks.monitors import MONITORS
from bra.cli.errors import KINDS, concrete_subclasses, suggest
from bra.cli.pages import class_page, summary

OTHERS = {
    "cooling": "bra.cooling:Cooling",
    "rivals": "bra.update_rules:Rivals",
    "exploration": "bra.critics:Exploration",
}
"""Classes of which there is one."""


def help(name: str = "") -> None:
    """Lists the classes that a configuration can name; of a class or kind of class, its settings.

    Args:
        name: Of a class, such as MLP, or of a kind, such as channel.

    Raises:
        ValueError: If there is neither.
    """
    kinds = known_classes()
    classes = {cls.__name__: cls for known in kinds.values() for cls in known}
    wanted = name.lower().replace("_", " ").removesuffix("s")
    kind = next((k for k in kinds if f" {k}".removesuffix("s").endswith(f" {wanted}")), None)
    if not name:
        print("\n".join(_overview(kinds)))
    elif name in classes:
        print(class_page(classes[name]))
    elif kind:
        print("\n\n".join(map(class_page, kinds[kind])))
    else:
        near = get_close_matches(name, classes)
        raise ValueError(f"unknown class or kind {name}; {suggest(name, [*near, *kinds])}")


def known_classes() -> dict[str, list[type]]:
    """Our own classes of each kind, and those of plug-ins."""
    bases = dict(KINDS.values()) | OTHERS
    kinds: dict[str, list[type]] = {}
    for kind, base in bases.items():
        cls = resolve_name(base)
        found = concrete_subclasses(cls) | ({cls} if kind in OTHERS else set())
        own = [cls for cls in found if not cls.__module__.startswith(("torch.", "lightning."))]
        if own:
            kinds[kind] = sorted(own, key=lambda cls: cls.__name__)
    return kinds | {"monitor": list(MONITORS.values())}


def _overview(kinds: Mapping[str, list[type]]) -> list[str]:
    lines = []
    for kind, classes in kinds.items():
        lines.append(f"{kind}:")
        lines += [f"  {cls.__name__:19}{summary(cls)}" for cls in classes]
    foot = "`bra help MLP` tells the settings of a class, `bra help channel` those of a kind."
    return [*lines, "", f"Optimizers and schedulers are torch's. {foot}"]
