"""Where a command spends processor time, from an empty compile cache and once more.

python experiments/performance/second.py COMMAND JOB.toml [...]

runs a command of diffmill and prints, as JSON on its last line, the seconds of its
phases: what the thread took that ran them, not what others computed, compiled or
imported meanwhile. The group of `run.py` does so in processes of their own, whose
processor time includes all threads and all processes that they started.
"""

import functools
import importlib
import json
import os
import pathlib
import resource
import subprocess
import sys
import tempfile
import time
from typing import Any

# Command, example, and the processor time to reach in the second process [s].
COMMANDS = (("simulate", "paper_small", 3.5), ("correct", "paper", 12.0))
# Phases, and the functions of the package that run them.
PHASES = {
    "reading the job": ("config.check_tables", "config.load_job"),
    "run": ("sim.simulate", "correction.correct"),
    "results": ("io.write_results",),
    "stability": ("sim.Stability.where_suspected",),
    "other machines": ("sim.mismatch", "sim.TrueErrors.of_commands"),
    "forces, chips and surfaces of figures": ("viz.figure_inputs",),
    "figures": ("viz.write_figures",),
    "report": ("viz.write_report",),
}


def measure(report):
    """Run each command with an empty and a filled cache, and print its phases."""
    for command, example, limit in COMMANDS:
        with tempfile.TemporaryDirectory() as name:
            words = ["-m", "diffmill", "example", example, "--out", name]
            cost([sys.executable, *words], {})
            cache = {"JAX_COMPILATION_CACHE_DIR": str(pathlib.Path(name, "cache"))}
            job = str(pathlib.Path(name, f"{example}.toml"))
            for words in ("empty cache", "second process"):
                out = str(pathlib.Path(name, words.replace(" ", "-")))
                line = [sys.executable, __file__, command, job, "--out", out]
                spent, text = cost(line, cache)
                report.say(f"{command} {example}, {words}: {spent:.1f} processor s")
                for phase, seconds in json.loads(text.splitlines()[-1]).items():
                    report.say(f"  {phase:62} {seconds:10.2f} s")
            what = f"processor time of the second {command} {example}"
            report.figure(what, spent, limit, "s")


def cost(line, settings):
    """Return the processor time of a process and its children [s], and its output."""
    environment = {**os.environ, **settings}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        line, env=environment, check=True, stdout=subprocess.PIPE, text=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return spent, done.stdout


def tell_phases():
    """Run the command of this process, and print the seconds of its phases."""
    seconds = {"imports": 0.0} | dict.fromkeys(PHASES, 0.0)

    def timed(function, phase):
        @functools.wraps(function)
        def call(*args, **options):
            start = time.thread_time()
            try:
                return function(*args, **options)
            finally:
                seconds[phase] += time.thread_time() - start

        return call

    for phase, names in PHASES.items():
        for name in names:
            package, *path = name.split(".")
            owner = importlib.import_module(f"diffmill.{package}")
            for part in path[:-1]:
                owner = getattr(owner, part)
            setattr(owner, path[-1], timed(getattr(owner, path[-1]), phase))
    process: Any = importlib.import_module("diffmill.__main__")
    run_command = process.main

    def main():
        seconds["imports"] = time.thread_time()
        code = run_command()
        print(json.dumps(seconds | {"all threads": time.process_time()}))
        return code

    process.main = main
    process.run()


if __name__ == "__main__":
    tell_phases()
