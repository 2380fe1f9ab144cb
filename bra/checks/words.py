"""Words for people."""


def amount(count: int, noun: str, several: str = "") -> str:
    """A number of things: "1 update", "1,000 updates", "2 boxes".

    Args:
        count: How many.
        noun: What one is called.
        several: What several are called, if not by an s at the end.
    """
    return f"{count:,} {noun if count == 1 else several or noun + 's'}"


def shown(value: object, most: int = 60) -> str:
    """What was given, for a line that says so."""
    text = " ".join(repr(value).split())
    return text if len(text) <= most else f"{text[:most]} …"
