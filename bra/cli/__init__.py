"""The command `bra`."""

from bra.cli.command import main

__all__ = ["main"]
