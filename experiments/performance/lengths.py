"""Paths of other lengths: what they compile, and what the padding costs."""

import dataclasses
import time

import jax
import jax.monitoring
import numpy as np

import diffmill as dm
from example import load_example
from timing import alternate

jax.config.update("jax_enable_x64", True)

OVERRIDES = (1.0, 0.8, 1.2)
RUNS = 5


def measure(report):
    """Simulate one example at three feeds, then padded to ever more rows."""
    compiled = []

    def note(event: str, duration_secs: float, **_: str | int) -> None:
        if event.endswith("backend_compile_duration"):
            compiled.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(note)
    job = load_example("paper_small")
    report.say(f"{'feed':>6} {'rows':>6} {'programs':>9} {'processor s':>12}")
    for override in OVERRIDES:
        slower = dataclasses.replace(job, path=at_feed(job.path, override))
        del compiled[:]
        start = time.process_time()
        dm.simulate(slower)
        spent = time.process_time() - start
        rows = slower.path.step_count
        report.say(f"{override:6.1f} {rows:6d} {len(compiled):9d} {spent:12.2f}")
        if override != OVERRIDES[0]:
            report.figure("programs compiled for another feed", len(compiled), 0, "")
    rows = job.path.step_count
    paths = [job.path.padded(count) for count in (rows, 4 * rows)]
    jobs = [dataclasses.replace(job, path=path) for path in paths]
    runs = [lambda job=job: dm.simulate(job).actual for job in jobs]
    once, four = alternate(RUNS, *runs)
    ratio = (four / once - 1) / 3
    report.figure(
        "time of a row behind the last one over that of a row", ratio, 0.2, ""
    )


def at_feed(path, override):
    """Return a path that goes along the same line with another feed."""
    rows = np.arange(0, path.step_count - 1, override)
    at = lambda x: np.column_stack(
        [np.interp(rows, np.arange(path.step_count), column) for column in x.T]
    )
    nearest = np.rint(rows).astype(int)
    return dataclasses.replace(
        path,
        time=path.time[1] * np.arange(rows.size),
        positions=at(np.asarray(path.positions)),
        axes=np.asarray(path.axes)[nearest],
        is_rapid=np.asarray(path.is_rapid)[nearest],
        line=np.asarray(path.line)[nearest],
    )
