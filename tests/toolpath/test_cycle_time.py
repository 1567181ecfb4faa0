"""What a program takes its time for, and joints that slow it down."""

import itertools
import math
from typing import Any

import numpy as np
import pytest

from diffmill.toolpath import (
    Move,
    Program,
    TimedProgram,
    TimingLimits,
    sample_program,
)

FEED, ACCELERATION, PERIOD = 0.05, 2.0, 1e-3
LIMITS = TimingLimits(ACCELERATION, rapid_feed=0.2, corner_tolerance=0.0)
# A joint that nothing limits.
FREE = np.inf


def program(*points, feed=FEED):
    pairs = itertools.pairwise((float(x), float(y), float(z)) for x, y, z in points)
    return Program(
        tuple(Move(a, b, feed=feed, line=k) for k, (a, b) in enumerate(pairs, 1))
    )


def slides(path, speed, acceleration=(FREE,) * 3):
    """Return three slides along the axes, whose positions are those of the tool."""
    return {
        "path": path,
        "q": path.positions,
        "names": ("x", "y", "z"),
        "speed": np.array(speed),
        "acceleration": np.array(acceleration),
    }


def rates(path):
    return np.diff(path.positions, axis=0) / PERIOD


def test_a_line_loses_its_ramps():
    time = TimedProgram.of(program((0, 0, 0), (0.1, 0, 0)), LIMITS).cycle_time
    assert time.programmed == pytest.approx(0.1 / FEED)
    ((cause, seconds),) = time.lost
    # Speeding up and slowing down each take v / a, for half of that way.
    assert cause == "acceleration" and seconds == pytest.approx(FEED / ACCELERATION)
    assert time.worst == ((1, "acceleration", pytest.approx(seconds)),)


def test_smoothing_costs_its_time_between_two_stops():
    corner = program((0, 0, 0), (0.1, 0, 0), (0.1, 0.1, 0))
    plain = TimedProgram.of(corner, LIMITS).cycle_time
    smooth = TimedProgram.of(corner, LIMITS._replace(smoothing=0.05)).cycle_time
    assert dict(smooth.lost)["jerk"] == pytest.approx(2 * 0.05)
    assert smooth.total == pytest.approx(plain.total + 2 * 0.05)


def test_a_curve_costs_what_it_is_slower():
    radius, feed = 1e-3, 0.1
    start, end = (0.0, 0.0, 0.0), (2 * radius, 0.0, 0.0)
    arc = Move(start, end, centre=(radius, 0.0, 0.0), turn=-1, feed=feed, line=1)
    lines = (
        Move((0.0, -0.1, 0.0), start, feed=feed, line=2),
        arc,
        Move(end, (2 * radius, -0.1, 0.0), feed=feed, line=3),
    )
    time = TimedProgram.of(Program(lines), LIMITS).cycle_time
    slow = math.sqrt(ACCELERATION * radius)
    expected = math.pi * radius * (1 / slow - 1 / feed)
    assert dict(time.lost)["curves"] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("smoothing", [0.0, 0.05])
def test_parts_add_up_to_the_path(smoothing):
    points = [(0, 0, 0), (0.03, 0, 0), (0.03, 0.02, 0), (0.01, 0.03, 0.005)]
    limits = LIMITS._replace(corner_tolerance=1e-3, smoothing=smoothing)
    timed = TimedProgram.of(program(*points), limits)
    time = timed.cycle_time
    assert time.total == pytest.approx(time.programmed + sum(s for _, s in time.lost))
    rows = timed.path(PERIOD).step_count
    assert (rows - 2) * PERIOD < time.total <= (rows - 1) * PERIOD + 1e-9


def test_stated_times_lose_nothing():
    moves = (
        Move((0.0, 0.0, 0.0), (0.01, 0.0, 0.0), duration=0.3, line=1),
        Move((0.01, 0.0, 0.0), (0.01, 0.0, 0.0), duration=0.2, line=2),
    )
    time = TimedProgram.of(Program(moves), LIMITS).cycle_time
    assert time.total == time.programmed == pytest.approx(0.5) and not time.lost


def test_a_slow_joint_slows_the_tool():
    # Along a diagonal the slide moves at 1 / sqrt(2) of the tool's speed.
    given = program((0, 0, 0), (0.1, 0.1, 0))
    timed = TimedProgram.of(given, LIMITS)
    path = timed.path(PERIOD)
    most = 0.02
    slowed = timed.within(**slides(path, (most, FREE, FREE)))
    fastest = np.abs(rates(slowed.path(PERIOD))[:, 0]).max()
    assert 0.97 * most < fastest <= most
    assert slowed.cycle_time.lost[0][0] == "joint x"
    assert timed.within(**slides(path, (1.0,) * 3)) is timed


def test_only_the_part_of_a_slow_joint_is_slower():
    given = program((0, 0, 0), (0.1, 0, 0), (0.1, 0.1, 0))
    timed = TimedProgram.of(given, LIMITS)
    path = timed.path(PERIOD)
    slowed = timed.within(**slides(path, (FREE, 0.01, FREE)))
    rate = np.abs(rates(slowed.path(PERIOD)))
    assert rate[:, 0].max() == pytest.approx(FEED, rel=1e-6)
    assert 0.0097 < rate[:, 1].max() <= 0.01
    lost = {line: s for line, cause, s in slowed.cycle_time.worst if "y" in cause}
    # The corner itself may be passed a little slower.
    assert lost[2] > 100 * lost.get(1, 0.0)


@pytest.mark.parametrize("smoothing", [0.0, 0.02])
def test_joints_keep_their_accelerations(smoothing):
    # A circle: each slide swings, at its ends by v^2 / r.
    radius, most = 0.02, 0.1
    circle = Move(
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0),
        centre=(radius, 0.0, 0.0),
        turn=1,
        feed=0.1,
        line=1,
    )
    limits = LIMITS._replace(smoothing=smoothing)
    timed = TimedProgram.of(Program((circle,)), limits)
    path = timed.path(PERIOD)
    course = slides(path, (1.0,) * 3, (most,) * 3)
    slowed = timed.within(**course).path(PERIOD)
    found = np.diff(slowed.positions, 2, axis=0) / PERIOD**2
    assert np.abs(np.diff(path.positions, 2, axis=0) / PERIOD**2).max() > 4 * most
    assert np.abs(found).max() <= most
    # Not needlessly slow: half of it is left for the way's own acceleration.
    assert np.abs(found).max() > 0.4 * most
    # The tool stays on the circle.
    gap = (
        np.linalg.norm(slowed.positions[:, :2] - np.array([radius, 0]), axis=1) - radius
    )
    assert np.abs(gap).max() < 1e-12


# Rows of a cutter of two teeth at 8000 rpm, 0.75 mm apart in a rapid move.
COARSE = 3.75e-3
# How joints turn with the tool, about 3 rad/m each.
TURNS = np.array([[3.0, 1.0, 0.0], [0.0, 3.0, 1.0], [1.0, 0.0, 3.0]])


def slowed_for(timed, speed, ramp=FREE, passes=2):
    """Return shares of their limits that three joints take in a slowed program.

    Args:
        timed: The program.
        speed: Fastest turning of each joint [rad/s].
        ramp: Time in which it reaches this [s]; any if it is infinite.
        passes: How often the program is slowed down.
    """
    joints = lambda path: np.arctan(path.positions @ TURNS)
    # No limit where there is no ramp.
    acceleration = np.full(3, FREE if np.isinf(ramp) else speed / ramp)
    limits = {"speed": np.full(3, speed), "acceleration": acceleration}
    for _ in range(passes):
        path = timed.path(COARSE)
        timed = timed.within(path, joints(path), names=("a", "b", "c"), **limits)
    q = joints(timed.path(COARSE))
    rate = np.abs(np.diff(q, axis=0)).max() / COARSE
    change = np.abs(np.diff(q, 2, axis=0)).max() / COARSE**2
    return rate / speed, change / acceleration[0]


def test_joints_keep_their_speeds_in_a_small_circle_behind_a_rapid():
    # Rows of the rapid move are farther apart than the circle is wide.
    centre, end = (0.0, 5e-4, 0.0), (0.0, 0.0, 0.0)
    moves = (
        Move((-0.1, 0.0, 0.0), end, is_rapid=True, line=1),
        Move(end, end, centre=centre, turn=1, feed=FEED, line=2),
    )
    timed = TimedProgram.of(Program(moves), LIMITS)
    rate, _ = slowed_for(timed, 0.05, passes=1)
    assert 0.95 < rate <= 1.0


@pytest.mark.parametrize("tolerance", [1e-5, 1e-4])
def test_joints_keep_their_accelerations_in_a_tight_corner(tolerance):
    # At 10 um the tool is round the corner within two rows.
    rapid = Move((-0.1, 0.0, 0.0), (0.0, 0.0, 0.0), is_rapid=True, line=1)
    corner = program((0, 0, 0), (0.05, 0, 0), (0.05, 0.05, 0)).moves
    limits = LIMITS._replace(corner_tolerance=tolerance)
    timed = TimedProgram.of(Program((rapid, *corner)), limits)
    rate, change = slowed_for(timed, 0.2, ramp=0.2)
    assert rate <= 1.0 and 0.5 < change <= 1.0


def random_program(random):
    """Return lines, arcs and rapid moves through random points, some mm long."""
    moves, here = [], np.zeros(3)
    for line in range(1, 1 + int(random.integers(2, 7))):
        kind = random.choice(["line", "arc", "rapid"], p=[0.5, 0.25, 0.25])
        there = here + 10 ** random.uniform(-3.0, -1.8) * random.normal(size=3)
        how: dict[str, Any] = {"feed": 10 ** random.uniform(-2.0, -1.0)}
        if kind == "rapid":
            how = {"is_rapid": True}
        if kind == "arc":
            first, sweep = random.uniform(0.0, 6.28), random.uniform(0.3, 6.0)
            radius = 10 ** random.uniform(-3.3, -2.0)
            spokes = [
                radius * np.array([np.cos(x), np.sin(x), 0.0])
                for x in (first, first + sweep)
            ]
            centre = here - spokes[0]
            there = centre + spokes[1]
            how |= {"centre": tuple(centre.tolist()), "turn": 1}
        start: Any = tuple(here.tolist())
        end: Any = tuple(there.tolist())
        moves.append(Move(start, end, line=line, **how))
        here = there
    return Program(tuple(moves))


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
@pytest.mark.parametrize("tolerance", [0.0, 1e-5, 1e-4])
def test_joints_keep_their_limits_on_random_programs(tolerance, smoothing):
    random = np.random.default_rng(3)
    for _ in range(15):
        acceleration = 10 ** random.uniform(-0.5, 0.7)
        limits = TimingLimits(acceleration, 0.2, tolerance, smoothing=smoothing)
        timed = TimedProgram.of(random_program(random), limits)
        speed = 10 ** random.uniform(-1.7, -0.3)
        rate, change = slowed_for(timed, speed, ramp=0.2)
        assert rate <= 1.001 and change <= 1.001


def test_rest_before_and_after_a_path_changes_no_limit():
    timed = TimedProgram.of(program((0, 0, 0), (0.01, 0.01, 0), (0, 0.02, 0)), LIMITS)
    plain, rested = (
        timed.within(**slides(path, (0.02, FREE, FREE)))
        for path in (timed.path(PERIOD), timed.path(PERIOD).with_standstill(7))
    )
    assert plain.along == rested.along != ()


def test_rows_of_another_program_are_refused():
    timed = TimedProgram.of(program((0, 0, 0), (0.1, 0, 0)), LIMITS)
    other = TimedProgram.of(program((0, 0, 0), (0.05, 0, 0)), LIMITS).path(PERIOD)
    with pytest.raises(ValueError, match="rows of this program"):
        timed.within(**slides(other, (0.02, FREE, FREE)))


def test_another_program_is_timed_alike():
    given = program((0, 0, 0), (0.1, 0.1, 0))
    timed = TimedProgram.of(given, LIMITS)
    path = timed.path(PERIOD)
    slowed = timed.within(**slides(path, (0.02, FREE, FREE)))
    again = slowed.timing.timed(given).path(PERIOD)
    np.testing.assert_array_equal(again.positions, slowed.path(PERIOD).positions)


@pytest.mark.parametrize("name", TimingLimits._fields)
def test_bad_limits_are_refused(name):
    limits = LIMITS._replace(**{name: -1.0})
    with pytest.raises(ValueError, match=name):
        TimedProgram.of(program((0, 0, 0), (0.1, 0, 0)), limits)


def test_sampling_is_that_of_a_timed_program():
    given = program((0, 0, 0), (0.1, 0, 0), (0.1, 0.1, 0))
    path = sample_program(given, PERIOD, **LIMITS._asdict())
    same = TimedProgram.of(given, LIMITS).path(PERIOD)
    np.testing.assert_array_equal(path.positions, same.positions)
