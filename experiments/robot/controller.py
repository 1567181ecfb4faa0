"""What a controller loses: in single precision on a long path, and behind a staircase.

Motors of 100,000 rows in both precisions, as a whole and in pieces; servos behind held
set points against the exponential from jump to jump.
"""

import itertools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffmill.robot import Controller

STEP, ROWS, PIECE = 3.75e-3, 100_000, 2000
SERVOS: dict[str, Any] = {"bandwidth": np.array([10.0, 4.0]), "damping_ratio": 0.7}
FILTERS: dict[str, Any] = {
    "moving_average": 50e-3,
    "shaper_frequency": 10.0,
    "shaper_damping_ratio": 0.05,
    "dead_time": 8e-3,
    "low_pass": 20.0,
}
CASES: dict[str, dict[str, Any]] = {
    "average": {"moving_average": 48e-3},
    "spline": {"interpolation_cycle": 4e-3},
    "held, servos": {
        "interpolation_cycle": 7.3e-3,
        "interpolation": "hold",
        **SERVOS,
    },
    "all": {"interpolation_cycle": 12e-3, **FILTERS, **SERVOS},
}


def measure(report: Any) -> None:
    """Print both tables."""
    report.say(f"single precision, {ROWS} rows, largest difference [urad]")
    report.say(f"{'':16}{'from double':>14}{'pieces from whole':>20}")
    time = STEP * np.arange(ROWS)
    rows = (0.8 + 0.15 * np.sin([0.86, 7.0] * time[:, None])).astype(np.float32)
    for name, parts in CASES.items():
        with jax.enable_x64(True):
            wanted = _motors(Controller(**parts), jnp.asarray(rows, float))
        with jax.enable_x64(False):
            single = jnp.asarray(rows)
            found = _motors(Controller(**parts), single)
            pieces = _in_pieces(Controller(**parts), single)
        off = 1e6 * np.abs(found - wanted).max()
        apart = 1e6 * np.abs(pieces - found).max()
        report.say(f"{name:16}{off:14.3f}{apart:20.3f}")
    report.say("servos of first order behind held set points, rms error [urad]")
    with jax.enable_x64(True):
        for cycle, bandwidth in itertools.product((12e-3, 0.3e-3), (4.0, 10.0, 30.0)):
            off = 1e6 * _staircase_error(cycle, bandwidth)
            report.say(f"{1e3 * cycle:5g} ms {bandwidth:5g} Hz {off:10.4f}")


def _motors(controller: Controller, rows: jax.Array) -> np.ndarray:
    return np.asarray(controller.motors(rows, STEP))


def _in_pieces(controller: Controller, rows: jax.Array) -> np.ndarray:
    """Return the motors of a path that is gone through piece by piece."""
    before, ahead = controller.span(STEP)
    state, found = controller.begin(rows[: ahead + 1], STEP, before, ahead), []
    follow = eqx.filter_jit(lambda x, state: controller.follow(x, STEP, state))
    for first in range(0, ROWS, PIECE):
        at = np.minimum(np.arange(first, first + PIECE + 1 + ahead), ROWS - 1)
        piece, state = follow(rows[at], state)
        found.append(np.asarray(piece)[:-1])
    return np.concatenate(found)[:ROWS]


def _staircase_error(cycle: float, bandwidth: float) -> float:
    """Return the rms error of a servo behind held set points [rad]."""
    time, w = STEP * np.arange(800), 2 * np.pi * bandwidth
    rows = 0.3 * np.sin(2 * np.pi * time / 1.3) * np.minimum(time / 0.3, 1)
    held = Controller(
        interpolation_cycle=cycle, interpolation="hold", bandwidth=bandwidth
    )
    found = np.asarray(held.respond(jnp.asarray(rows)[:, None], STEP))[:, 0]
    jumps = cycle * np.arange(int(time[-1] / cycle) + 1)
    ends = np.unique(np.concatenate([time, jumps]).round(12))
    y, exact = 0.0, {0.0: 0.0}
    for start, end in itertools.pairwise(ends):
        u = np.interp(cycle * np.floor(start / cycle + 1e-6), time, rows)
        y = exact[end] = u + (y - u) * np.exp(-w * (end - start))
    wanted = np.array([exact[t] for t in time.round(12)])
    return float(np.sqrt(np.mean((found - wanted) ** 2)))
