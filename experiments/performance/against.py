"""Time and memory of commands and of a gradient, against another tree of the project.

python experiments/performance/against.py TREE [--job FILE] [--runs 3] [--out FOLDER]

Both trees run a job by turns, in processes of their own that see nothing else of each
other: `simulate`, `correct`, and the gradient of the summed squares of the deviation
with respect to the desired path. The first turn fills the caches and is told apart. The
job is the other tree's `paper_small` unless one is named: it must be valid in both.
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

HERE = pathlib.Path(__file__).parent
HERE_TREE = HERE.parents[1]
COMMANDS = ("simulate", "correct", "gradient")
# What this tree may take of the other's.
LIMIT = 1.0


class Cost(NamedTuple):
    """What a command took.

    Attributes:
        seconds: Wall clock; of a gradient the call after the one that compiles.
        bytes: The largest memory that the process had.
    """

    seconds: float
    bytes: float


def measure(report, other, job, runs):
    """Run each command in both trees by turns; print the ratios of the medians."""
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        if job is None:
            words = ["-m", "diffmill", "example", "paper_small", "--out", str(folder)]
            run(other, folder, words)
            job = folder / "paper_small.toml"
        for command in COMMANDS:
            costs = {tree: [] for tree in (HERE_TREE, other)}
            for _ in range(1 + runs):
                for tree, found in costs.items():
                    found.append(cost(tree, folder, command, job))
            ours, theirs = costs.values()
            report.say(f"{command}: this tree, the other")
            report.say(
                f"  first, caches empty: {ours[0].seconds:.1f} s, "
                f"{theirs[0].seconds:.1f} s"
            )
            for k, what, unit in ((0, "seconds", 1), (1, "memory in GB", 1e9)):
                here, there = (
                    statistics.median(x[k] for x in found[1:]) / unit
                    for found in (ours, theirs)
                )
                report.say(f"  {what}, then: {here:.3g}, {there:.3g}")
                report.figure(f"{command}, ratio of {what}", here / there, LIMIT, "")


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
    cache = folder / ("cache-here" if tree == HERE_TREE else "cache-other")
    settings = {
        "PYTHONPATH": str(tree / "src"),
        "JAX_COMPILATION_CACHE_DIR": str(cache),
    }
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
    return Cost(seconds, 1024.0 * used.ru_maxrss)


if __name__ == "__main__":
    sys.path.append(str(HERE.parent / "common"))
    from reporting import Report, store

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tree", type=pathlib.Path, help="a checkout of the project")
    parser.add_argument("--job", type=pathlib.Path)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--out", type=pathlib.Path, default=HERE / "results")
    chosen = parser.parse_args()
    if not (chosen.tree / "src" / "diffmill").is_dir():
        parser.error(f"found no src/diffmill in {chosen.tree}")
    report = Report("diffmill performance: against another tree")
    job = chosen.job and chosen.job.resolve()
    measure(report, chosen.tree.resolve(), job, chosen.runs)
    store(report, chosen.out, "against")
