"""The verdict on chatter beside marches in time: ten cuts, half of them unstable.

Run from the root of the repository: python experiments/stability/run.py
Drawn cuts on drawn machines: the same with --draws 10 --seed 1
"""

import argparse
import dataclasses
import pathlib
import sys
import tempfile
import time

import jax
import numpy as np
from scipy.ndimage import maximum_filter1d

jax.config.update("jax_enable_x64", True)
HERE = pathlib.Path(__file__).parent
sys.path.append(str(HERE.parent / "common"))

import diffmill as dm  # noqa: E402
from jobs import CUTS, Cut, drawn  # noqa: E402
from reporting import Report, store  # noqa: E402

# Kick of the command in x and y in one row [m]: smaller than the vibrations that
# entries leave, larger than what a tool that stands in a corner rubs away.
KICK = 1e-6
# Rows over which a vibration swings at least once, and until the kick itself is over.
TURN, OVER = 9, 10
# What has decayed to this is gone [m].
ROUNDING = 1e-15


def march(
    job: dm.Job, solution: dm.sim.Solution, rows: np.ndarray
) -> tuple[float, float]:
    """Growth of a vibration in two marches, one of which is kicked.

    Args:
        job: The job.
        solution: The march without a kick.
        rows: Rows of the steady cut.

    Returns:
        Growth per tooth period there, by a line through the logarithm of the size of
        the difference, and the largest factor from one moment of the whole cut to a
        later one. Where the tool nearly stands only decay counts: any small vibration
        grows in the thin chips there, up to their thickness and no further.
    """
    is_cutting = np.asarray(solution.is_cutting)
    first = int(np.flatnonzero(~is_cutting[: rows[0]])[-1]) + 1
    command = np.asarray(solution.commanded).copy()
    command[first, :2] += KICK
    kicked = dm.simulate(dataclasses.replace(job, commanded=command))
    moved = np.asarray(kicked.actual - solution.actual)[:, :2]
    size = maximum_filter1d(np.linalg.norm(moved, axis=1), TURN)
    size = np.maximum(size, ROUNDING)
    slope = np.polyfit(rows, np.log(size[rows]), 1)[0]
    cut = np.arange(first + OVER, rows[-1])
    way = np.linalg.norm(np.diff(np.asarray(solution.desired), axis=0), axis=1)
    feed = np.median(way[rows - 1])
    stands = maximum_filter1d(way < 0.1 * feed, 2 * TURN)[cut - 1]
    more = np.log(size[cut] / size[cut - 1])
    more = np.where(stands, np.minimum(more, 0), more)
    total = np.concatenate([[0.0], np.cumsum(more)])
    grown = np.exp((total - np.minimum.accumulate(total)).max())
    return float(np.exp(slope)), float(grown)


def main() -> None:
    """Print one line for each cut, and the cost of the check."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--draws", type=int, help="so many drawn cuts instead")
    parser.add_argument("--seed", type=int, default=0, help="of the draws")
    asked = parser.parse_args()
    cuts = CUTS if asked.draws is None else drawn(asked.draws, asked.seed)
    report = Report("diffmill stability: the default check beside marches in time")
    report.say("growth per tooth period in the steady cut, and the largest in all")
    report.say(
        f"{'cut':34}{'check':>8}{'march':>8}{'Hz':>7}{'check':>9}"
        f"{'march':>9}  {'verdict':9}{'march':9}{'time [s]':>9}"
    )
    with tempfile.TemporaryDirectory() as folder:
        for cut in cuts:
            _line(report, cut, pathlib.Path(folder))
    name = "stability" if asked.draws is None else f"drawn_{asked.seed}"
    store(report, HERE / "results", name)


def _line(report: Report, cut: Cut, folder: pathlib.Path) -> None:
    job = cut.job(folder)
    solution = dm.simulate(job)
    start = time.process_time()
    found = dm.sim.Stability.where_suspected(job, solution)
    seconds = time.process_time() - start
    chatters = found is not None and found.warning() is not None
    rows = cut.window(np.asarray(solution.desired))
    full = dm.sim.stability(job, solution, rows=rows[:: max(1, len(rows) // 12)])
    predicted = float(np.exp(np.log(full.radius).mean()))
    growth, grown = march(job, solution, rows)
    in_all = 1.0 if found is None else float(np.exp(found.log_growth.max()))
    grows = grown >= 2
    words = ["unstable" if x else "stable" for x in (chatters, grows)]
    report.say(
        f"{cut.name:34}{predicted:8.4f}{growth:8.4f}{np.median(full.frequency):7.1f}"
        f"{in_all:9.3g}{grown:9.3g}  {words[0]:9}{words[1]:9}{seconds:9.2f}"
    )
    report.require(f"{cut.name}: verdict and march agree", chatters == grows)


if __name__ == "__main__":
    main()
