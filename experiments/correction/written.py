"""Blocks of the corrected program, and the error that it leaves when it is run.

python experiments/correction/written.py [--example paper] [--controller NAME]
    [--tolerances 1 2 5] [--formats] [--out FOLDER]
"""

import argparse
import pathlib
import sys
import tempfile
from typing import Any

import numpy as np
import xarray

import diffmill as dm
from controller import controlled_job, write_controlled_job
from diffmill import io
from diffmill.cli import main
from diffmill.process import ThroughPoses
from diffmill.toolpath import (
    ContourStatistics,
    Path,
    Program,
    reduce_path,
    sample_program,
)

TOLERANCES = (1.0, 2.0, 5.0)
# Blocks of `paper` at 5 um, and how much more than the command a program may leave.
MOST_BLOCKS = {"lines": 800, "spline": 400}
MOST_ERROR = 1.2
FORMATS = """
[output]
formats = ["gcode", "krl", "rapid"]
stream_cycle = "4 ms"
moved_ends = true
"""
RESULTS = pathlib.Path(__file__).parent / "results"


def measure(
    report: Any,
    example: str = "paper",
    controller: str = "ideal",
    tolerances: tuple[float, ...] = TOLERANCES,
) -> None:
    """Print blocks and error of lines and splines within some tolerances [um]."""
    job = controlled_job(example, f'preset = "{controller}"', "30 ms")
    found = dm.correct(job)
    is_cutting = np.asarray(found.after.is_cutting)
    own = _rms(found.after, is_cutting)
    rows = job.path.step_count - 1
    report.say(f"{example}, controller {controller}: {rows} rows, corrected to")
    report.say(f"{1e6 * own:.3f} um rms; written as KRL, read back and run:")
    report.say(f"{'':10}{'tolerance':>10}{'blocks':>8}{'furthest':>10}{'rms':>8}  um")
    path = Path(
        job.path.time,
        np.asarray(found.commanded),
        job.path.axes,
        job.path.is_rapid,
        job.path.line,
    )
    for curve in ("lines", "spline"):
        for tolerance in tolerances:
            few = reduce_path(path, 1e-6 * tolerance, is_spline=curve == "spline")
            commanded = _read_back(few, path, curve == "spline")
            gap = np.linalg.norm(commanded - path.positions, axis=1).max()
            run = dm.simulate(job, commanded=commanded, adjoint=ThroughPoses())
            rms = _rms(run, is_cutting)
            blocks = few.step_count - 1
            report.say(
                f"{curve:10}{tolerance:10g}{blocks:8}{1e6 * gap:10.2f}{1e6 * rms:8.3f}"
            )
            name = f"{curve} at {tolerance:g} um"
            report.figure(
                f"{name}: rms over that of the command", rms / own, MOST_ERROR, ""
            )
            if example == "paper" and tolerance == 5:
                report.figure(f"{name}: blocks", blocks, MOST_BLOCKS[curve], "")


def measure_formats(report: Any, example: str, controller: str) -> None:
    """Print the error that each file leaves, as `diffmill correct` states it."""
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        file = write_controlled_job(
            folder, example, f'preset = "{controller}"', "30 ms", FORMATS
        )
        out = folder / "out"
        done = main(["correct", str(file), "--out", str(out), "--quiet"])
        report.require("the command ends well", done == 0)
        with xarray.open_dataset(out / "result.nc", engine="h5netcdf") as kept:
            found = {str(key): value for key, value in kept.attrs.items()}
            error = kept.sel(case="corrected").load()
    own = ContourStatistics.of(error.contour_error.values, error.is_cutting.values).rms
    report.say(
        f"{example}, controller {controller}: the command leaves {1e6 * own:.3f}"
    )
    report.say("um rms; each file within 1 um, read back and run, over that:")
    for key, text in (
        ("written_rms_ngc", "G-code, lines"),
        ("written_rms_src", "KRL, lines"),
        ("written_rms_mod", "RAPID, lines"),
        ("stream_rms_csv", "stream of a cycle of 4 ms"),
    ):
        report.figure(text, float(found[key]) / own, MOST_ERROR, "")
    report.say(
        f"the program with its own blocks: {1e6 * found['moved_rms_ngc']:.2f} um"
    )


def _read_back(few: Path, path: Path, is_spline: bool) -> np.ndarray:
    """Return the positions at the rows of a path that a written file makes."""
    with tempfile.TemporaryDirectory() as folder:
        file = pathlib.Path(folder) / "part.src"
        file.write_text(io.write_program(few, ".src", is_spline=is_spline))
        program = io.read_program(file)
    assert isinstance(program, Program)
    time = np.asarray(path.time)
    back = sample_program(
        program, time[1], acceleration=1.0, rapid_feed=1.0, corner_tolerance=0.0
    )
    rows = np.minimum(np.arange(time.size), back.step_count - 1)
    return np.asarray(back.positions)[rows]


def _rms(solution: dm.Solution, is_cutting: np.ndarray) -> float:
    """Return the rms contour error where the tool cuts [m]."""
    return ContourStatistics.of(solution.contour_error, is_cutting).rms


if __name__ == "__main__":
    import jax

    jax.config.update("jax_enable_x64", True)
    dm.use_compile_cache()
    sys.path.append(str(pathlib.Path(__file__).parents[1] / "common"))
    from reporting import Report, store

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--example", default="paper")
    parser.add_argument("--controller", default="ideal")
    parser.add_argument("--tolerances", type=float, nargs="*", default=TOLERANCES)
    parser.add_argument("--formats", action="store_true", help="every format instead")
    parser.add_argument("--out", type=pathlib.Path, default=RESULTS)
    given = parser.parse_args()
    name = f"{given.example}_{given.controller}"
    result = Report(f"diffmill correction: written programs, {name}")
    if given.formats:
        measure_formats(result, given.example, given.controller)
    else:
        measure(result, given.example, given.controller, tuple(given.tolerances))
    store(result, given.out, f"{'formats' if given.formats else 'written'}_{name}")
