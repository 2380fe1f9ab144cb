"""What the optimum of a large table costs: `serial` with its default 32 starts.

    python benchmarks/large_tables.py [SIZE …]

Random utilities of as many states, actions and percepts, at prices of 10 and 10. Prints seconds of
the processor, and the most memory that the process has used. 300 takes seconds, 1000 minutes.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import multiprocessing
import resource
import sys
import time

import numpy as np
import torch
from startup import processor

from bra.blahut_arimoto import serial

GIGABYTE = 2**20
"""In the unit of `ru_maxrss`, which is kilobytes on Linux."""


def solve(size: int) -> None:
    """One table, in a process of its own."""
    torch.set_num_threads(1)
    utilities = np.random.default_rng(0).random((size, size))
    start = time.process_time()
    found = serial(utilities, None, size, 10.0, 10.0)
    seconds = time.process_time() - start
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / GIGABYTE
    print(f"| {size} | {found.objective:.5f} | {found.starts} | {seconds:.0f} | {memory:.1f} |")


if __name__ == "__main__":
    print(f"{processor()}, one thread\n")
    print("| states, actions, percepts | J | starts | seconds of CPU | GB |\n|---|---|---|---|---|")
    for size in map(int, sys.argv[1:] or ("300",)):
        process = multiprocessing.get_context("spawn").Process(target=solve, args=(size,))
        process.start()
        process.join()
