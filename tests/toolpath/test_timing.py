"""Timing of programs against closed forms and the limits it promises."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from diffmill.toolpath import Move, Program, sample_program

PERIOD = 1e-4
LIMITS: dict[str, Any] = {
    "acceleration": 2.0,
    "rapid_feed": 0.2,
    "corner_tolerance": 0.0,
}


def point(values):
    x, y, z = (float(value) for value in values)
    return x, y, z


def line(start, end, feed: float | None = 0.05, **rest):
    return Move(point(start), point(end), feed=feed, **rest)


def chain(points, **rest):
    pairs = pairwise(points)
    return Program(
        tuple(line(a, b, line=number, **rest) for number, (a, b) in enumerate(pairs, 1))
    )


def arc(start, end, centre, turn, feed=0.05, **rest):
    return Move(
        point(start), point(end), centre=point(centre), turn=turn, feed=feed, **rest
    )


def speeds(path):
    return np.linalg.norm(np.diff(path.positions, axis=0), axis=1) / PERIOD


def distance_to_polyline(points, vertices):
    best = np.full(len(points), np.inf)
    for a, b in pairwise(vertices):
        fraction = np.clip((points - a) @ (b - a) / np.dot(b - a, b - a), 0, 1)
        gap = points - a - fraction[:, None] * (b - a)
        best = np.minimum(best, np.linalg.norm(gap, axis=1))
    return best


@pytest.mark.parametrize(
    ("length", "expected"),
    [(0.02, 0.02 / 0.05 + 0.05 / 2.0), (0.001, 2 * math.sqrt(0.001 / 2.0))],
    ids=["trapezoid", "triangle"],
)
def test_duration_of_one_line(length, expected):
    path = sample_program(chain([(0, 0, 0), (length, 0, 0)]), PERIOD, **LIMITS)
    assert expected <= path.duration < expected + PERIOD * (1 + 1e-6)
    np.testing.assert_allclose(path.positions[-1], [length, 0, 0], atol=1e-15)
    steps = np.linalg.norm(np.diff(path.positions, axis=0), axis=1)
    np.testing.assert_allclose(steps.sum(), length, rtol=1e-12)


def test_position_within_a_trapezoid():
    path = sample_program(chain([(0, 0, 0), (0.02, 0, 0)]), PERIOD, **LIMITS)
    end = 0.02 / 0.05 + 0.05 / 2.0
    time = np.minimum(path.time, end)
    rise = 0.025
    expected = np.select(
        [time < rise, time < end - rise],
        [time**2, rise**2 + 0.05 * (time - rise)],
        0.02 - (end - time) ** 2,
    )
    np.testing.assert_allclose(path.positions[:, 0], expected, atol=1e-15)


def test_exact_stop_at_every_corner():
    points = [(0, 0, 0), (0.02, 0, 0), (0.02, 0.01, 0)]
    path = sample_program(chain(points), PERIOD, **LIMITS)
    expected = 0.03 / 0.05 + 2 * 0.05 / 2.0
    assert expected <= path.duration < expected + 1.001 * PERIOD
    assert np.max(distance_to_polyline(path.positions, np.array(points))) < 1e-15


@pytest.mark.parametrize("turn", [10, 45, 90, 135, 165])
def test_rounded_corner_keeps_tolerance_and_acceleration(turn):
    tolerance = 1e-4
    phi = math.radians(turn)
    points = np.array(
        [
            (0, 0, 0),
            (0.02, 0, 0.0),
            (0.02 + 0.02 * math.cos(phi), 0.02 * math.sin(phi), 0),
        ]
    )
    path = sample_program(
        chain(points), PERIOD, **(LIMITS | {"corner_tolerance": tolerance})
    )
    gap = np.min(np.linalg.norm(path.positions - points[1], axis=1))
    assert 0.9 * tolerance < gap < tolerance + 1e-6
    assert np.max(distance_to_polyline(path.positions, points)) <= tolerance
    velocity = np.diff(path.positions, axis=0) / PERIOD
    acceleration = np.diff(velocity, axis=0) / PERIOD
    # Along and across the path each keep the limit; their sum may reach sqrt(2) of it.
    assert np.max(np.linalg.norm(acceleration, axis=1)) < 2.0 * math.sqrt(2) * 1.01
    stop = sample_program(chain(points), PERIOD, **LIMITS)
    assert path.duration < stop.duration


def test_speed_and_acceleration_limits_of_a_mixed_program():
    moves = (
        line((0, 0, 0), (0.01, 0, 0)),
        arc((0.01, 0, 0), (0.01, 0.002, 0), (0.01, 0.001, 0), 1, feed=0.1),
        line((0.01, 0.002, 0), (0.0, 0.002, 0), feed=0.03),
        arc((0, 0.002, 0), (0.004, 0.002, 0.001), (0.002, 0.002, 0), -1, feed=0.08),
        line((0.004, 0.002, 0.001), (0.004, 0.01, 0)),
    )
    path = sample_program(
        Program(moves), PERIOD, **(LIMITS | {"corner_tolerance": 5e-5})
    )
    speed = speeds(path)
    assert np.max(speed) <= 0.1 * (1 + 1e-9)
    radius = np.linalg.norm(
        np.asarray(path.positions)[:, :2] - np.array([0.01, 0.001]), axis=1
    )
    on_arc = (np.abs(radius - 0.001) < 1e-9) & (path.positions[:, 0] > 0.0101)
    assert on_arc.sum() > 100
    # v^2 / r <= a on the 1 mm arc, which its own feed of 0.1 m/s would break.
    assert np.max(speed[on_arc[1:]]) <= math.sqrt(2.0 * 0.001) * (1 + 1e-6)
    acceleration = np.diff(path.positions, n=2, axis=0) / PERIOD**2
    assert np.max(np.linalg.norm(acceleration, axis=1)) < 2.0 * math.sqrt(2) * 1.02
    assert speed[0] < 2.0 * PERIOD
    assert speed[-1] < 2.0 * PERIOD


def test_corner_between_line_and_arc_keeps_tolerance():
    tolerance = 2e-5
    moves = (
        line((-0.01, 0, 0), (0, 0, 0)),
        arc((0, 0, 0), (0.01, 0, 0), (0.005, 0, 0), -1),
    )
    path = sample_program(
        Program(moves), PERIOD, **(LIMITS | {"corner_tolerance": tolerance})
    )
    angle = np.linspace(np.pi, 0, 2001)
    ring = np.stack([0.005 + 0.005 * np.cos(angle), 0.005 * np.sin(angle)], axis=1)
    ring = np.concatenate([ring, np.zeros((2001, 1))], axis=1)
    vertices = np.concatenate([[[-0.01, 0, 0]], ring])
    gap = distance_to_polyline(path.positions, vertices)
    assert 0.3 * tolerance < np.max(gap) < tolerance + 1e-8
    # The corner is a right angle: as fast as the arc that two lines would get.
    radius = tolerance / (math.sqrt(2) - 1)
    slowest = np.min(speeds(path)[100:-200])
    np.testing.assert_allclose(slowest, math.sqrt(2.0 * radius), rtol=0.05)


def test_tangent_arc_is_passed_without_a_stop():
    moves = (
        line((0, 0, 0), (0.02, 0, 0)),
        arc((0.02, 0, 0), (0.02, 0.02, 0), (0.02, 0.01, 0), 1),
        line((0.02, 0.02, 0), (0, 0.02, 0)),
    )
    path = sample_program(Program(moves), PERIOD, **LIMITS)
    expected = (0.04 + np.pi * 0.01) / 0.05 + 0.05 / 2.0
    assert expected <= path.duration < expected + 1.001 * PERIOD


def test_helix_points_lie_on_the_helix():
    helix = arc((0.01, 0, 0), (0.01, 0, -0.004), (0, 0, 0), 1)
    path = sample_program(Program((helix,)), 1e-3, **LIMITS)
    radius = np.linalg.norm(path.positions[:, :2], axis=1)
    np.testing.assert_allclose(radius, 0.01, rtol=1e-12)
    angle = np.unwrap(np.arctan2(path.positions[:, 1], path.positions[:, 0]))
    np.testing.assert_allclose(
        path.positions[:, 2], -0.004 * angle / (2 * np.pi), atol=1e-14
    )
    np.testing.assert_allclose(angle[-1], 2 * np.pi, rtol=1e-12)
    length = math.hypot(2 * np.pi * 0.01, 0.004)
    np.testing.assert_allclose(helix.length, length, rtol=1e-14)


def test_arc_of_unequal_radii_ends_where_programmed():
    move = arc((0.01, 0, 0), (0, 0.010002, 0), (0, 0, 0), 1)
    path = sample_program(Program((move,)), 1e-3, **LIMITS)
    np.testing.assert_allclose(path.positions[-1], [0, 0.010002, 0], atol=1e-14)


def test_rapid_moves_stop_and_are_marked():
    moves = (
        line((0, 0, 0), (0.01, 0, 0), feed=None, is_rapid=True, line=3),
        line((0.01, 0, 0), (0.02, 0, 0), feed=0.05, line=4),
    )
    path = sample_program(
        Program(moves), PERIOD, **(LIMITS | {"corner_tolerance": 1e-3})
    )
    first = 2 * math.sqrt(0.01 / 2.0)
    expected = first + 0.01 / 0.05 + 0.05 / 2
    assert expected <= path.duration < expected + 1.001 * PERIOD
    np.testing.assert_array_equal(path.is_rapid, path.time <= first)
    np.testing.assert_array_equal(path.line, np.where(path.time <= first, 3, 4))


def test_approach_is_left_out():
    moves = (
        line((0, 0, 0), (0, 0, 0.005), feed=None, is_rapid=True),
        line((0, 0, 0.005), (0.1, 0.1, 0.005), feed=None, is_rapid=True),
        line((0.1, 0.1, 0.005), (0.1, 0.1, 0)),
    )
    path = sample_program(Program(moves, approach_count=2), PERIOD, **LIMITS)
    np.testing.assert_allclose(path.positions[0], [0.1, 0.1, 0.005])


def test_many_short_chords_of_a_circle_are_as_fast_as_the_circle():
    angle = np.linspace(0, 2 * np.pi, 361)
    points = 0.02 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    path = sample_program(chain(points), 1e-3, **(LIMITS | {"corner_tolerance": 1e-4}))
    expected = 2 * np.pi * 0.02 / 0.05 + 0.05 / 2
    np.testing.assert_allclose(path.duration, expected, rtol=2e-3)


def test_inverse_time_moves_take_their_duration():
    points = [(0, 0, 0), (1e-4, 0, 0), (1e-4, 2e-4, 0), (1e-4, 2e-4, 0), (0, 0, 1e-4)]
    program = chain(points, duration=PERIOD)
    path = sample_program(program, PERIOD, **(LIMITS | {"corner_tolerance": 1e-3}))
    np.testing.assert_allclose(path.positions, points, atol=1e-18)
    np.testing.assert_array_equal(path.line, [1, 1, 2, 3, 4])


def test_feed_may_come_from_outside():
    program = chain([(0, 0, 0), (0.02, 0, 0)], feed=None)
    path = sample_program(program, PERIOD, **LIMITS, feed=0.05)
    assert abs(path.duration - 0.425) < 1.001 * PERIOD
    with pytest.raises(ValueError, match="line 1"):
        sample_program(program, PERIOD, **LIMITS)


@pytest.mark.parametrize("name", ["acceleration", "rapid_feed", "corner_tolerance"])
@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_bad_limits_are_named(name, value):
    program = chain([(0, 0, 0), (0.02, 0, 0)])
    with pytest.raises(ValueError, match=name):
        sample_program(program, PERIOD, **(LIMITS | {name: value}))


def test_program_without_motion_is_refused():
    with pytest.raises(ValueError):
        sample_program(chain([(0, 0, 0), (0, 0, 0)]), PERIOD, **LIMITS)


def test_a_move_after_one_in_inverse_time_starts_at_rest():
    # 10 mm in 0.5 s at a constant speed, then 10 mm more by the acceleration limit.
    first = Move((0.0, 0.0, 0.0), (0.01, 0.0, 0.0), duration=0.5)
    then = line((0.01, 0.0, 0.0), (0.02, 0.0, 0.0), feed=0.05)
    path = sample_program(Program((first, then)), 1e-3, **LIMITS)
    t = np.asarray(path.time) - 0.5
    rises = (t >= 0) & (t < 0.05 / LIMITS["acceleration"])
    expected = 0.01 + 0.5 * LIMITS["acceleration"] * t[rises] ** 2
    np.testing.assert_allclose(path.positions[rises, 0], expected, atol=1e-9)


def test_motions_without_end_are_refused():
    program = Program((line((0.0, 0.0, 0.0), (0.01, 0.0, 0.0)),))
    for limits in ({"acceleration": 1e-300}, {"acceleration": 1e-12}):
        with pytest.raises(ValueError, match="1000000"):
            sample_program(program, 1e-3, **(LIMITS | limits))
    with pytest.raises(ValueError, match="100"):
        sample_program(program, 1e-3, **LIMITS, most_steps=100)


SMOOTHING = 40e-3


def smoothed(program, **limits):
    """Return the plain and the smoothed path of a program."""
    return (
        sample_program(program, PERIOD, **(LIMITS | limits), smoothing=tau)
        for tau in (0.0, SMOOTHING)
    )


def test_a_smoothed_line_is_the_moving_average_of_the_plain_one():
    plain, smooth = smoothed(chain([(0, 0, 0), (0.02, 0, 0)]))
    assert smooth.duration == pytest.approx(plain.duration + SMOOTHING, abs=PERIOD)
    width = round(SMOOTHING / PERIOD)
    x = np.pad(plain.positions[:, 0], (width, width), mode="edge")
    half = (x[1:] + x[:-1]) / 2
    wanted = np.convolve(half, np.ones(width) / width, "valid")
    np.testing.assert_allclose(
        smooth.positions[:, 0], wanted[: len(smooth.positions)], atol=2e-9
    )
    jerk = np.diff(smooth.positions[:, 0], 3) / PERIOD**3
    assert np.abs(jerk).max() <= 2.0 / SMOOTHING * 1.001


def test_a_smoothed_motion_stays_on_the_program_and_stops_where_it_stops():
    corner, end = (0.02, 0.0, 0.0), (0.02, 0.01, 0.0)
    moves = (
        line((0, 0, 0), corner, line=1),
        line(corner, corner, duration=0.1, line=2, feed=None),
        line(corner, end, line=3),
    )
    plain, smooth = smoothed(Program(moves))
    assert smooth.duration == pytest.approx(
        plain.duration + 2 * SMOOTHING, abs=2 * PERIOD
    )
    off = distance_to_polyline(smooth.positions, np.array([(0, 0, 0), corner, end]))
    assert off.max() < 1e-12
    rests = np.linalg.norm(smooth.positions - np.array(corner), axis=1) < 1e-12
    assert rests.sum() * PERIOD == pytest.approx(0.1, abs=0.01)
    assert np.all(np.diff(smooth.line) >= 0) and set(smooth.line) == {1, 2, 3}
    np.testing.assert_allclose(smooth.positions[-1], end, atol=1e-12)


def test_moves_that_state_their_time_keep_it_when_others_are_smoothed():
    ends = [(0.001 * i, 0.0005 * (i % 2), 0.0) for i in range(6)]
    timed = [line(a, b, feed=None, duration=0.0123) for a, b in pairwise(ends)]
    free = line(ends[-1], (0.02, 0.0, 0.0))
    plain, smooth = smoothed(Program((*timed, free)))
    rows = math.floor(5 * 0.0123 / PERIOD)
    np.testing.assert_allclose(
        smooth.positions[:rows], plain.positions[:rows], atol=1e-12
    )
    assert smooth.duration == pytest.approx(plain.duration + SMOOTHING, abs=PERIOD)
    np.testing.assert_allclose(smooth.positions[-1], free.end, atol=1e-12)


def test_a_smoothed_motion_keeps_the_limits_where_the_path_bends():
    moves = (
        line((0, 0, 0), (0.02, 0, 0)),
        arc((0.02, 0, 0), (0.02, 0.002, 0), (0.02, 0.001, 0), 1, feed=0.1),
        line((0.02, 0.002, 0), (0.0, 0.002, 0), feed=0.03),
        line((0.0, 0.002, 0), (0.0, 0.012, 0)),
    )
    for tolerance in (0.0, 5e-5):
        _, path = smoothed(Program(moves), corner_tolerance=tolerance)
        speed = speeds(path)
        x, y = np.asarray(path.positions)[1:, :2].T
        radius = np.hypot(x - 0.02, y - 0.001)
        on_arc = (np.abs(radius - 0.001) < 1e-9) & (x > 0.0201)
        assert on_arc.sum() > 100
        assert speed[on_arc].max() <= math.sqrt(2.0 * 0.001) * (1 + 1e-6)
        assert speed[(y > 0.0025) | (y < 0.0005)].max() <= 0.05 * (1 + 1e-9)
        acceleration = np.diff(path.positions, n=2, axis=0) / PERIOD**2
        assert np.linalg.norm(acceleration, axis=1).max() < 2.0 * math.sqrt(2) * 1.02
        assert speed[0] < 1e-3 * 2.0 * SMOOTHING and speed[-1] < 1e-3 * 2.0 * SMOOTHING


def tilted(degrees):
    angle = np.radians(degrees)
    return point([np.sin(angle), 0.0, np.cos(angle)])


def tilt(path):
    return np.degrees(np.arctan2(path.axes[:, 0], path.axes[:, 2]))


@pytest.mark.parametrize("degrees", [1e-7, 60.0, 179.9])
@pytest.mark.parametrize("smoothing", [0.0, 0.02])
def test_the_tool_turns_evenly_along_a_move(degrees, smoothing):
    # The slow curve behind it splits the line where speeds are averaged.
    turn = line((0, 0, 0), (0.05, 0, 0), feed=0.2, axis=tilted(degrees))
    curve = arc((0.05, 0, 0), (0.052, 0.002, 0), (0.05, 0.002, 0), 1, feed=0.2)
    program = Program(
        (line((0, 0, 0), (0, 0, 0)), turn, curve._replace(axis=turn.axis)),
        approach_count=1,
    )
    path = sample_program(program, PERIOD, **LIMITS, smoothing=smoothing)
    along = np.minimum(path.positions[:, 0] / 0.05, 1.0)
    np.testing.assert_allclose(tilt(path), degrees * along, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(path.axes, axis=1), 1.0, rtol=1e-15)


def test_a_turn_to_the_opposite_axis_is_refused():
    moves = line((0, 0, 0), (0, 0, 0)), line((0, 0, 0), (1, 0, 0), axis=tilted(180))
    with pytest.raises(ValueError, match=r"line 7.*opposite"):
        moves = moves[0], moves[1]._replace(line=7)
        sample_program(Program(moves, approach_count=1), PERIOD, **LIMITS)
