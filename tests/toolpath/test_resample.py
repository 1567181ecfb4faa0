"""Resampling of recorded paths."""

import numpy as np
import pytest

from diffmill.toolpath import Path


def record(time, positions, axes=None, is_rapid=None, line=None):
    rows = len(time)
    return Path(
        np.asarray(time, float),
        np.asarray(positions, float),
        np.tile([0.0, 0.0, 1.0], (rows, 1)) if axes is None else axes,
        np.zeros(rows, bool) if is_rapid is None else is_rapid,
        np.arange(1, rows + 1, dtype=np.int32) if line is None else line,
    )


def test_same_instants_keep_their_rows():
    time = 0.5 + 0.00375 * np.arange(50)
    positions = np.random.default_rng(0).standard_normal((50, 3))
    path = record(time, positions).resampled(0.00375)
    np.testing.assert_allclose(path.positions, positions, atol=1e-9)
    np.testing.assert_allclose(path.time, 0.00375 * np.arange(50), atol=1e-15)
    np.testing.assert_array_equal(path.line, np.arange(1, 51))


def test_never_leaves_the_box_of_its_neighbours():
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.01, 0.2, 30))
    positions = np.round(rng.standard_normal((30, 3)))
    path = record(time, positions).resampled(1e-3)
    row = np.clip(
        np.searchsorted(time - time[0], path.time, side="left"), 1, len(time) - 1
    )
    low = np.minimum(positions[row - 1], positions[row])
    high = np.maximum(positions[row - 1], positions[row])
    assert np.all(path.positions >= low - 1e-12)
    assert np.all(path.positions <= high + 1e-12)


def test_straight_constant_speed_stays_so():
    time = np.array([0.0, 0.1, 0.15, 0.4])
    path = record(time, time[:, None] * [0.05, 0.02, 0.0]).resampled(0.01)
    inside = np.minimum(path.time, 0.4)
    np.testing.assert_allclose(
        path.positions, inside[:, None] * [0.05, 0.02, 0.0], atol=1e-16
    )
    np.testing.assert_allclose(path.duration, 0.4)
    steps = np.linalg.norm(np.diff(path.positions, axis=0), axis=1)
    np.testing.assert_allclose(steps.sum(), 0.4 * np.hypot(0.05, 0.02))


def test_third_order_on_a_monotone_curve():
    errors = []
    for count in (20, 40, 80):
        time = np.linspace(0, 1, count + 1)
        path = record(time, np.exp(time)[:, None] * np.ones(3)).resampled(1 / 997)
        inside = np.minimum(path.time, 1.0)
        errors.append(np.max(np.abs(path.positions[:, 0] - np.exp(inside))))
    order = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all(order > 1.8)


def test_end_is_held_and_axes_are_unit():
    tilt = np.array([[0, 0, 1.0], [np.sin(0.2), 0, np.cos(0.2)]])
    rapid = np.array([False, True])
    path = record([0.0, 0.0101], [[0, 0, 0], [1, 2, 3]], tilt, rapid).resampled(0.002)
    assert path.step_count == 7
    np.testing.assert_allclose(path.positions[-1], [1, 2, 3])
    np.testing.assert_allclose(np.linalg.norm(path.axes, axis=1), 1.0, rtol=1e-15)
    np.testing.assert_array_equal(path.is_rapid, [False] + 6 * [True])


def test_axes_turn_evenly_between_recorded_ones():
    angle = np.array([0.0, 1.2, 1.5])
    axes = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    time, points = [0.0, 0.4, 1.0], np.eye(3)
    path = record(time, points, axes).resampled(0.05)
    found = np.arctan2(path.axes[:, 0], path.axes[:, 2])
    np.testing.assert_allclose(found, np.interp(path.time, time, angle), atol=1e-12)
    axes[1] = -axes[0]
    with pytest.raises(ValueError, match=r"opposite.* 0 s behind"):
        record(time, points, axes).resampled(0.05)


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="`time`"):
        record([0.0, 0.0], np.zeros((2, 3))).resampled(0.1)
    with pytest.raises(ValueError, match="`tooth_period`"):
        record([0.0, 1.0], np.zeros((2, 3))).resampled(0.0)
