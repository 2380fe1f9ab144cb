"""The command `bra`."""

from bra.cli.start import main

__all__ = ["main"]
