"""Random numbers that are counted, not carried: keys, and what is drawn with them.

What update k draws depends on the run's seed, on the name of the stream that it draws from, and on
k, and on nothing else: not on the number of data workers, nor on whether the run was cut and
resumed, nor on who else drew random numbers meanwhile.
"""

from bra.randomness.draws import Streams
from bra.randomness.generators import counted, counted_generator

__all__ = ["Streams", "counted", "counted_generator"]
