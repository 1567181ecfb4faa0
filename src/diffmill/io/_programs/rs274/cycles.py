"""Canned cycles: drilling, with rests and pecks, as plunges.

The order of the moves is that of LinuxCNC: up to the retract plane if the tool is below
it, across, down to the retract plane, the plunge, and out again.
"""

import math
from collections.abc import Callable

from ....toolpath import Point
from ..geometry import MM_PER_INCH
from .blocks import Block
from .pace import motion_text
from .state import AXES, Cycle, State, find_shift

CYCLES = frozenset([730, 810, 820, 830, 850, 860, 890])
_WITH_REST = frozenset([820, 860, 890])
_WITH_PECK = frozenset([730, 830])
# How far above the last depth, or how far out, a peck goes by rapid [inch].
_PECK_CLEARANCE = 0.01

# Makes a move to a point; the flag tells whether it is rapid.
Go = Callable[[list[float], bool], None]


def run_cycle(block: Block, state: State, go: Go) -> None:
    """Make the moves of a canned cycle.

    Args:
        block: A block with axis words.
        state: State before it; its cycle words are updated.
        go: Makes a move from where the tool is.
    """
    depth = state.plane
    shift = find_shift(block, state)
    _take_words(block, state)
    cycle = _resolved(state, shift)
    # K of Fanuc controls is L of others.
    repeats = block.number("L" if "L" in block.values else "K")
    if any(math.isnan(word.number) for word in block.values.values()):
        return
    message = _fault(block, state, cycle, repeats)
    if message:
        block.refuse(motion_text(block), message)
        block.used.update(block.values)
        return
    place, step = _first_hole(block, state, shift)
    at = list(state.position)
    retract, bottom = cycle.retract, cycle.bottom
    if retract < bottom:
        message = "the retract plane R lies below the bottom of the hole."
        block.refuse(motion_text(block), message)
        return
    if cycle.level < retract:
        at[depth] = retract
        go(at, True)
    clear = max(cycle.level, retract) if state.is_retract_high else retract
    # After holes with G99, the way to the first with G98 leads up there.
    at[depth] = max(at[depth], clear)
    count = 1 if repeats is None else int(repeats)
    pecks = (retract - bottom) / cycle.peck if state.motion in _WITH_PECK else 1
    state.out.reserve(3 * count * pecks, block.line)
    for _ in range(count):
        place = [a + b for a, b in zip(place, step, strict=True)]
        go(_at(place, at[depth], depth), True)
        if at[depth] != retract:
            go(_at(place, retract, depth), True)
        _plunge(state, cycle, place, block.line, go)
        if state.motion == 850:
            go(_at(place, retract, depth), False)
        go(_at(place, clear, depth), state.motion != 890)
        at[depth] = clear


def _take_words(block: Block, state: State) -> None:
    """Keep the words of the cycle; those of earlier blocks hold where it has none."""
    cycle = state.cycle
    if math.isnan(cycle.level):
        cycle.level = state.position[state.plane]
    words = {"bottom": AXES[state.plane], "retract": "R"}
    # Words of other cycles stay unused, and are reported as such.
    if state.motion in _WITH_REST | _WITH_PECK:
        words["rest"] = "P"
    if state.motion in _WITH_PECK:
        words["peck"] = "Q"
    for name, letter in words.items():
        if (number := block.number(letter)) is not None:
            setattr(cycle, name, number)


def _resolved(state: State, shift: Point) -> Cycle:
    """Return the cycle in `work` [mm]: its numbers count by the modes of the block."""
    cycle, scale, zero = state.cycle, state.scale, shift[state.plane]
    high = cycle.level if state.is_incremental else zero
    retract = cycle.retract * scale + high
    bottom = cycle.bottom * scale + (retract if state.is_incremental else zero)
    return Cycle(cycle.level, bottom, retract, cycle.rest, cycle.peck * scale)


def _fault(block: Block, state: State, cycle: Cycle, repeats: float | None) -> str:
    """Fault of the words of a cycle, "" if they are right."""
    if state.feed_mode == 930:
        return "a canned cycle has no duration of its own; use G94 or G95."
    if math.isnan(cycle.bottom):
        return f"a canned cycle needs the bottom of the hole ({AXES[state.plane]})."
    if math.isnan(cycle.retract):
        return "a canned cycle needs its retract plane R."
    if state.motion in _WITH_REST and not cycle.rest >= 0:
        return "this cycle needs a P (time at the bottom, in seconds)."
    if state.motion in _WITH_PECK and not cycle.peck > 0:
        return "this cycle needs a Q above 0 (depth of a peck)."
    if repeats is not None and not (repeats >= 1 and repeats % 1 == 0):
        return "the number of repetitions L or K is a whole number from 1."
    depth = {AXES[state.plane], "R"}
    if "K" in block.values and state.is_incremental and not depth <= set(block.values):
        # LinuxCNC counts those of a G90 before from the tool, Fanuc controls do not.
        return "K in G91 needs R and the bottom of the hole in its line."
    return ""


def _first_hole(
    block: Block, state: State, shift: Point
) -> tuple[list[float], list[float]]:
    """Place a step before the first hole of a row, and the step to each [mm].

    The step is zero unless the program states relative places.
    """
    place, step = list(state.position), [0.0] * 3
    for axis, letter in enumerate(AXES):
        value = None if axis == state.plane else block.number(letter)
        if value is None:
            continue
        if state.is_incremental:
            step[axis] = value * state.scale
        else:
            place[axis] = value * state.scale + shift[axis]
    return place, step


def _at(place: list[float], depth: float, axis: int) -> list[float]:
    """Return a point over a hole."""
    point = list(place)
    point[axis] = depth
    return point


def _plunge(state: State, cycle: Cycle, place: list[float], line: int, go: Go) -> None:
    """Make the moves from the retract plane to the bottom of a hole."""
    depth, retract, bottom = state.plane, cycle.retract, cycle.bottom
    if state.motion in _WITH_PECK:
        clearance = _PECK_CLEARANCE * MM_PER_INCH
        level = retract - cycle.peck
        while level > bottom:
            go(_at(place, level, depth), False)
            if state.motion == 830:
                go(_at(place, retract, depth), True)
            go(_at(place, level + clearance, depth), True)
            level -= cycle.peck
    go(_at(place, bottom, depth), False)
    # Behind pecks only some programs state a rest.
    if state.motion in _WITH_REST | _WITH_PECK and not math.isnan(cycle.rest):
        state.out.dwell(cycle.rest, line)
