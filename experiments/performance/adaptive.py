"""Steady stretches: what `[simulation] resolution = "adaptive"` saves and costs.

python experiments/performance/run.py adaptive

Both runs of `simulate`, the rigid cut and the robot's, at every tooth and adaptive, in
one process; the second of two calls counts, since the first one compiles.
"""

import dataclasses
import pathlib
import tempfile
import time

import jax
import numpy as np

import diffmill as dm
from diffmill.examples import copy_example
from long import write_job

jax.config.update("jax_enable_x64", True)

# Tooth periods of the zig-zag, and its ray spacings.
ROWS, SPACINGS = 8000, ("0.5 mm", "0.2 mm")
# Depths of a slot: one in which the cut is calm, one in which it chatters.
SLOTS = {"calm slot": -1.0, "slot that chatters": -4.0}
# To reach: ratio of the processor times; deviation at 99 % of the rows, amplitude and
# removed volume [%].
RATIO, DEVIATION, AMPLITUDE, VOLUME = 2.0, 1.0, 10.0, 0.1
# Where the full run is off one of twice its sub-steps by more than this [%], one and a
# half times that is allowed.
AGREES = 0.2


def measure(report):
    """Print times and differences."""
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        for spacing in SPACINGS:
            file = write_job(folder, ROWS)
            text = file.read_text(encoding="utf-8").replace('"0.5 mm"', f'"{spacing}"')
            file.write_text(text, encoding="utf-8")
            compare(report, f"zig-zag, {spacing}", dm.load_job(file))
        for title, depth in SLOTS.items():
            compare(report, title, dm.load_job(slot(folder, depth)))
        compare(report, "paper_small", dm.load_job(copy_example("paper_small", folder)))


def slot(folder, depth):
    """Write a job of a straight slot; return its file."""
    file = copy_example("paper_small", folder, force=True)
    text = file.read_text(encoding="utf-8").replace('"17 mm"', '"20 mm"')
    text = text.replace('"42 mm"', '"100 mm"').replace("paper_small.ngc", "slot.ngc")
    file.write_text(text, encoding="utf-8")
    lines = ["G21 G17 G90 G94", "T1 M6 S8000 M3", "G0 X-6 Y10 Z1", f"G0 Z{depth:g}"]
    (folder / "slot.ngc").write_text("\n".join([*lines, "G1 X80 F3000", "M5", "M2"]))
    return file


def compare(report, title, job):
    """Print what the adaptive run of a job saves and costs."""
    adaptive = dataclasses.replace(job.simulation, resolution="adaptive")
    full, seconds = timed(job)
    held, shorter = timed(dataclasses.replace(job, simulation=adaptive))
    is_cut = np.asarray(full.is_cutting)
    deviation = np.asarray(full.deviation)[is_cut]
    off = np.linalg.norm(np.asarray(held.actual - full.actual)[is_cut], axis=1)
    size = np.sqrt(np.mean(np.sum(deviation**2, axis=1)))
    force = np.linalg.norm(np.asarray(full.force)[is_cut], axis=1)
    error = np.linalg.norm(np.asarray(held.force - full.force)[is_cut], axis=1)
    assert held.is_look is not None
    expected = np.sqrt(np.mean(np.asarray(held.held_force_error)[is_cut] ** 2))
    surface = np.asarray(held.surface_deviation - full.surface_deviation)[is_cut]
    report.say(
        f"{title}: {is_cut.size} rows, the stock looked up in "
        f"{100 * np.mean(held.is_look):.0f} %; deviation {1e6 * size:.1f} um rms, off "
        f"by {100 * np.sqrt(np.mean(off**2)) / size:.2f} % rms; force "
        f"{np.percentile(force, 95):.0f} N, off by {np.sqrt(np.mean(error**2)):.2f} N "
        f"rms ({expected:.2f} N expected); surface off by "
        f"{1e6 * np.sqrt(np.mean(surface**2)):.2f} um rms"
    )
    volume = float(np.sum(held.removed_volume)) / float(np.sum(full.removed_volume))
    report.at_least("times faster", seconds / shorter, RATIO, "x")
    own = finer(job, full, is_cut) / size
    allowed = DEVIATION if 100 * own < AGREES else max(DEVIATION, 150 * own)
    report.say(f"  the full run less one of twice its sub-steps: {100 * own:.2f} %")
    last = 100 * np.percentile(off, 99) / size
    report.figure("deviation at 99 % of the rows", last, allowed, "%")
    rest = slice(off.size // 2, None)
    swing = [
        np.std(np.asarray(x.deviation)[is_cut][rest], axis=0) for x in (full, held)
    ]
    change = np.linalg.norm(swing[1]) / np.linalg.norm(swing[0]) - 1
    report.figure("amplitude in the second half", 100 * abs(change), AMPLITUDE, "%")
    report.figure("removed volume", 100 * abs(volume - 1), VOLUME, "%")


def finer(job, full, is_cut):
    """Difference of a run from one of twice its sub-steps, at 99 % of rows [m]."""
    substeps = 2 * job.simulation.substeps
    block = substeps * job.cutter.flute_count
    angles = -(-job.simulation.angles // block) * block
    simulation = dataclasses.replace(job.simulation, substeps=substeps, angles=angles)
    twice = dm.simulate(dataclasses.replace(job, simulation=simulation))
    off = np.asarray(twice.actual - full.actual)[is_cut]
    return np.percentile(np.linalg.norm(off, axis=1), 99)


def timed(job):
    """Solution of a job, and the processor time of the second of two runs [s]."""
    dm.simulate(job)
    start = time.process_time()
    solution = dm.simulate(job)
    solution.actual.block_until_ready()
    return solution, time.process_time() - start
