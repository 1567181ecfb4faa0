"""Derivatives against the function over steps of micrometres, in six regimes.

A scalar of the forces is followed along smooth random directions of the path. What it
rises by from -a to +a stands beside the integral of its derivative, which shows jumps,
and beside its slope in the middle, which shows roughness.
"""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from cuts import ALONG, FEED, LAW, RADIUS, SLOTS, SPACING, SPINDLE_SPEED, mill
from reporting import Report

ROWS, DEPTH = 60, 1.03e-3
DIRECTIONS = (1, 2)
STEPS = (1e-6, 10e-6, 50e-6)
# Finer near the middle; all of STEPS and of their negatives are among them.
_HALF = np.unique(
    np.concatenate(
        [
            np.linspace(0, 1e-6, 5),
            np.linspace(1e-6, 1e-5, 10),
            np.linspace(1e-5, 5e-5, 17),
        ]
    )
)
SAMPLES = np.concatenate([-_HALF[:0:-1], _HALF])
LEANING = np.array([0.2, 0.15, 1.0]) / np.linalg.norm([0.2, 0.15, 1.0])
LOWER, UPPER = np.array([-6e-3, -9e-3, -4e-3]), np.array([12e-3, 9e-3, 0.0])


def measure(report: Report) -> None:
    """Measure every regime along every direction."""
    report.say()
    report.say("Integral of the derivative over the rise, and slope in the middle over")
    report.say("the mean slope, both less 1 [%], by half the length of the step")
    names = "".join(f"{1e6 * a:>12.0f} um   " for a in STEPS)
    report.say(f"  {'regime':28}{names}")
    worst = {}
    for name, make in REGIMES.items():
        for direction in DIRECTIONS:
            rows = compare(_scalar(*make(), direction), STEPS)  # pyright: ignore[reportCallIssue]
            cells = "".join(f"{i:8.2f}{s:8.2f} " for i, s in rows)
            report.say(f"  {f'{name}, {direction}':28}{cells}")
            integral = max(abs(i) for i, _ in rows)
            worst[f"{name}, {direction}"] = (integral, abs(rows[1][1]))
    for name, (integral, slope) in worst.items():
        report.figure(f"{name}: integral", integral, 1.0)
        report.figure(f"{name}: slope against 10 um", slope, 10.0)


def compare(
    scalar: Callable[[jax.Array], jax.Array], steps: tuple[float, ...]
) -> list[tuple[float, float]]:
    """Return by step what the integral and the slope in the middle are off by [%]."""
    samples = SAMPLES[abs(SAMPLES) <= max(steps) * (1 + 1e-9)]

    def value_and_slope(s: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.jvp(scalar, (s,), (jnp.ones_like(s),))

    run = jax.jit(lambda samples: jax.lax.map(value_and_slope, samples))
    value, slope = (np.asarray(x) for x in run(jnp.asarray(samples)))
    middle = len(samples) // 2
    found = []
    for a in steps:
        n = int(np.argmin(abs(samples[middle:] - a)))
        part = slice(middle - n, middle + n + 1)
        rise = value[part][-1] - value[part][0]
        integral = np.trapezoid(slope[part], samples[part])
        off = (integral / rise - 1, slope[middle] * 2 * a / rise - 1)
        found.append((100 * float(off[0]), 100 * float(off[1])))
    return found


def _scalar(
    cutter: dm.cutter.EndMill,
    stock: dm.workpiece.Stock,
    path: np.ndarray,
    axis: np.ndarray | None,
    seed: int,
) -> Callable[[jax.Array], jax.Array]:
    """Return a weighted sum of the forces along a smooth direction of the path [N].

    Bottom edges are off, as they are in a job.
    """
    rng = np.random.default_rng(seed)
    direction, weights = (jnp.asarray(smooth(rng, ROWS)) for _ in range(2))
    axes = None if axis is None else np.tile(axis, (ROWS, 1))
    plan = dm.process.choose_engagement(
        stock,
        cutter,
        axial_depth=float(stock.top - path[:, 2].min()) + 2 * SPACING,
        axes=axes,
        is_upright=axis is None,
        has_bottom=False,
    )

    def scalar(s: jax.Array) -> jax.Array:
        force = dm.sim.simulate_process(
            jnp.asarray(path) + s * direction,
            stock,
            cutter,
            LAW,
            SPINDLE_SPEED,
            axes,
            engagement=plan,
            adjoint=dm.process.ThroughPoses(),
        ).force
        return jnp.sum(weights * force) / ROWS

    return scalar


def smooth(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Return a few random waves along a path, of size 1 at most, shape (step, 3)."""
    t = np.linspace(0, 2 * math.pi, rows)[:, None]
    waves = [
        rng.normal(size=3) * np.sin(k * t + rng.uniform(0, 2 * math.pi, 3))
        for k in (1, 2, 3)
    ]
    total = np.sum(waves, axis=0)
    return total / np.linalg.norm(total, axis=1).max()


def _line(x: float, y: float, z: float) -> np.ndarray:
    return np.array([x, y, z]) + np.arange(ROWS)[:, None] * FEED * ALONG


def _block(lower: np.ndarray = LOWER, upper: np.ndarray = UPPER) -> dm.workpiece.Stock:
    return dm.workpiece.box(lower, upper, SPACING, interval_counts=SLOTS)


def _wall(is_up: bool) -> dm.workpiece.Stock:
    """Return a block whose face stands at y = 0."""
    if is_up:
        return _block(LOWER * [1, 0, 1])
    return _block(LOWER, UPPER * [1, 0, 1])


def _grooved(depth: float) -> dm.workpiece.Stock:
    """Return a block with an older slot along y."""
    y = -12e-3 + 0.2e-3 * np.arange(100)
    path = np.column_stack([np.full(100, 4.03e-3), y, np.full(100, -depth)])
    stock = dm.sim.simulate_process(path, _block(), mill("flat"), LAW, SPINDLE_SPEED)
    return stock.stock.as_raw()


def _run_out() -> dm.cutter.EndMill:
    turn = math.radians(30)
    return dm.cutter.flat_end_mill(2 * RADIUS, 3, helix_angle=turn, runout=20e-6)


REGIMES = {
    "run-out, 2 mm at a wall": lambda: (
        _run_out(),
        _wall(True),
        _line(-3e-3, 2e-3 - RADIUS, -DEPTH),
        None,
    ),
    "across an older pocket": lambda: (
        mill("flat"),
        _grooved(1.3e-3),
        _line(-2.5e-3, 0.013e-3, -DEPTH),
        None,
    ),
    "tilted ball": lambda: (
        mill("ball"),
        _block(),
        _line(-3e-3, 0.013e-3, RADIUS * (1 - LEANING[2]) - DEPTH),
        LEANING,
    ),
    "down-milling, D/50": lambda: (
        mill("flat"),
        _wall(False),
        _line(-3e-3, RADIUS - 0.2e-3, -DEPTH),
        None,
    ),
    "up-milling, D/10": lambda: (
        mill("flat"),
        _wall(True),
        _line(-3e-3, 1e-3 - RADIUS, -DEPTH),
        None,
    ),
    "helix over a shallow pocket": lambda: (
        mill("flat", 4, math.radians(40)),
        _grooved(0.7e-3),
        _line(-2.5e-3, 0.013e-3, -DEPTH - 0.5e-3),
        None,
    ),
}
