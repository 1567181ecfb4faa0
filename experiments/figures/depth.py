"""Force over the axial depth, at depths that are no multiples of the disc height."""

import jax
import jax.numpy as jnp
import numpy as np
from references import circles

from shared import (
    DIAMETER,
    FIRST_STEADY,
    LAW,
    SPACING,
    Report,
    compiled_process,
    cut_across,
    random_block,
    relative,
    straight_cut,
)

FEED = 0.1875e-3
DEEPEST = 2.1e-3


def measure(report: Report) -> None:
    """Measure force and derivative at 20 depths, of a slot and of a half slot."""
    disc = 3 * SPACING
    depths = 0.117e-3 + 0.0983e-3 * np.arange(20)
    if np.any(np.abs(depths / disc - np.round(depths / disc)) < 1e-3):
        raise RuntimeError("a depth is a multiple of the disc height")
    for radial_depth, name in ((DIAMETER, "slot"), (DIAMETER / 2, "half slot")):
        _one(report, name, radial_depth, depths)


def _one(report: Report, name: str, radial_depth: float, depths: np.ndarray) -> None:
    lower, upper, stock = random_block(np.random.default_rng(7))
    per_depth = circles.mean_force(LAW, straight_cut(FEED, radial_depth), 1.0)

    @jax.jit
    def force_and_slope(positions):
        deeper = jnp.zeros_like(positions).at[:, 2].set(-1.0)

        def mean(p):
            force = compiled_process(2, DEEPEST)(p, stock, LAW).force
            return jnp.mean(force[FIRST_STEADY:], axis=0)

        return jax.jvp(mean, (positions,), (deeper,))

    found = []
    for depth in depths:
        path = cut_across(lower, upper, radial_depth, depth, FEED)
        found.append([np.asarray(v) for v in force_and_slope(jnp.asarray(path))])
    forces, slopes = (np.stack(column) for column in zip(*found, strict=True))
    # The line through the origin that fits best, for each component.
    line = depths @ forces / (depths @ depths)
    linear = [100 * relative(f, a * line) for f, a in zip(forces, depths, strict=True)]
    slope = [100 * relative(s, line) for s in slopes]
    report.say()
    report.say(
        f"{name}: 20 depths from {1e3 * depths[0]:.3f} to {1e3 * depths[-1]:.3f} mm"
    )
    report.say(f"  {'depth [mm]':>12}{'from the line [%]':>20}{'slope off [%]':>16}")
    for depth, a, b in zip(depths, linear, slope, strict=True):
        report.say(f"  {1e3 * depth:12.4f}{a:20.4f}{b:16.4f}")
    report.figure(f"{name}: force off the line, largest", max(linear), 0.5)
    report.figure(f"{name}: derivative off the line's slope, largest", max(slope), 2.0)
    report.say(
        f"  line against the quadrature: {100 * relative(line, per_depth):.3f} %"
    )
