"""Random numbers that are counted, not carried: keys, draws, and generators for what needs one."""

from bra.randomness.generators import Streams, counted, counted_generator

__all__ = ["Streams", "counted", "counted_generator"]
