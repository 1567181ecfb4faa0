"""Finishing cuts of a flat cutter that stands upright: small feeds, small depths."""

import numpy as np

import diffmill as dm
from cuts import (
    ALONG,
    DIAMETER,
    SPACING,
    cut,
    mean_force,
    mill,
    reference_force,
    shoulder,
    shoulder_offset,
    straight,
)
from reporting import Report, relative

FEEDS = (0.1e-3, 0.05e-3, 0.025e-3, 0.0125e-3)
DIVISORS = (10, 20, 50, 100)
OFFSETS = 2
LIMIT = 3.0
# What may limit a cell: spacing of the rays, and samples per turn.
SETTINGS = {
    "default": (1.0, 180),
    "d / 2": (0.5, 180),
    "4 x angles": (1.0, 720),
}


def measure(report: Report) -> None:
    """Measure the table at the defaults, and with finer rays and angles."""
    report.say()
    report.say("Mean force against trochoids, D = 10 mm, d = D/50, 180 angles, up-")
    report.say(
        f"and down-milling at {OFFSETS} random offsets: largest / mean error [%]"
    )
    tables = {name: _table(report, name, *s) for name, s in SETTINGS.items()}
    report.say()
    report.say(
        "Which of both refinements leaves the smaller mean error, if it halves it"
    )
    for divisor in DIVISORS:
        cells = []
        for feed in FEEDS:
            means = {n: tables[n][divisor, feed].mean() for n in SETTINGS}
            best = min(("d / 2", "4 x angles"), key=means.__getitem__)
            cells.append(best if means[best] < 0.5 * means["default"] else "neither")
        report.say(f"  D/{divisor:<12}" + "".join(f"{c:>16}" for c in cells))
    report.say()
    for divisor in DIVISORS:
        worst = max(tables["default"][divisor, feed].max() for feed in FEEDS)
        report.figure(f"largest error at radial depth D/{divisor}", worst, LIMIT)


def _table(
    report: Report, name: str, share: float, angles: int
) -> dict[tuple[int, float], np.ndarray]:
    report.say()
    header = "".join(f"{f'{1e3 * f:g} mm':>16}" for f in FEEDS)
    report.say(f"  {name:14}{header}   per tooth")
    found = {}
    for divisor in DIVISORS:
        for feed in FEEDS:
            found[divisor, feed] = _errors(divisor, feed, share * SPACING, angles)
        cells = "".join(
            f"{found[divisor, f].max():9.2f} /{found[divisor, f].mean():5.2f}"
            for f in FEEDS
        )
        report.say(f"  D/{divisor:<12}{cells}")
    return found


def _errors(divisor: int, feed: float, spacing: float, angles: int) -> np.ndarray:
    """Return the errors at random offsets, up- and down-milling [%]."""
    rng = np.random.default_rng(60 + divisor)
    radial = DIAMETER / divisor
    found = []
    for _ in range(OFFSETS):
        # The rays of a block of other size stand elsewhere against its faces.
        off = spacing * rng.uniform(-0.24, 0.24, (2, 3))
        lower = np.array([-7e-3, -2e-3, -2.4e-3]) + off[0]
        upper = np.array([11e-3, 2e-3, 0.0]) + off[1] * [1, 1, 0]
        stock = dm.workpiece.box(lower, upper, spacing)
        depth, x = 1e-3 + rng.uniform(-0.1e-3, 0.1e-3), rng.uniform(0, spacing)
        for is_up in (True, False):
            y = (lower if is_up else upper)[1] + shoulder_offset(radial, is_up)
            path, first = straight([x, y, -depth], feed * ALONG)
            solution = cut(path, stock, mill("flat"), angles=angles, axial_depth=1.3e-3)
            wanted = reference_force(
                "flat",
                shoulder(depth, radial, is_up),
                feed * ALONG,
                elements=2,
                steps=7200,
            ).mean(axis=0)
            found.append(100 * relative(mean_force(solution, first), wanted))
    return np.array(found)
