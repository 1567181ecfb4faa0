"""Where to put the part, and how to turn the tool: predicted and simulated error.

python experiments/correction/run.py placement
"""

import dataclasses
import time
from typing import Any

import numpy as np

import diffmill as dm
from diffmill.correction import place_workpiece
from small_job import small_job

# How far a part may be moved from where the example has it [m].
SHIFT = [(-0.3, 0.3), (-0.3, 0.3), (-0.3, 0.3)]
TURN = (-np.pi, np.pi)
CASES = {
    "shift": {},
    "shift and turn": {"angle_bounds": TURN},
    "shift, turn, tool": {"angle_bounds": TURN, "rotation_bounds": TURN},
}


def measure(report: Any) -> None:
    """Print the uncorrected error of `paper_small` before and after it is moved."""
    job = small_job()
    solution = dm.simulate(job)
    still, swinging = _rms(_without_inertia(job)), solution.contour.rms
    report.say("paper_small, RV130-like, uncorrected: rms error in um")
    report.say(
        f"{'':18}{'predicted':>10}{'static':>8}{'dynamic':>9}{'x mm':>8}{'y':>8}"
        f"{'z':>8}{'turn deg':>9}{'tool':>8}{'refused':>9}{'s':>6}"
    )
    before = None
    for name, bounds in CASES.items():
        start = time.perf_counter()
        place = place_workpiece(
            job, shift_bounds=SHIFT, force=solution.rigid.force, **bounds
        )
        seconds = time.perf_counter() - start
        if before is None:
            before = (place.rms_before, still, swinging)
            report.say(_figures("the example's", before))
        moved = place.moved(job)
        after = (place.rms_after, _rms(_without_inertia(moved)), _rms(moved))
        numbers = [*1e3 * place.shift, *np.rad2deg([place.angle, place.rotation])]
        report.say(
            _figures(name, after)
            + "".join(
                f"{number:{width}.1f}"
                for number, width in zip(numbers, (8, 8, 8, 9, 8), strict=True)
            )
            + f"{place.refused:4d} / {place.searched:2d}{seconds:6.1f}"
        )
        report.say(place.toml)
        predicted, static, dynamic = (b / a for a, b in zip(before, after, strict=True))
        report.figure(
            "static error that is left, off the predicted share by",
            100 * abs(static / predicted - 1),
            5,
        )
        report.figure(
            "dynamic error that is left, over the predicted share",
            dynamic / predicted,
            1.05,
            "",
        )


def _figures(name: str, errors: tuple[float, float, float]) -> str:
    predicted, static, dynamic = (1e6 * error for error in errors)
    return f"{name:18}{predicted:10.2f}{static:8.2f}{dynamic:9.2f}"


def _without_inertia(job: dm.Job) -> dm.Job:
    """Return a job whose springs balance the mean force of each tooth period."""
    settings = dataclasses.replace(job.simulation, mode="quasistatic")
    return dataclasses.replace(job, simulation=settings)


def _rms(job: dm.Job) -> float:
    return dm.simulate(job).contour.rms


if __name__ == "__main__":
    raise SystemExit("python experiments/correction/run.py placement")
