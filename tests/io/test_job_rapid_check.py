import itertools

import numpy as np
import pytest

from diffmill.config import rigid_pass
from diffmill.toolpath import Path

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


def check(path, spacing=0.2e-3):
    return rigid_pass(path, 5e-3, LOWER, UPPER, spacing)


def test_cut_begins_and_ends_where_the_disc_meets_the_block():
    path = straight((-8e-3, 10e-3, -1e-3), (50e-3, 10e-3, -1e-3))
    found = check(path)
    x = path.positions[found.is_cutting, 0]
    # The front enters at x = -R. The last to be cut is the outermost line of points,
    # 4.9 mm off the centre, at the far face: 39.9 mm - sqrt(R^2 - 4.9^2 mm^2).
    assert x[0] == pytest.approx(-5e-3, abs=0.3e-3)
    assert x[-1] == pytest.approx(39.9e-3 - 0.995e-3, abs=0.2e-3)
    assert not found.is_crash.any()


def test_second_pass_through_a_slot_cuts_nothing():
    ends = (-8e-3, 10e-3, -1e-3), (50e-3, 10e-3, -1e-3)
    path = straight(*ends, ends[0], rapid=(1,))
    found = check(path)
    assert not found.is_crash.any()
    first = np.flatnonzero(np.diff(path.positions[:, 0]) < 0)[0]
    assert not found.is_cutting[first + 1 :].any()


def test_rapid_through_stock_is_found_with_its_depth():
    path = straight((-8e-3, 10e-3, -1.5e-3), (50e-3, 10e-3, -1.5e-3), rapid=(0,))
    found = check(path)
    assert found.is_crash.any()
    assert found.depth.max() == pytest.approx(1.5e-3)


def test_rapid_above_and_on_the_face_is_allowed():
    for z in (1e-3, 0.0):
        path = straight((-8e-3, 10e-3, z), (50e-3, 10e-3, z), rapid=(0,))
        found = check(path)
        assert not found.is_crash.any()
        assert not found.is_cutting.any()


def test_long_rapid_steps_do_not_jump_over_a_rib():
    path = straight(
        (-30e-3, 10e-3, -1e-3), (70e-3, 10e-3, -1e-3), rapid=(0,), step=60e-3
    )
    assert check(path).is_crash.any()


def test_rapid_along_a_cut_wall_is_no_alarm():
    path = straight(
        (-8e-3, 10e-3, -1e-3),
        (30e-3, 10e-3, -1e-3),
        (-8e-3, 10e-3, -1e-3),
        rapid=(1,),
        step=0.37e-3,
    )
    assert not check(path).is_crash.any()


def test_rapid_deeper_than_the_slot_is_found():
    path = straight(
        (-8e-3, 10e-3, -1e-3),
        (30e-3, 10e-3, -1e-3),
        (20e-3, 10e-3, -1.2e-3),
        rapid=(1,),
    )
    found = check(path)
    assert found.is_crash.any()
    assert found.depth.max() <= 0.2e-3 + 1e-12
