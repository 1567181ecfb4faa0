"""Chips of a flat cutter that stands upright: their area, and the force of the cut."""

import math

import jax
import numpy as np
from references import circles

import diffmill as dm
from cuts import DIAMETER, LAW, RADIUS, SPINDLE_SPEED, mill
from reporting import Report, relative

# The spacing that the notes on jobs recommend.
SPACING = 0.05 * RADIUS
FEEDS = (0.2e-3, 0.1e-3, 0.05e-3, 0.0125e-3)
DEPTHS = (10e-3, 7e-3, 5e-3, 2e-3, 1e-3, 0.5e-3, 0.2e-3, 0.1e-3)
AXIAL_DEPTH = 1.03e-3
# At the least feed the tool has travelled twice the lag of the removal by then.
STEPS, STEADY, OFFSETS = 200, 170, 2
LOWER, UPPER = np.array([-2e-3, -6e-3, -1.6e-3]), np.array([48e-3, 6e-3, 0.0])


class AreaLaw(dm.cutting.AbstractForceLaw):
    """The force across the axis; along it the area of the chip per angle."""

    def force_per_width(self, chip_thickness, edge_contact, tooth):
        """Return F_t, F_r and, in place of F_a, h times the radius of its middle."""
        h = chip_thickness
        F_t, F_r, _ = LAW.force_per_width(h, edge_contact, tooth)
        return F_t, F_r, h * (RADIUS - h / 2)


def measure(report: Report) -> None:
    """Measure area and force over radial depth and feed."""
    report.say()
    report.say("Chip area over a_e f, less one, and error of the mean force across the")
    report.say(f"axis against circles in the stock, D = 10 mm, d = {1e3 * SPACING:g}")
    report.say(f"mm, up- and down-milling, {OFFSETS} random offsets: largest [%]")
    header = "".join(f"{f'{1e3 * f:g} mm':>18}" for f in FEEDS)
    report.say(f"  {'a_e':10}{header}   per tooth")
    run = _compiled()
    found = {(a, f): _errors(run, a, f) for a in DEPTHS for f in FEEDS}
    for radial in DEPTHS:
        cells = [found[radial, feed] for feed in FEEDS]
        cells = "".join(f"{area:11.2f} /{force:5.2f}" for area, force in cells)
        report.say(f"  {f'{1e3 * radial:g} mm':10}{cells}")
    worst = np.max(list(found.values()), axis=0)
    report.figure("area of the chip, largest error", worst[0], 1.0)
    report.figure("mean force, largest error", worst[1], 1.5)


def _compiled():
    cutter = mill("flat")

    def run(path, stock):
        return dm.sim.simulate_process(
            path, stock, cutter, AreaLaw(), SPINDLE_SPEED, axial_depth=1.3e-3
        )

    return jax.jit(run)


def _errors(run, radial: float, feed: float) -> tuple[float, float]:
    """Return the largest errors of area and force [%]."""
    rng = np.random.default_rng(17)
    areas, forces = [], []
    for _ in range(OFFSETS):
        off = SPACING * rng.uniform(-0.24, 0.24, (2, 3))
        lower, upper = LOWER + off[0], UPPER + off[1] * [1, 1, 0]
        stock = dm.workpiece.box(lower, upper, SPACING)
        x = rng.uniform(0, SPACING)
        for is_up in (True, False):
            cut = circles.Cut(feed, radial, is_up, RADIUS)
            y = lower[1] + radial - RADIUS if is_up else upper[1] - radial + RADIUS
            y = 0.02e-3 if radial >= DIAMETER else y
            path = np.array([x, y, -AXIAL_DEPTH]) + np.arange(STEPS)[:, None] * [
                [feed, 0, 0]
            ]
            solution = run(path, stock)
            assert bool(solution.result == dm.RESULTS.successful)
            force = np.asarray(solution.force)[STEADY:].mean(axis=0)
            # Two teeth share a turn.
            area = force[2] * math.pi / AXIAL_DEPTH
            areas.append(abs(area / circles.chip_area(cut) - 1))
            wanted = circles.mean_force(LAW, cut, AXIAL_DEPTH)
            forces.append(relative(force[:2], wanted[:2]))
    return 100 * max(areas), 100 * max(forces)
