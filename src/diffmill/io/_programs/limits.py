"""Limits of the numbers of a program, the same for every language."""

import math
import re

from ...toolpath import Move, Path, Point

# Larger numbers are faults of writing; RAPID writes 9E9 for an axis that is not there.
LARGEST_NUMBER = 1e10
FARTHEST = 100.0
LARGEST_FEED = 1e7 / 6e4
SHORTEST_DURATION = 1e-7
LONGEST_DURATION = 1e6
LARGEST_SPEED_RPM = 1e6
MOST_TURNS = 10_000
# Two million lines of motion are the longest program that is read.
MOST_MOVES = MOST_LINES = 2_000_000
# A short line may ask for many.
MOST_CYCLE_MOVES = 500_000
DEEPEST_NESTING = 10
# Lines that loops and calls carry out again, calls and blocks in each other, values.
MOST_REPEATED = 250_000
DEEPEST_CALLS = DEEPEST_BLOCKS = 100
MOST_VALUES = 2_000_000
MOST_COPIED = 20_000_000
# Values of an expression; numbers in brackets with nothing else are one.
MOST_OPERANDS = 300_000
# Characters of a line that loops may carry out at the cost of one.
LINE_OF_ONE_STEP = 60
MOST_DIGITS = 300
# A controller's longest line has some hundred characters; comments may be longer.
LONGEST_LINE = 10_000
_LONG_NUMBER = re.compile(rf"\d{{{MOST_DIGITS + 1}}}")
UNUSUAL_SPEED = Path.UNUSUAL_SPEED
# Longer than any cutter rests [s].
UNUSUAL_REST = 60.0


def bounded_number(text: str) -> float:
    """Value of a number as written; NaN where it is none, or too large."""
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if abs(value) <= LARGEST_NUMBER else math.nan


def fault_of_length(text: str) -> str:
    """Fault of a line that is too long, or nothing."""
    if len(text) <= LONGEST_LINE:
        return ""
    return f"the line has {len(text)} characters; {LONGEST_LINE} are allowed."


def fault_of_statement(text: str) -> str:
    """Fault of a statement that no controller writes, or nothing."""
    if len(text) > MOST_DIGITS and _LONG_NUMBER.search(text):
        return f"a number has {MOST_DIGITS} digits at most."
    # Most statements have too few brackets to be nested deeply.
    if sum(map(text.count, "([{")) > DEEPEST_NESTING:
        depth = 0
        for letter in text:
            depth += (letter in "([{") - (letter in ")]}")
            if depth > DEEPEST_NESTING:
                return f"brackets are nested deeper than {DEEPEST_NESTING}."
    return ""


def is_plain(move: Move) -> bool:
    """True if a move is a straight one without a fault, as most are."""
    (x, y, z), feed = move.end, move.feed
    return (
        -FARTHEST <= x <= FARTHEST
        and -FARTHEST <= y <= FARTHEST
        and -FARTHEST <= z <= FARTHEST
        and (feed is None or 0 < feed <= LARGEST_FEED)
        and move.centre is None
        and move.duration is None
    )


def fault_of(move: Move) -> str:
    """Fault of the numbers of a move, or nothing; NaN has a fault of its own."""
    feed, duration, centre = move.feed, move.duration, move.centre
    if not _is_near(move.end):
        return _far("a position", move.end)
    if feed is not None and not (0 < feed <= LARGEST_FEED or math.isnan(feed)):
        return (
            f"found a feed of {feed * 6e4:g} mm/min; allowed is one above 0, up to "
            f"{LARGEST_FEED * 6e4:g} mm/min."
        )
    if duration is not None and not (
        SHORTEST_DURATION <= duration <= LONGEST_DURATION or math.isnan(duration)
    ):
        return (
            f"found a motion of {duration:g} s; allowed are {SHORTEST_DURATION:g} to "
            f"{LONGEST_DURATION:g} s."
        )
    if centre is None:
        return ""
    if not _is_near(centre):
        return _far("the centre of an arc", centre)
    if abs(move.turn) > MOST_TURNS:
        return f"an arc turns {MOST_TURNS} times at most."
    if max(map(abs, centre)) + max(move.radii) > FARTHEST:
        for point in move.bounds:
            if not _is_near(point):
                return _far("a point of an arc", point)
    return ""


def _is_near(point: Point) -> bool:
    """True if a point lies near enough; NaN does."""
    x, y, z = point
    return not (abs(x) > FARTHEST or abs(y) > FARTHEST or abs(z) > FARTHEST)


def _far(what: str, point: Point) -> str:
    """Fault of a point that lies too far away."""
    axis, value = max(zip("xyz", point, strict=True), key=lambda pair: abs(pair[1]))
    return (
        f"found {what} at {axis} = {value:g} m; allowed are {FARTHEST:g} m to either "
        "side of zero."
    )
