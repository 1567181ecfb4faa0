"""What a person waits for: commands from an empty compile cache, then once more.

Bytecode of Python's sources is written first, as an installation does.
"""

import os
import pathlib
import resource
import subprocess
import sys
import tempfile
import time

import xarray

from diffmill.examples import copy_example

# Command, example, and the seconds of wall clock to reach: first, second process.
COMMANDS = (
    ("simulate", "paper_small", 20, 3.5),
    ("correct", "tiny", 20, 10),
    ("correct", "paper", 38, 12),
)
# Runs of the machine that the optimiser may take, beside one of the inverse drive.
RUNS = 20


def measure(report):
    """Run each command in a process of its own, with an empty and a filled cache."""
    run(["--version"], {})
    for command, example, cold, warm in COMMANDS:
        with tempfile.TemporaryDirectory() as name:
            folder = pathlib.Path(name)
            job = copy_example(example, folder)
            cache = {"JAX_COMPILATION_CACHE_DIR": str(folder / "cache")}
            for words, limit in (("empty cache", cold), ("second process", warm)):
                out = folder / words.replace(" ", "-")
                wall, processor = run([command, str(job), "--out", str(out)], cache)
                what = f"{command} {example}, {words} ({processor:.0f} processor s)"
                report.figure(what, wall, limit, "s")
            if (command, example) == ("correct", "paper"):
                with xarray.open_dataset(out / "result.nc", engine="h5netcdf") as found:
                    spent = found.attrs["corrected_wall_time_s"]
                    one = found.attrs["inverse_drive_wall_time_s"]
                report.figure("optimiser of paper, in runs", spent / one, RUNS, "runs")


def run(arguments, settings):
    """Return the wall and processor seconds of a command."""
    environment = {**os.environ, **settings}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    command = [sys.executable, "-m", "diffmill", *arguments]
    subprocess.run(command, env=environment, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - start, spent
