"""The chip takes the metal that there is: its volume, and the force of what is left."""

import functools
import math

import equinox as eqx
import numpy as np
import pytest
from helpers import PAPER_LAW, relative
from references import circles

from diffmill import RESULTS, cutter as ct, cutting, sim, workpiece as wp

R, D, DEPTH, STEPS = 5e-3, 0.25e-3, 1.03e-3, 170
LOWER, UPPER = np.array([-2.02e-3, -4.04e-3, -1.6e-3]), np.array([41e-3, 4.06e-3, 0])
SLOW = pytest.mark.slow
UNEVEN = np.array([0.9 * math.pi, 1.1 * math.pi])


class VolumeLaw(cutting.AbstractForceLaw):
    """The paper's force across the axis; along it the area of the chip per angle."""

    def force_per_width(self, chip_thickness, edge_contact, tooth):
        h = chip_thickness
        F_t, F_r, _ = PAPER_LAW.force_per_width(h, edge_contact, tooth)
        # The middle of the chip lies half its thickness inside the rim.
        return F_t, F_r, h * (R - h / 2)


@functools.cache
def compiled(angles=None, pitch=None, helix_angle=0.0):
    mill = ct.flat_end_mill(2 * R, 2, helix_angle, pitch=pitch)

    @eqx.filter_jit
    def run(path, stock):
        return sim.simulate_process(
            path, stock, mill, VolumeLaw(), 837.0, axial_depth=1.3e-3, angles=angles
        )

    return run


def chip_volume(solution):
    """Return the volume of the chips of each tooth period, shape (step,)."""
    return np.asarray(solution.force)[:, 2] * math.pi


def straight(radial_depth, feed, is_up):
    """Return a cut along the lower or the upper face that begins in the stock."""
    y = LOWER[1] + radial_depth - R if is_up else UPPER[1] - radial_depth + R
    start = np.array([0.05e-3, y, -DEPTH])
    return start + np.arange(STEPS)[:, None] * feed * np.array([1.0, 0, 0])


@pytest.mark.parametrize("is_up", [True, False])
@pytest.mark.parametrize(
    ("radial_depth", "feed"),
    [
        (0.1e-3, 0.2e-3),
        (0.1e-3, 0.0125e-3),
        (1e-3, 0.1875e-3),
        (7e-3, 0.2e-3),
        pytest.param(0.2e-3, 0.05e-3, marks=SLOW),
        pytest.param(5e-3, 0.0125e-3, marks=SLOW),
    ],
)
def test_steady_chips_have_the_area_of_the_cut(radial_depth, feed, is_up):
    stock = wp.box(LOWER, UPPER, D)
    solution = compiled()(straight(radial_depth, feed, is_up), stock)
    assert bool(solution.result == RESULTS.successful)
    area = chip_volume(solution)[-20:].mean() / DEPTH
    cut = circles.Cut(feed, radial_depth, is_up)
    # The rest of feed * radial_depth the edge takes by its travel, not by its turn.
    assert area == pytest.approx(circles.chip_area(cut), rel=1e-2)
    found = np.asarray(solution.force)[-20:].mean(axis=0)[:2]
    wanted = circles.mean_force(PAPER_LAW, cut, DEPTH)[:2]
    assert relative(found, wanted) < 1.5e-2


def around_a_corner(feed):
    """Return a path into a block, around a right angle in it, and out of it."""
    along = np.arange(-5.6e-3, 7e-3, feed)
    across = np.arange(0.0, 13e-3, feed)
    x = np.concatenate([along, np.full(len(across), along[-1])])
    y = np.concatenate([np.zeros(len(along)), across])
    return np.column_stack([x, y, np.full(len(x), -DEPTH)])


def swept_area(path, lower, upper, pixel=0.02e-3):
    """Return the area of a block that each pose takes first [m^2], by pixels."""
    x, y = (np.arange(lower[i] + pixel / 2, upper[i], pixel) for i in (0, 1))
    is_left = np.ones((len(x), len(y)), bool)
    area = []
    for at in path:
        near = [np.abs(v - c) <= R for v, c in zip((x, y), at, strict=False)]
        part = np.ix_(*near)
        far = (x[near[0]] - at[0])[:, None] ** 2 + (y[near[1]] - at[1])[None] ** 2
        taken = is_left[part] & (far <= R**2)
        is_left[part] &= ~taken
        area.append(taken.sum() * pixel**2)
    return np.array(area)


@pytest.mark.parametrize("turn", [-0.375, -0.25])
def test_a_chip_has_its_area_whichever_angle_its_first_sample_has(turn):
    # At last the feed is turned by a part of the angle between two of 192 samples.
    radial_depth, feed, turned = 0.1e-3, 0.2e-3, STEPS - 50
    path = straight(radial_depth, feed, is_up=True)
    slope = turn * 2 * math.pi / 192
    way = path[:, 0] - path[turned, 0]
    path[:, 1] += slope * (np.maximum(way, 0) - 40 * feed)
    chips = chip_volume(compiled()(path, wp.box(LOWER, UPPER, D)))
    upper = np.array([UPPER[0], LOWER[1] + 0.3e-3, 0])
    lower = np.array([path[turned, 0] + LOWER[0], *LOWER[1:]])
    taken = swept_area(path, lower, upper, pixel=4e-6) * DEPTH
    cut = circles.Cut(feed, radial_depth)
    taken *= circles.chip_area(cut) / circles.swept_area(cut)
    # A tooth takes a chip this thin at the start of its period, from the pose before.
    assert chips[-20:].sum() == pytest.approx(taken[-21:-1].sum(), rel=1.2e-2)


@pytest.mark.parametrize(
    ("feed", "helix_angle"), [(0.2e-3, 0.0), pytest.param(0.1e-3, 0.6, marks=SLOW)]
)
def test_entry_corner_and_exit_take_the_metal_that_is_there(feed, helix_angle):
    lower, upper = np.array([0, -7e-3, -1.6e-3]), np.array([14e-3, 8e-3, 0])
    path = around_a_corner(feed)
    solution = compiled(helix_angle=helix_angle)(path, wp.box(lower, upper, D))
    assert bool(solution.result == RESULTS.successful)
    chips, taken = chip_volume(solution), swept_area(path, lower, upper) * DEPTH
    # A chip of a period lies half a feed behind what the pose at its end takes.
    taken = (taken + np.concatenate([[0.0], taken[:-1]])) / 2
    steady, turned = (path[:, 0] > 5.2e-3).argmax(), (path[:, 1] > 0).argmax()
    leaving = (path[:, 1] > 3e-3).argmax()
    for rows in np.split(np.arange(len(path)), [steady, turned, leaving]):
        assert chips[rows].sum() == pytest.approx(taken[rows].sum(), rel=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize(("radial_depth", "tolerance"), [(7e-3, 1e-2), (1e-3, 2e-2)])
def test_chips_of_uneven_teeth_have_the_area_of_the_cut(radial_depth, tolerance):
    # They go the way of any edge in space.
    stock = wp.box(LOWER, UPPER, D)
    path = straight(radial_depth, 0.1e-3, is_up=True)[:70]
    chips = chip_volume(compiled(pitch=tuple(UNEVEN))(path, stock))
    wanted = 0.1e-3 * radial_depth * DEPTH
    assert chips[-20:].mean() == pytest.approx(wanted, rel=tolerance)
