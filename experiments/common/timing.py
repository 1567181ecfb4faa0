"""Times that can be compared although a machine does other work too."""

import statistics
import time
from collections.abc import Callable

import jax


def alternate(runs: int, *functions: Callable) -> list[float]:
    """Return the median time of each function [s], run in turn after a warm-up."""
    times: list[list[float]] = [[] for _ in functions]
    for function in functions:
        jax.block_until_ready(function())
    for _ in range(runs):
        for function, found in zip(functions, times, strict=True):
            start = time.perf_counter()
            jax.block_until_ready(function())
            found.append(time.perf_counter() - start)
    return [statistics.median(found) for found in times]
