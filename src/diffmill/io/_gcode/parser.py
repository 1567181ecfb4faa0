"""G-code to moves: the part of RS274/NGC that a three-axis milling program needs.

A block is executed in the order of the standard (feed mode, feed, speed, tool, units,
distance mode, motion, end), whatever the order of its words. What is not understood is
an error, never skipped, and all errors of a file are reported together.
"""

import math
import os
import pathlib
from dataclasses import dataclass, field

from ...toolpath import Move, Program
from .arcs import (
    INCH_TOLERANCE,
    MM_TOLERANCE,
    ArcError,
    centre_from_offset,
    centre_from_radius,
)
from .blocks import Block, sorted_block
from .words import SHOWN_FAULTS, Fault, GCodeError, split_words

# Refused codes after which the position and the motion mode are still known.
_HARMLESS = frozenset(
    [40, 400, 430, 490, *range(540, 595), 610, 611, 640, 970, 980, 990]
)
_MM_PER_INCH = 25.4
_LARGEST_POSITION_MM = 1e5
_LARGEST_FEED_MM_PER_MIN = 1e7
_LARGEST_SPEED_RPM = 1e6
_SHORTEST_DURATION = 1e-7
_MOST_LINES = 2_000_000


@dataclass
class _State:
    """State between two blocks; NaN marks what a fault made unknown.

    Attributes:
        feed_default: Feed where the program gives none [mm/s], or None.
        position: Tool tip [mm].
        motion: Motion code (0 to 3); None before the first, -1 after a refused one.
        scale: Millimetres per unit of the program.
        feed: Feed [mm/s]; None before the first F word.
        known: Axes whose position the program has stated.
        speeds: Spindle speeds [rad/s], each once, in order.
    """

    feed_default: float | None
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    motion: int | None = None
    scale: float = 1.0
    is_incremental: bool = False
    is_inverse_time: bool = False
    is_plane_known: bool = True
    is_ended: bool = False
    is_approach: bool = True
    feed: float | None = None
    tool: float | None = None
    approach_count: int = 0
    known: set[str] = field(default_factory=set)
    speeds: dict[float, None] = field(default_factory=dict)
    moves: list[Move] = field(default_factory=list)


def read_gcode(file: str | os.PathLike[str], *, feed: float | None = None) -> Program:
    """Return the moves of a G-code file.

    Args:
        file: Path of the file; bytes that are no UTF-8 may stand in comments.
        feed: Feed of moves for which the file gives none [m/s]; None makes a missing
            feed an error.

    Returns:
        The program in SI units, with its text.

    Raises:
        GCodeError: If the file cannot be read or contains anything that is not
            supported; the message lists up to 20 faults with line and word.
    """
    path = pathlib.Path(file)
    try:
        text = path.read_bytes().decode("utf-8-sig", errors="replace")
    except OSError as error:
        reason = error.strerror or "unknown reason"
        fault = Fault(0, "", f"the file cannot be read: {reason}.")
        raise GCodeError(str(path), [fault]) from error
    return parse_gcode(text, name=path.name, feed=feed)


def parse_gcode(
    text: str, *, name: str = "program", feed: float | None = None
) -> Program:
    """Return the moves of G-code text; arguments and errors as `read_gcode`."""
    faults: list[Fault] = []
    state = _State(None if feed is None else feed * 1e3)
    # A lone carriage return ends a line only where there is no line feed at all.
    end = "\n" if "\n" in text else "\r"
    if text.count(end) > _MOST_LINES:
        message = f"the program has more than {_MOST_LINES} lines."
        raise GCodeError(name, [Fault(0, "", message)])
    is_wrapped = is_closed = False
    is_first = True
    for number, row in enumerate(text.split(end), 1):
        bare = row.strip(" \t\r")
        if bare == "%" and (is_first or is_wrapped):
            is_closed = is_wrapped
            is_wrapped = True
        elif bare:
            faults.extend(_run_line(row, number, state))
        is_first = is_first and not bare
        if is_closed or state.is_ended:
            break
        if len(faults) > SHOWN_FAULTS:
            raise GCodeError(name, faults)
    if is_wrapped and not (is_closed or state.is_ended):
        message = "the file ends without the closing % or M2 or M30; it may be cut off."
        faults.append(Fault(0, "", message))
    if not faults and not any(m.length > 0 for m in state.moves):
        message = "the program moves nothing; needed is a G0, G1, G2 or G3 with axes."
        faults.append(Fault(0, "", message))
    if faults:
        raise GCodeError(name, faults)
    return Program(
        tuple(state.moves),
        approach_count=state.approach_count,
        spindle_speeds=tuple(state.speeds),
        source=text,
        name=name,
    )


def _run_line(row: str, number: int, state: _State) -> list[Fault]:
    """Read and execute one line; return its faults in the order of its words."""
    faults: list[Fault] = []
    block = sorted_block(split_words(row, number, faults), number, faults)
    _execute(block, state, faults)
    if not faults:
        return faults
    compact = "".join(row.split())
    return sorted(faults, key=lambda fault: compact.find(fault.word))


def _execute(block: Block, state: _State, faults: list[Fault]) -> None:
    """Carry out one block in the order of the standard."""
    _apply_refused(block, state)
    _set_feed(block, state, faults)
    _set_speed_and_tool(block, state, faults)
    if "units" in block.g:
        state.scale = _MM_PER_INCH if block.g["units"] == 200 else 1.0
    if "distance" in block.g:
        state.is_incremental = block.g["distance"] == 910
    if "plane" in block.g:
        state.is_plane_known = True
    _move(block, state, faults)
    state.is_ended = "end" in block.m


def _apply_refused(block: Block, state: _State) -> None:
    """Forget what a refused G code would have changed, so that it has no echo."""
    code = block.g.get("refused")
    if code is None or code in _HARMLESS:
        return
    state.is_plane_known = False
    if code not in (180, 190):
        state.motion = -1
        state.position = (math.nan, math.nan, math.nan)


def _set_feed(block: Block, state: _State, faults: list[Fault]) -> None:
    """Apply G93, G94 and F."""
    mode = block.g.get("feed mode")
    if mode is not None:
        state.is_inverse_time = mode == 930
        if mode == 940:
            # As LinuxCNC has it: a feed given before G94 is void.
            state.feed = None
    word = block.values.get("F")
    if word is None:
        return
    if word.number < 0:
        faults.append(Fault(block.line, word.text, "a feed must be positive."))
        state.feed = math.nan
    elif not state.is_inverse_time:
        # The standard executes F before G20 and G21: a change of units in the same
        # line does not apply to it.
        if word.number * state.scale > _LARGEST_FEED_MM_PER_MIN:
            message = f"a feed is {_LARGEST_FEED_MM_PER_MIN:g} mm/min at most."
            faults.append(Fault(block.line, word.text, message))
        state.feed = word.number * state.scale / 60


def _set_speed_and_tool(block: Block, state: _State, faults: list[Fault]) -> None:
    """Apply S and T, and check M6."""
    word = block.values.get("S")
    if word is not None:
        if not 0 <= word.number <= _LARGEST_SPEED_RPM and not math.isnan(word.number):
            message = f"a spindle speed lies between 0 and {_LARGEST_SPEED_RPM:g} rpm."
            faults.append(Fault(block.line, word.text, message))
        speed = word.number * 2 * math.pi / 60
        if speed > 0:
            state.speeds[speed] = None
    word = block.values.get("T")
    if word is not None and not math.isnan(word.number):
        if word.number < 0 or abs(word.number - round(word.number)) > 1e-4:
            message = "a tool number is a whole number, not negative."
            faults.append(Fault(block.line, word.text, message))
        elif state.tool is not None and round(word.number) != state.tool:
            message = f"a program uses one tool, and this one has T{state.tool:g}."
            faults.append(Fault(block.line, word.text, message))
        else:
            state.tool = round(word.number)
    if "tool change" in block.m and state.tool is None and word is None:
        message = "a tool change needs a T word before it or in its line."
        faults.append(Fault(block.line, block.texts["tool change"], message))


def _move(block: Block, state: _State, faults: list[Fault]) -> None:
    """Carry out the motion of a block, if it has one."""
    values = block.values
    axes = [letter for letter in "XYZ" if letter in values]
    arc_words = [letter for letter in "IJKR" if letter in values]
    if "motion" in block.g:
        state.motion = motion = block.g["motion"] // 10
    elif axes or (arc_words and state.motion in (2, 3)):
        motion = state.motion
    else:
        motion = None
        if arc_words and state.motion != -1 and not block.is_g_refused:
            _refuse_arc_words(block, arc_words, faults)
        return
    if motion is None:
        if not block.is_g_refused:
            message = "no motion is chosen yet; needed is a G0, G1, G2 or G3 before."
            faults.append(Fault(block.line, values[axes[0]].text, message))
        motion = -1
    end = _end_point(block, state, faults)
    start, state.position = state.position, end
    if motion == -1 or block.is_g_refused:
        return
    if motion in (0, 1):
        _refuse_arc_words(block, arc_words, faults)
    feed, duration = (None, None) if motion == 0 else _pace(block, state, faults)
    turn = {2: -1, 3: 1}.get(motion, 0)
    centre = _centre(block, state, start, end, turn, faults) if turn else None
    if turn and centre is None:
        return
    _track_approach(state, axes, is_rapid=motion == 0)
    state.moves.append(
        Move(
            _metres(start),
            _metres(end),
            centre=None if centre is None else _metres((*centre, start[2])),
            turn=turn,
            feed=None if feed is None else feed * 1e-3,
            duration=duration,
            is_rapid=motion == 0,
            line=block.line,
        )
    )


def _refuse_arc_words(block: Block, letters: list[str], faults: list[Fault]) -> None:
    """Report centre and radius words where there is no arc."""
    for letter in letters:
        message = f"{letter} belongs to an arc, but there is no G2 or G3."
        faults.append(Fault(block.line, block.values[letter].text, message))


def _end_point(
    block: Block, state: _State, faults: list[Fault]
) -> tuple[float, float, float]:
    """Return where a motion ends [mm]."""
    end = list(state.position)
    for axis, letter in enumerate("XYZ"):
        word = block.values.get(letter)
        if word is None:
            continue
        value = word.number * state.scale
        end[axis] = end[axis] + value if state.is_incremental else value
        if abs(end[axis]) > _LARGEST_POSITION_MM:
            message = f"a position is {_LARGEST_POSITION_MM / 1e3:g} m at most."
            faults.append(Fault(block.line, word.text, message))
    return end[0], end[1], end[2]


def _pace(
    block: Block, state: _State, faults: list[Fault]
) -> tuple[float | None, float | None]:
    """Return the feed [mm/s] or the duration [s] of a feed motion."""
    word = block.values.get("F")
    if state.is_inverse_time:
        if word is None or word.number == 0:
            message = "a motion in inverse time (G93) needs an F above 0 in its line."
            shown = _motion_text(block) if word is None else word.text
            faults.append(Fault(block.line, shown, message))
            return None, None
        duration = 60 / word.number
        if 0 < duration < _SHORTEST_DURATION:
            message = f"a move lasts at least {_SHORTEST_DURATION:g} s (F is 60 s / t)."
            faults.append(Fault(block.line, word.text, message))
        return None, duration
    if state.feed is None and state.feed_default is not None:
        return state.feed_default, None
    if state.feed is None:
        message = "there is no feed; needed is an F above 0 in this line or before it"
        message += " (after any G94), or a feed for the whole program."
        faults.append(Fault(block.line, _motion_text(block), message))
    elif state.feed == 0:
        message = "the feed is 0; needed is an F above 0."
        shown = _motion_text(block) if word is None else word.text
        faults.append(Fault(block.line, shown, message))
    return state.feed, None


def _motion_text(block: Block) -> str:
    """Return the word that asks for a motion, as written."""
    if "motion" in block.texts:
        return block.texts["motion"]
    return next(block.values[k].text for k in "XYZIJKR" if k in block.values)


def _centre(
    block: Block,
    state: _State,
    start: tuple[float, float, float],
    end: tuple[float, float, float],
    turn: int,
    faults: list[Fault],
) -> tuple[float, float] | None:
    """Return the centre of an arc [mm], or None after a fault."""
    values = block.values
    shown = _motion_text(block)
    message = ""
    if "K" in values:
        shown, message = values["K"].text, "an arc in the XY plane has no K."
    elif "R" in values and ("I" in values or "J" in values):
        shown, message = values["R"].text, "an arc has either R, or I and J."
    elif not any(letter in values for letter in "IJR"):
        message = "an arc needs its centre (I, J) or its radius (R)."
    elif "R" in values and not ("X" in values or "Y" in values):
        shown, message = values["R"].text, "an arc with R needs an end X or Y."
    if not state.is_plane_known:
        return None
    if message:
        faults.append(Fault(block.line, shown, message))
        return None
    scale = state.scale
    # In the units of the program, because the tolerances are.
    first, last = (start[0] / scale, start[1] / scale), (end[0] / scale, end[1] / scale)
    tolerance = INCH_TOLERANCE if scale == _MM_PER_INCH else MM_TOLERANCE
    try:
        if "R" in values:
            radius = values["R"].number
            centre = centre_from_radius(first, last, radius, turn, tolerance)
        else:
            i, j = (values[k].number if k in values else 0.0 for k in "IJ")
            centre = centre_from_offset(first, last, (i, j), tolerance)
    except ArcError as error:
        faults.append(Fault(block.line, shown, str(error)))
        return None
    return centre[0] * scale, centre[1] * scale


def _track_approach(state: _State, axes: list[str], *, is_rapid: bool) -> None:
    """Count the leading rapid moves whose start the program does not tell."""
    if not state.is_approach:
        return
    if not is_rapid:
        state.is_approach = False
        return
    state.approach_count += 1
    if not state.is_incremental:
        state.known.update(axes)
    state.is_approach = len(state.known) < 3


def _metres(point: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return a point given in millimetres in metres."""
    return point[0] * 1e-3, point[1] * 1e-3, point[2] * 1e-3
