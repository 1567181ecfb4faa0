"""Which tooth is which in records of a cutter with run-out: NumPy, no simulation."""

import math

import numpy as np
from slot_force import SPEED, K, R

from diffmill import cutter as ct, identification, workpiece as wp

DEPTH, TURN = 2e-3, 2 * math.pi / SPEED
RUNOUT, ANGLE = 8e-6, 0.35


def force(time, feed, teeth, coefficients=K):
    """Return the force of straight teeth in a slot [N], on circles of their own.

    The offset of the axis towards tooth 0 makes the radii; each tooth cuts to the
    deepest of all marks of a revolution.
    """
    place = 2 * math.pi * np.arange(teeth) / teeth
    radii = R + RUNOUT * np.cos(place - ANGLE)
    total = np.zeros((len(time), 3))
    for tooth in range(teeth):
        # Tooth j + 1 comes a tooth period before tooth j.
        phi = SPEED * time + place[tooth]
        sin, cos = np.sin(phi), np.cos(phi)
        marks = [
            radii[tooth]
            + ago * feed * sin
            - np.sqrt(radii[(tooth + ago) % teeth] ** 2 - (ago * feed * cos) ** 2)
            for ago in range(1, teeth + 1)
        ]
        chip = np.minimum.reduce(marks)
        touches = (chip > 0) & (sin > 0)
        t, r, a = (
            DEPTH * touches * (coefficients[i] * chip + coefficients[i + 3])
            for i in range(3)
        )
        total += np.stack([-t * cos - r * sin, t * sin - r * cos, a], axis=1)
    return total


def registered(feed, teeth, first_tooth, seed, noise):
    """Return a record whose clock begins at a tooth, beside the cut's own columns."""
    spacing = TURN / 240
    rows = np.column_stack([feed * np.arange(12 * teeth), *np.zeros((2, 12 * teeth))])
    stock = wp.box([0, 0, -1e-3], [1e-3, 1e-3, 0], 0.5e-3, interval_counts=(1, 1, 1))
    cutter = ct.flat_end_mill(2 * R, teeth, runout=RUNOUT, runout_angle=ANGLE)
    cut = identification.Cut(rows, stock, cutter, SPEED)
    grid = spacing * (0.5 + np.arange(12 * 240))
    unit = np.stack([force(grid, feed, teeth, one) for one in np.eye(6)], axis=2)
    columns = identification.EngagementColumns(
        grid[0], spacing, unit, np.zeros((len(grid), 3)), np.zeros_like(unit)
    )
    time = 4 * TURN + np.arange(0, 6 * TURN, 1.03e-4)
    seen = force(time + first_tooth * TURN / teeth, feed, teeth)
    seen += noise * np.random.default_rng(seed).normal(size=seen.shape)
    # The axes are known, so that a fit does not read their proposal.
    proposal = identification.propose_axes(seen, np.ones((len(seen), 3, 6)), 1e4)
    return identification.RecordRegistration(
        cut, columns, time, seen, 0.0, proposal, None, SPEED, ()
    )


def test_a_runout_says_which_tooth_is_which_in_each_record():
    """Noise hides it from a glance at the residuals, which differ by per cents."""
    teeth, begins = 2, [0, 1]
    records = [
        registered(feed, teeth, begin, begin, 120.0)
        for feed, begin in zip([0.08e-3, 0.16e-3], begins, strict=True)
    ]
    fit = identification.fit_force_coefficients(
        records,
        [one.time for one in records],
        [one.force for one in records],
        shift_range=0.55 * TURN,
    )
    turns = np.array(fit.time_shift) / TURN - np.array(begins) / teeth
    np.testing.assert_allclose(turns, np.round(turns), atol=0.05)
