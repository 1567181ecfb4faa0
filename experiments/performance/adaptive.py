"""Adaptive engagement updates: what they save and cost in `simulate`.

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
SLOTS = {"calm slot": -0.4, "slot that chatters": -1.0}
# To reach: ratio of the processor times; deviation at 99 % of the rows, amplitude and
# removed volume [%]; surface [um].
RATIO, DEVIATION, AMPLITUDE, VOLUME, SURFACE = 2.0, 1.0, 10.0, 0.1, 1.0
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
    assert held.is_engagement_update is not None
    expected = np.sqrt(np.mean(np.asarray(held.engagement_force_error)[is_cut] ** 2))
    surface = np.asarray(held.surface_deviation - full.surface_deviation)[is_cut]
    report.say(
        f"{title}: {is_cut.size} rows, {1e6 * seconds / is_cut.size:.0f} us a row, "
        f"adaptive {1e6 * shorter / is_cut.size:.0f} us; engagement updates in "
        f"{100 * np.mean(held.is_engagement_update):.0f} %; deviation "
        f"{1e6 * size:.1f} um rms, off "
        f"by {100 * np.sqrt(np.mean(off**2)) / size:.2f} % rms; force "
        f"{np.percentile(force, 95):.0f} N, off by {np.sqrt(np.mean(error**2)):.2f} N "
        f"rms ({expected:.2f} N expected)"
    )
    volume = float(np.sum(held.removed_volume)) / float(np.sum(full.removed_volume))
    report.at_least("times faster", seconds / shorter, RATIO, "x")
    twice = finer(job)
    own = np.linalg.norm(np.asarray(twice.actual - full.actual)[is_cut], axis=1)
    own = 100 * np.percentile(own, 99) / size
    allowed = DEVIATION if own < AGREES else max(DEVIATION, 1.5 * own)
    report.say(f"  the full run less one of twice its sub-steps: {own:.2f} %")
    last = 100 * np.percentile(off, 99) / size
    report.figure("deviation at 99 % of the rows", last, allowed, "%")
    swings = [swing(run, is_cut) for run in (full, held, twice)]
    change, other = (100 * abs(x / swings[0] - 1) for x in swings[1:])
    allowed = max(AMPLITUDE, 1.5 * other)
    report.figure("amplitude in the second half", change, allowed, "%")
    report.figure("removed volume", 100 * abs(volume - 1), VOLUME, "%")
    rms = 1e6 * np.sqrt(np.mean(np.sum(surface**2, axis=1)))
    report.figure("machined surface, rms", rms, SURFACE, "um")


def finer(job):
    """Solution of a job with twice its sub-steps."""
    substeps = 2 * job.simulation.substeps
    block = substeps * job.cutter.flute_count
    angles = -(-job.simulation.angles // block) * block
    simulation = dataclasses.replace(job.simulation, substeps=substeps, angles=angles)
    return dm.simulate(dataclasses.replace(job, simulation=simulation))


def swing(run, is_cut):
    """Standard deviation of the deviation in the second half of a cut [m]."""
    deviation = np.asarray(run.deviation)[is_cut]
    return np.linalg.norm(np.std(deviation[len(deviation) // 2 :], axis=0))


def timed(job):
    """Solution of a job, and the processor time of the second of two runs [s]."""
    dm.simulate(job)
    start = time.process_time()
    solution = dm.simulate(job)
    solution.actual.block_until_ready()
    return solution, time.process_time() - start
