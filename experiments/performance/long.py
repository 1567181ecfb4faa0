"""Time and memory of `simulate` on long programs: zig-zags with pockets.

python experiments/performance/long.py [--rows 20000 80000] [--adaptive] [--keep FOLDER]

A command runs twice in a process of its own; the second one counts, since the first one
compiles. `--adaptive` lets tooth periods share engagement updates, `--keep` leaves
jobs, results and compiled programs in a folder.
"""

import argparse
import contextlib
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time

from diffmill.examples import copy_example

ROWS = (20_000, 80_000)
# A pass of the zig-zag, the pockets behind it, and their distances [mm].
LENGTH, PASS, POCKET, DEEPER = 200, 3.0, 20, 1.0
# Tooth periods of a pass with the step beside it, and of a pocket.
PASS_ROWS, POCKET_ROWS = 1190, 1120
# Every so many passes a pocket is cut.
POCKET_EVERY = 4
# To reach, per tooth period and in all.
MILLISECONDS, MEGABYTES = 0.28, 1200
# Within which factor `check` foretells the memory.
FORETOLD = 1.5


def measure(report):
    """Print what `simulate` takes for the smaller number of rows."""
    with tempfile.TemporaryDirectory() as folder:
        measure_rows(report, ROWS[:1], pathlib.Path(folder))


def measure_rows(report, counts, folder, resolution="every tooth"):
    """Print time, processor time and peak memory for paths of about so many rows."""
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(folder / "cache")}
    report.say(f"{'rows':>8} {'s':>8} {'processor s':>12} {'MB':>7}")
    spent = {}
    for count in counts:
        job, out = write_job(folder, count, resolution), folder / f"long{count}-out"
        command = [sys.executable, "-m", "diffmill", "simulate", str(job)]
        command += ["--out", str(out), "--force"]
        run(command, environment)
        wall, processor, memory = run(command, environment)
        rows, expected = foretold(job, environment)
        spent[rows] = processor
        report.say(f"{rows:8d} {wall:8.1f} {processor:12.1f} {memory:7.0f}")
        report.figure(f"peak memory of {rows} rows", memory, MEGABYTES, "MB")
        ratio = max(memory / expected, expected / memory)
        report.figure("to what `check` expects, or the inverse", ratio, FORETOLD, "x")
    if len(spent) > 1:
        (first, less), *_, (last, more) = sorted(spent.items())
        each = 1e3 * (more - less) / (last - first)
        report.figure("processor time of a further row", each, MILLISECONDS, "ms")


def write_job(folder, rows, resolution="every tooth"):
    """Write a job of about so many rows; return its file.

    Args:
        folder: The folder.
        rows: Tooth periods of its path.
        resolution: Key of its simulation.
    """
    passes = max(1, round(rows / (PASS_ROWS + POCKET_ROWS / POCKET_EVERY)))
    width, name = max(30.0, PASS * passes + 6), f"long{rows}"
    text = copy_example("paper_small", folder, force=True).read_text(encoding="utf-8")
    changes = {
        '"42 mm", "17 mm"': f'"{LENGTH} mm", "{width:g} mm"',
        'spacing = "0.2 mm"': 'spacing = "0.5 mm"',
        "paper_small.ngc": f"{name}.ngc",
        "[simulation]": f'[simulation]\nresolution = "{resolution}"',
        '"1514 mm", "-8.5 mm"': f'"{1535 - LENGTH / 2:g} mm", "{-width / 2:g} mm"',
    }
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    file = folder / f"{name}.toml"
    file.write_text(text, encoding="utf-8")
    lines = ["%", "G21 G17 G90 G94", "T1 M6 S8000 M3", "G0 X-6 Y0 Z1", "G0 Z-1"]
    for k in range(passes):
        far, y = (LENGTH + 6, -6)[k % 2], PASS * k
        lines += [f"G1 X{far} Y{y:g} F3000", f"G1 X{far} Y{y + PASS:g}"]
        if k % POCKET_EVERY == POCKET_EVERY - 1:
            lines += pocket(LENGTH / 2, y, back=(far, y + PASS))
    (folder / f"{name}.ngc").write_text("\n".join([*lines, "G0 Z1", "M5", "M2", "%"]))
    return file


def pocket(x, y, *, back):
    """Return the blocks of a square pocket on the cut floor, and of the way back."""
    half, z = POCKET / 2, -1 - DEEPER
    corners = [(x + half, y - half), (x + half, y), (x - half, y), (x - half, y - half)]
    start = x - half, y - half
    return [
        "G0 Z1",
        f"G0 X{start[0]:g} Y{start[1]:g}",
        # Along a ramp, which a cutter that is ground hollow can go.
        f"G1 Z-1 F3000\nG1 X{x + half:g} Z{z:g} F1500",
        *(f"G1 X{a:g} Y{b:g} F3000" for a, b in corners),
        f"G1 X{x + half:g}",
        "G0 Z1",
        f"G0 X{back[0]:g} Y{back[1]:g}",
        "G0 Z-1",
    ]


def run(command, environment):
    """Return wall and processor seconds and peak megabytes of a command."""
    start = time.perf_counter()
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with {process.returncode}")
    wall, processor = time.perf_counter() - start, usage.ru_utime + usage.ru_stime
    return wall, processor, usage.ru_maxrss / 1024


def foretold(job, environment):
    """Return the number of tooth periods of a job, and its expected memory [MB]."""
    command = [sys.executable, "-m", "diffmill", "check", str(job)]
    said = subprocess.run(command, env=environment, capture_output=True, text=True)
    found = re.search(r"path: (\d+) tooth periods", said.stdout)
    memory = re.search(r"simulate about [^;]*, ([\d.]+) GB", said.stdout)
    assert found and memory, said.stdout + said.stderr
    return int(found[1]), 1e3 * float(memory[1])


if __name__ == "__main__":
    sys.path.append(str(pathlib.Path(__file__).parents[1] / "common"))
    from reporting import Report

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", nargs="+", type=int, default=ROWS)
    parser.add_argument("--adaptive", action="store_true")
    parser.add_argument("--keep", type=pathlib.Path)
    options = parser.parse_args()
    kept = options.keep and contextlib.nullcontext(options.keep)
    with kept or tempfile.TemporaryDirectory() as name:
        path = pathlib.Path(name)
        path.mkdir(parents=True, exist_ok=True)
        resolution = "adaptive" if options.adaptive else "every tooth"
        report = Report("diffmill simulate, long paths")
        measure_rows(report, options.rows, path, resolution)
