"""The command `bra`."""

from bra.cli.main import main

__all__ = ["main"]
