"""Times of several programs, taken in turn, and times to compile."""

import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np


def compiled(function: Callable[..., Any], *args: Any) -> tuple[Any, float]:
    """Return a compiled function and the seconds that tracing and compiling took."""
    start = time.perf_counter()
    program = jax.jit(function).lower(*args).compile()
    return program, time.perf_counter() - start


def in_turn(jobs: dict[Any, Callable[[], Any]], rounds: int = 7) -> dict[Any, float]:
    """Return the median seconds of each job; all share what else the machine does."""
    for job in jobs.values():
        jax.block_until_ready(job())
    times: dict[Any, list[float]] = {key: [] for key in jobs}
    for _ in range(rounds):
        for key, job in jobs.items():
            start = time.perf_counter()
            jax.block_until_ready(job())
            times[key].append(time.perf_counter() - start)
    return {key: float(np.median(spent)) for key, spent in times.items()}
