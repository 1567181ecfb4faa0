"""Rapid moves of an upright tool: which go through stock, and which do not."""

import itertools

import numpy as np
import pytest

from diffmill.cutter import flat_end_mill
from diffmill.sim import ToolContacts
from diffmill.toolpath import Path
from diffmill.workpiece import box

LOWER, UPPER = np.array([0.0, 0.0, -5e-3]), np.array([40e-3, 20e-3, 0.0])


def straight(*corners, rapid=(), step=0.2e-3):
    points, is_rapid = [np.asarray(corners[0], float)], [False]
    for i, (a, b) in enumerate(itertools.pairwise(corners)):
        a, b = np.asarray(a, float), np.asarray(b, float)
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / step)))
        points += [a + (b - a) * (k + 1) / count for k in range(count)]
        is_rapid += [i in rapid] * count
    rows = len(points)
    return Path(
        time=np.arange(rows) * 1e-3,
        positions=np.array(points),
        axes=np.tile([0.0, 0.0, 1.0], (rows, 1)),
        is_rapid=np.array(is_rapid),
        line=np.zeros(rows, dtype=np.int32),
    )


def depth_of(path, spacing=0.2e-3):
    """Return how deep the rapid moves of a 10 mm mill go into a block [m]."""
    found = ToolContacts.along(
        path, box(LOWER, UPPER, spacing), flat_end_mill(10e-3, 2)
    )
    return found.rapid_depth


def test_rapid_through_stock_is_found_with_its_depth():
    path = straight((-8e-3, 10e-3, -1.5e-3), (50e-3, 10e-3, -1.5e-3), rapid=(0,))
    depth = depth_of(path)
    assert depth.max() == pytest.approx(1.5e-3)
    # The tool that is looked for is smaller by a spacing, and enters at its front.
    assert -4.8e-3 < path.positions[np.flatnonzero(depth)[0], 0] < -4.2e-3


def test_rapid_above_and_on_the_face_is_allowed():
    for z in (1e-3, 0.0):
        path = straight((-8e-3, 10e-3, z), (50e-3, 10e-3, z), rapid=(0,))
        assert not depth_of(path).any()


def test_long_rapid_steps_do_not_jump_over_a_rib():
    path = straight(
        (-30e-3, 10e-3, -1e-3), (70e-3, 10e-3, -1e-3), rapid=(0,), step=60e-3
    )
    assert depth_of(path).any()


def test_rapid_along_a_cut_wall_is_no_alarm():
    path = straight(
        (-8e-3, 10e-3, -1e-3),
        (30e-3, 10e-3, -1e-3),
        (-8e-3, 10e-3, -1e-3),
        rapid=(1,),
        step=0.37e-3,
    )
    assert not depth_of(path).any()


def test_rapid_deeper_than_the_slot_is_found():
    path = straight(
        (-8e-3, 10e-3, -1e-3),
        (30e-3, 10e-3, -1e-3),
        (20e-3, 10e-3, -1.2e-3),
        rapid=(1,),
    )
    assert 0 < depth_of(path).max() <= 0.2e-3 + 1e-12
