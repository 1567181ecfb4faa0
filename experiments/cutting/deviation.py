"""Derivatives of the deviation against the run over steps of micrometres.

A weighted sum of the tip's deviation is followed along smooth random directions of the
command, as `slopes.py` does with the forces, on a short path of the example's kind.
"""

import pathlib
import tempfile
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from diffmill import examples
from reporting import Report
from slopes import DIRECTIONS, compare, smooth

STEPS = (1e-6, 10e-6)
# Into the stock, along a wall and round a corner; the depths are not those of the rays.
PROGRAM = """G21 G17 G90 G94
G0 X-6.5 Y4.3 Z1
G0 Z{0}
G1 X2.7 Y4.9 Z{1} F3000
G1 X2.1 Y8 Z{0}
M2
"""
FALLING, LEVEL = (-0.93, -1.07), (-1.0, -1.0)
SPRING = """
[robot.flange_spring]
rotary_stiffness = ["2e6 N*m/rad", "2e6 N*m/rad", "2e6 N*m/rad"]
mass = "20 kg"
center_of_mass = ["0 mm", "0 mm", "100 mm"]
inertia = ["0.3 kg*m^2", "0.3 kg*m^2", "0.1 kg*m^2"]
"""
BENDING = """
[robot.bending_tool]
overhang = "40 mm"
"""
CASES = {
    "plain arm": (FALLING, ""),
    "flange spring": (FALLING, SPRING),
    "bending tool": (FALLING, BENDING),
    "constant z": (LEVEL, ""),
}


def measure(report: Report) -> None:
    """Measure every case along every direction."""
    report.say()
    report.say(
        "Integral of the derivative of the deviation over its rise, and slope in"
    )
    report.say("the middle over the mean slope, both less 1 [%], by half the step")
    names = "".join(f"{1e6 * a:>12.0f} um   " for a in STEPS)
    report.say(f"  {'case':28}{names}")
    for name, (depths, more) in CASES.items():
        job = _job(depths, more)
        for seed in DIRECTIONS:
            rows = compare(_scalar(job, seed), STEPS)
            cells = "".join(f"{i:8.2f}{s:8.2f} " for i, s in rows)
            report.say(f"  {f'{name}, {seed}':28}{cells}")
            integral, slope = rows[-1]
            report.figure(f"{name}, {seed}: integral, 10 um", abs(integral), 3.0)
            report.figure(f"{name}, {seed}: slope, 10 um", abs(slope), 3.0)


def _job(depths: tuple[float, float], more: str) -> dm.Job:
    """Return the example with a short program and more tables."""
    with tempfile.TemporaryDirectory() as folder:
        file = examples.copy_example("paper_small", pathlib.Path(folder))
        (file.parent / "paper_small.ngc").write_text(PROGRAM.format(*depths))
        text = file.read_text().replace("0.5 m/s^2", "2 m/s^2")
        file.write_text(text.replace("100 ms", "10 ms") + more)
        return dm.load_job(file)


def _scalar(job: dm.Job, seed: int) -> Callable[[jax.Array], jax.Array]:
    """Return a weighted mean of the deviation along a smooth direction [m]."""
    rng = np.random.default_rng(seed)
    rows = job.path.step_count
    direction, weights = (jnp.asarray(smooth(rng, rows)) for _ in range(2))
    desired = jnp.asarray(job.path.positions)

    def scalar(s: jax.Array) -> jax.Array:
        command = desired + s * direction
        found = dm.simulate(job, commanded=command, throw=False)
        return jnp.mean(weights * found.deviation)

    return scalar
