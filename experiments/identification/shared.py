"""Cuts and records that several groups share."""

import dataclasses
import math

import numpy as np

from diffmill import cutter as ct, identification, process as pr, workpiece as wp

# Slot milling of aluminium as measured (forces/measured_slot_means.json) [Pa, N/m].
K = np.array([958.86e6, 250.863e6, 146.361e6, 15.758e3, 19.434e3, 18.207e3])
SPEED = 6000 * 2 * math.pi / 60
PERIOD = math.pi / SPEED
RATE = 10e3


def slot(feeds, teeth_per_feed, spacing, depth=2e-3, runout=0.0, helix=30.0):
    """Return a slot whose feed per tooth changes, as a cut of default sizes."""
    steps = np.repeat(feeds, teeth_per_feed)
    x = np.concatenate([[0.0], np.cumsum(steps)])
    rows = np.column_stack([x, np.full(len(x), 6e-3), np.full(len(x), -depth)])
    low, high = [-6e-3, 0, -depth - 1e-3], [x[-1] + 6e-3, 12e-3, 0]
    stock = wp.box(low, high, spacing, interval_counts=(4, 4, 1))
    cutter = ct.flat_end_mill(10e-3, 2, helix_angle=math.radians(helix), runout=runout)
    return identification.Cut(rows, stock, cutter, SPEED)


def finer(cut, angles, substeps, height):
    """Return a cut that is simulated with given sizes, every tooth at all times."""
    cutter = dataclasses.replace(cut.cutter, is_plain=False)
    depth = pr.Immersion.of_path(cut.positions, cut.stock, cutter).depth
    plan = pr.choose_engagement(
        cut.stock,
        cutter,
        axial_depth=depth,
        angles=angles,
        substeps=substeps,
        element_height=height,
        has_bottom=False,
    )
    profile = dataclasses.replace(plan.profile, keeps_all=True)  # pyright: ignore[reportAttributeAccessIssue]
    plan = dataclasses.replace(plan, profile=profile)
    return dataclasses.replace(cut, cutter=cutter, engagement=plan)


def force_at(cut, time):
    """Return the force of a cut with the coefficients K at some instants."""
    found = identification.EngagementColumns.of_cut(cut)
    force = found.columns @ K
    grid = found.start + found.spacing * np.arange(len(force))
    return np.column_stack([np.interp(time, grid, force[:, i]) for i in range(3)])
