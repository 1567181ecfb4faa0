"""Time, memory and results of commands, against another tree of the project.

python experiments/performance/against.py TREE [--job FILE] [--runs 3] [--out FOLDER]
    [--commands simulate correct gradient]

Both trees run a job by turns, in processes of their own: `simulate`, `correct`, and the
gradient of the summed squares of the deviation with respect to the desired path, by the
adjoint that `simulate` takes by itself. The first turn has an empty compile cache, and
does not count. The job is the other tree's `paper_small` unless one is named: it must
be valid in both. With this tree for the other one sees the noise. What both found
before a correction is compared number by number, and what they left after it is told.
"""

import argparse
import os
import pathlib
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from typing import NamedTuple

import numpy as np
import xarray

from diffmill.toolpath import ContourStatistics

HERE = pathlib.Path(__file__).parent
COMMANDS = ("simulate", "correct", "gradient")
# What this tree may take of the other's, and the noise of two equal ones.
LIMIT = 1.05
# What may differ, relative to the largest, where sums are in another order.
SAME = 1e-9


class Cost(NamedTuple):
    """What a command took.

    Attributes:
        seconds: Wall clock; of a gradient the call after the one that compiles.
        memory: The largest that the process had [GB].
    """

    seconds: float
    memory: float


def measure(report, other, job, runs, commands):
    """Run commands in both trees by turns; print the ratios of the medians."""
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        if job is None:
            words = ["-m", "diffmill", "example", "paper_small", "--out", str(folder)]
            run(other, folder, words)
            job = folder / "paper_small.toml"
        trees = {"this": HERE.parents[1], "other": other}
        for command in dict.fromkeys(commands):
            costs = {name: [] for name in trees}
            for _ in range(1 + runs):
                for name, tree in trees.items():
                    # No command finds what another one has compiled.
                    place = folder / f"{command}-{name}"
                    place.mkdir(exist_ok=True)
                    costs[name].append(cost(tree, place, command, job))
            report.say(command)
            if command != "gradient":
                first = ", ".join(f"{x[0].seconds:.1f} s" for x in costs.values())
                report.say(f"  empty cache, this tree and the other: {first}")
            for k, what in enumerate(("seconds", "GB")):
                found = [[x[k] for x in each[1:]] for each in costs.values()]
                ours, theirs = (statistics.median(values) for values in found)
                spread = ", ".join(f"{min(x):.3g} to {max(x):.3g}" for x in found)
                report.say(f"  {what}, this tree and the other: {spread}")
                report.figure(f"{command}, ratio of {what}", ours / theirs, LIMIT, "")
            if command != "gradient":
                compare(report, *(folder / f"{command}-{name}" for name in trees))


def compare(report, *folders):
    """Print by how much the results of two trees differ, this one's first."""
    files = [folder / "results" / "result.nc" for folder in folders]
    mine, other = (xarray.load_dataset(file, engine="h5netcdf") for file in files)
    if "case" in mine.dims:
        left = [
            1e6 * rms_where_it_cuts(found.sel(case=found.attrs["corrected_case"]))
            for found in (mine, other)
        ]
        errors = f"{left[0]:.3f} um, {left[1]:.3f} um"
        report.say(f"  corrected path, rms contour error, this and the other: {errors}")
        mine, other = (found.sel(case="uncorrected") for found in (mine, other))
    for name in ("force", "deviation"):
        found, wanted = (np.asarray(each[name]) for each in (mine, other))
        off = np.abs(found - wanted).max() / np.abs(wanted).max()
        what = f"largest difference of {name} before correction"
        report.figure(what, off, SAME, "")


def rms_where_it_cuts(case):
    """Return the rms contour error of the rows that cut [m]."""
    error, is_cutting = (case[key].values for key in ("contour_error", "is_cutting"))
    return ContourStatistics.of(error, is_cutting).rms


def cost(tree, folder, command, job):
    """Return what a command, or a gradient, of a tree costs."""
    if command == "gradient":
        words = [str(HERE / "job_gradient.py"), str(job)]
        return run(tree, folder, words, prints_seconds=True)
    out = folder / "results"
    shutil.rmtree(out, ignore_errors=True)
    return run(tree, folder, ["-m", "diffmill", command, str(job), "--out", str(out)])


def run(tree, folder, words, *, prints_seconds=False):
    """Run Python in a tree; return what it cost."""
    cache = str(folder / "cache")
    settings = {"PYTHONPATH": str(tree / "src"), "JAX_COMPILATION_CACHE_DIR": cache}
    start = time.perf_counter()
    with (folder / "log.txt").open("w+") as log:
        process = subprocess.Popen(
            [sys.executable, *words],
            env={**os.environ, **settings},
            cwd=folder,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        _, status, used = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - start
        log.seek(0)
        text = log.read()
    if status:
        raise SystemExit(f"{' '.join(words)} in {tree} failed:\n{text}")
    if prints_seconds:
        seconds = float(text.split()[-1])
    return Cost(seconds, 1024e-9 * used.ru_maxrss)


if __name__ == "__main__":
    sys.path.append(str(HERE.parent / "common"))
    from reporting import Report, store

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tree", type=pathlib.Path, help="a checkout of the project")
    parser.add_argument("--job", type=pathlib.Path)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=COMMANDS)
    parser.add_argument("--out", type=pathlib.Path, default=HERE / "results")
    chosen = parser.parse_args()
    if chosen.runs < 1:
        parser.error(
            f"argument --runs: found {chosen.runs}, but at least 1 is required"
        )
    if not (chosen.tree / "src" / "diffmill").is_dir():
        parser.error(f"found no src/diffmill in {chosen.tree}")
    report = Report("diffmill performance: against another tree")
    print("\n".join(report.lines), flush=True)
    job = chosen.job and chosen.job.resolve()
    measure(report, chosen.tree.resolve(), job, chosen.runs, chosen.commands)
    store(report, chosen.out, "against")
