"""Error against time: even feed overrides, and overrides along the path.

python experiments/correction/feed.py [--overrides 0.5 1 1.5] [--weights 0.3 0.1]
    [--uncorrected] [--out FOLDER]
"""

import argparse
import pathlib
import sys
import time
from typing import Any

import numpy as np

import diffmill as dm
from diffmill.correction import FeedTradeoff, TunedFeed, feed_tradeoff, tune_feed
from diffmill.viz import plot_feed, save_figure
from small_job import small_job

OVERRIDES = (0.5, 0.75, 1.0, 1.25, 1.5)
WEIGHTS = (0.3, 0.1, 0.03)
RESULTS = pathlib.Path(__file__).parent / "results"


def measure(
    report: Any,
    job: dm.Job | None = None,
    overrides: tuple[float, ...] = OVERRIDES,
    weights: tuple[float, ...] = WEIGHTS,
    *,
    corrects: bool = True,
    out: pathlib.Path = RESULTS,
) -> None:
    """Print and draw the error over the cycle time."""
    job = small_job() if job is None else job
    tell = lambda text, share: print(f"  {100 * share:3.0f} %  {text}", flush=True)
    even = feed_tradeoff(job, overrides, corrects=corrects, on_progress=tell)
    _even(report, even)
    start = time.perf_counter()
    tuned = tune_feed(job, time_weights=weights, on_progress=tell)
    _tuned(report, even, tuned)
    report.say(f"{time.perf_counter() - start:.0f} s for the overrides along the path")
    out.mkdir(parents=True, exist_ok=True)
    save_figure(plot_feed(even.to_dataset(), tuned.to_dataset()), out / "feed.png")


def _even(report: Any, even: FeedTradeoff) -> None:
    report.say("even overrides; rms contour error over the length that is cut [um]")
    report.say(
        f"{'override':>9}{'time [s]':>10}{'f_z [mm]':>10}{'uncorrected':>13}"
        f"{'corrected':>11}{'offset':>8}"
    )
    order = np.argsort(even.override)
    for k in order:
        report.say(
            f"{even.override[k]:9.2f}{even.cycle_time[k]:10.2f}"
            f"{1e3 * even.feed_per_tooth[k]:10.4f}{1e6 * even.uncorrected[k]:13.2f}"
            f"{1e6 * even.corrected[k]:11.2f}{1e6 * even.max_offset[k]:8.1f}"
        )
    if np.isfinite(even.corrected).all():
        report.at_least(
            "uncorrected over corrected at the same feed, smallest",
            float(np.min(even.uncorrected / even.corrected)),
            1,
        )


def _tuned(report: Any, even: FeedTradeoff, tuned: TunedFeed) -> None:
    report.say()
    report.say("override along the path, uncorrected; beside it the even override of")
    report.say("the same time, between those of the table")
    report.say(
        f"{'weight':>9}{'time [s]':>10}{'rms':>9}{'even':>9}{'runs':>6}  override"
    )
    order = np.argsort(even.cycle_time)
    for point in tuned.points:
        same = np.interp(
            point.cycle_time, even.cycle_time[order], even.uncorrected[order]
        )
        values = "".join(f"{value:6.2f}" for value in point.override)
        report.say(
            f"{point.weight:9.3g}{point.cycle_time:10.2f}{1e6 * point.rms:9.2f}"
            f"{1e6 * same:9.2f}{point.runs:6d}{values}"
            + ("" if point.is_settled else "  (steps ran out)")
        )
        if point is not tuned.points[0]:
            report.at_least("even over tuned, same time", same / point.rms, 1)


def main() -> None:
    """Run some overrides and weights."""
    import jax

    jax.config.update("jax_enable_x64", True)
    dm.use_compile_cache()
    sys.path.append(str(pathlib.Path(__file__).parents[1] / "common"))
    from reporting import Report

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--overrides", nargs="*", type=float, default=OVERRIDES)
    parser.add_argument("--weights", nargs="*", type=float, default=WEIGHTS)
    parser.add_argument("--uncorrected", action="store_true")
    parser.add_argument("--out", type=pathlib.Path, default=RESULTS)
    chosen = parser.parse_args()
    report = Report("diffmill correction: feed")
    measure(
        report,
        None,
        tuple(chosen.overrides),
        tuple(chosen.weights),
        corrects=not chosen.uncorrected,
        out=chosen.out,
    )
    print(report.text().splitlines()[-1])


if __name__ == "__main__":
    main()
