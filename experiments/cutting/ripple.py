"""Where the cut lies between the rays must not matter; edges must not jump."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import diffmill as dm
from cuts import (
    ALONG,
    FEED,
    LAW,
    RADIUS,
    SLOTS,
    SPACING,
    SPINDLE_SPEED,
    UP,
    cut,
    mill,
    straight,
)
from reporting import Report

OFFSETS = 20
LEANING = np.array([0.2, 0.15, 1.0]) / np.linalg.norm([0.2, 0.15, 1.0])
LOWER, UPPER = np.array([-7e-3, -8e-3, -4e-3]), np.array([11e-3, 8e-3, 0.0])
# Steps of the walk off the side of the stock [m]; radial depth at its ends [m].
WALK = np.linspace(0.4e-3, -0.4e-3, 161)


def measure(report: Report) -> None:
    """Measure the ripple of four cuts and a walk over the stock's edge."""
    report.say()
    report.say(f"Mean force over {OFFSETS} shifts of path and block against the rays")
    report.say(f"  {'cut':30}{'mean [N]':>10}{'shifts [%]':>15}{'periods [%]':>15}")
    report.say("  (greatest less least, over the shifts and over single tooth periods)")
    cases = (
        ("flat slot", "flat", None, 2 * RADIUS),
        ("flat half immersion", "flat", None, RADIUS),
        ("ball slot", "ball", None, 2 * RADIUS),
        ("tilted ball", "ball", LEANING, 2 * RADIUS),
        ("tilted flat", "flat", LEANING, 2 * RADIUS),
    )
    for name, kind, axis, radial_depth in cases:
        rng = np.random.default_rng(51)
        rows = [_shifted(rng, kind, axis, radial_depth) for _ in range(OFFSETS)]
        forces = [r.mean(axis=0) for r in rows]
        mean = np.mean(forces, axis=0)
        size = np.linalg.norm(mean)
        off = 100 * np.linalg.norm(np.array(forces) - mean, axis=1) / size
        sizes = np.linalg.norm(forces, axis=1)
        spread = 100 * np.ptp(sizes) / size
        along = 100 * max(np.ptp(np.linalg.norm(r, axis=1)) for r in rows) / size
        report.say(f"  {name:30}{size:10.2f}{spread:15.3f}{along:15.3f}")
        report.figure(f"{name}: largest deviation from the mean", off.max(), 0.5)
    for kind, axis in (("flat", None), ("ball", LEANING)):
        _walk(report, kind, axis)


def _tip_height(kind: str, axis: np.ndarray | None, depth: float) -> float:
    """Return the height of the tip of a tool that reaches a depth below z = 0 [m]."""
    lean = UP if axis is None else axis
    if kind == "ball":
        return float(RADIUS * (1 - lean[2]) - depth)
    return float(RADIUS * np.sqrt(1 - lean[2] ** 2) - depth)


def _shifted(
    rng: np.random.Generator, kind: str, axis: np.ndarray | None, radial_depth: float
) -> np.ndarray:
    """Return the forces of a cut that lies at random between the rays, steady rows [N].

    A block of other size moves the rays against its faces, by less than half a
    spacing so that none is gained or lost.
    """
    lower = LOWER + SPACING * rng.uniform([-0.24] * 2 + [-0.48], [0.24] * 2 + [0.48])
    upper = UPPER + SPACING * rng.uniform([-0.24] * 2 + [0], [0.24] * 2 + [0])
    stock = dm.workpiece.box(lower, upper, SPACING, interval_counts=SLOTS)
    y = rng.uniform(0, SPACING)
    if radial_depth < 2 * RADIUS:
        y = lower[1]
    x = rng.uniform(0, SPACING)
    path, first = straight([x, y, _tip_height(kind, axis, 1e-3)], FEED * ALONG)
    solution = cut(path, stock, mill(kind), axis, axial_depth=3e-3)
    if not bool(solution.result == dm.RESULTS.successful):
        return np.full((1, 3), np.nan)
    return np.asarray(solution.force)[first:]


def _walk(report: Report, kind: str, axis: np.ndarray | None) -> None:
    """Walk off the side of the stock, with the derivative at every step."""
    stock = dm.workpiece.box(LOWER, UPPER, SPACING, interval_counts=SLOTS)
    height = _tip_height(kind, axis, 1e-3)
    path, first = straight([0.05e-3, 0, height], FEED * ALONG)
    axes = None if axis is None else np.tile(axis, (len(path), 1))
    plan = dm.process.choose_engagement(
        stock, mill(kind), axial_depth=3e-3, axes=axes, is_upright=axes is None
    )
    # Where the tool's rim at the height of the top touches the side, roughly; the walk
    # is long enough to find the edge.
    reach = RADIUS if kind == "flat" else np.sqrt(2 * RADIUS * 1e-3 - 1e-6)
    center = 0.0 if axis is None else RADIUS * axis[1]

    @eqx.filter_jit
    def force_and_slope(y):
        def mean(y):
            tips = jnp.asarray(path) + y * jnp.array([[0.0, 1.0, 0.0]])
            force = dm.sim.simulate_process(
                tips, stock, mill(kind), LAW, SPINDLE_SPEED, axes, engagement=plan
            ).force
            return jnp.mean(force[first:], axis=0)

        return jax.jvp(mean, (y,), (jnp.ones_like(y),))

    at = LOWER[1] - reach - (center if kind == "ball" else 0.0) + WALK
    found = [force_and_slope(jnp.asarray(y)) for y in at]
    force, slope = (np.stack([np.asarray(f[i]) for f in found]) for i in (0, 1))
    name = f"{kind}{'' if axis is None else ', tilted'}, off the side"
    size, steep = (np.linalg.norm(v, axis=1).max() for v in (force, slope))
    step = abs(WALK[1] - WALK[0])
    # Between two steps the force changes as the slopes at both say, give or take.
    change = np.diff(force, axis=0)
    said = -step * (slope[1:] + slope[:-1]) / 2
    off = np.linalg.norm(change - said, axis=1).max()
    report.say()
    report.say(f"{name}: {len(WALK)} steps of {1e6 * step:.1f} um, largest force")
    report.say(f"  {size:.3g} N, largest slope {1e-3 * steep:.3g} N/mm")
    finite = bool(np.isfinite(force).all() and np.isfinite(slope).all())
    report.require(f"{name}: all finite", finite)
    report.require(f"{name}: zero at the end", bool((force[-1] == 0).all()))
    report.figure(
        f"{name}: jump, not explained by slopes, of the force", 100 * off / size, 1.0
    )
    jumps = np.linalg.norm(np.diff(slope, axis=0), axis=1).max()
    report.say(f"  largest change of the slope in a step: {100 * jumps / steep:.1f} %")
