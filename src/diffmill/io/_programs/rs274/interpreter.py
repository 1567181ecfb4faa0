"""G-code to moves: RS274/NGC and its dialects as far as they move three axes.

A block is executed in the order of the standard (feed mode, feed, tool, speed, rest,
plane, units, tool length, coordinate system, distance mode, zeros, motion, end),
whatever the order of its words. What is not understood is an error, never skipped, and
all errors of a file are reported together.
"""

import math
import re

from ....toolpath import Move, Point, Program
from ..faults import SHOWN_FAULTS, Fault, ProgramError
from ..geometry import MM_PER_INCH, point_of
from ..limits import FARTHEST, LARGEST_SPEED_RPM
from ..setup import ProgramSetup
from ..sources import Folder, Sources
from .arcs import ArcError, Point2, centre_from_offset, centre_from_radius
from .blocks import ALLOWED_WORDS, CANCELLED, TURNED, Block, sorted_block
from .cycles import CYCLES, run_cycle
from .macros import MACRO, Library, MacroReader, is_fanuc
from .offsets import (
    choose_system,
    compensate_length,
    compensate_radius,
    end_compensation,
    offset_axes,
    set_data,
    set_turns,
    turn_words,
)
from .pace import Pace, find_pace, motion_text, set_feed
from .state import (
    AXES,
    NO_MACHINE_ZERO,
    Cycle,
    State,
    find_shift,
    lose_place,
    machine_zero,
    metres,
    new_state,
    require_place,
)
from .words import Word, split_words

_NO_FOLDER = Folder()
# What the compensation of the cutter's radius does not go with, by modal group.
_NOT_COMPENSATED = ("plane", "system", "tool length", "once")
_NORMALS = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_CENTRE_WORDS = "IJK"
# How far a tool goes up that leaves a cut for the zero of the machine [mm].
_RETRACT = 25.0
# The planes across x, y and z.
_PLANES = (190, 180, 170)
_PROGRAM_NUMBER = re.compile(r"\s*[oO]\s*\d+\s*(\(.*|;.*)?")
_NESTED = re.compile(r"^[^;]*\([^);]*\(")
_NO_MOTION = {
    "end": "stops for the operator, which takes no time here",
    "spindle": "the cutter is taken to be made for a spindle that turns this way",
    "coolant": "coolant changes no motion",
    "overrides": "overrides are at 100 %",
    "path control": "corners are as [program] corner_tolerance says, 0 mm for exact "
    "stops",
    "spindle mode": "the spindle has a constant speed",
    "surface speed": "the spindle speed follows from the job, not from S",
    "orientation": "the spindle stops where the cutter does not cut",
    "signals": "inputs and outputs change no motion, and no wait takes time here",
    "diameter": "X is a radius; how far the control looks ahead changes no path",
    "look-ahead": "how far the control looks ahead changes no path",
    "smoothing": "corners are as [program] corner_tolerance says",
    **dict.fromkeys(CANCELLED - TURNED, "ends what is off here anyway"),
}


def parse_gcode(
    text: str,
    *,
    name: str = "program",
    feed: float | None = None,
    setup: ProgramSetup | None = None,
    folder: Folder = _NO_FOLDER,
) -> Program:
    """Return the moves of G-code text.

    Args:
        text: The text; `read_program` takes it from a file.
        name: Name of the file, for messages.
        feed: Feed of moves for which the text gives none [m/s]; None makes a missing
            feed an error.
        setup: What else the text does not say.
        folder: Folder with the files of subprograms that the text calls.

    Returns:
        The program in SI units, with its text.

    Raises:
        ProgramError: If the text contains anything that is not supported; the message
            lists up to 20 faults with line and word.
    """
    setup = ProgramSetup() if setup is None else setup
    if feed is not None:
        setup = ProgramSetup(**{**vars(setup), "feed": feed})
    state = new_state(setup)
    state.out.name, faults = name, state.out.faults
    is_wrapped = is_closed = False
    is_first = True
    sources = Sources()
    rows = sources.lines(text, name, state.out)
    for number, row in enumerate(rows, 1):
        bare = row.strip(" \t\r")
        is_last = bare == "%" and not any(map(str.strip, rows[number:]))
        if bare == "%" and (is_first or is_wrapped or is_last):
            is_closed = is_wrapped or not is_first
            is_wrapped = True
        elif bare and not _run_line(bare, number, state):
            library = Library(folder, sources)
            try:
                is_closed = _run_macros(
                    rows, number, state, library, is_wrapped=is_wrapped
                )
            except ProgramError as error:
                raise sources.located(error) from None
            break
        # Comments may stand before the tape begins.
        is_first = is_first and (not bare or bare[0] in "(;")
        if is_closed or state.is_ended:
            break
        if len(faults) > SHOWN_FAULTS:
            raise ProgramError(name, faults, ALLOWED_WORDS)
    end_compensation(state)
    if is_wrapped and not (is_closed or state.is_ended):
        message = "the file ends without the closing % or M2 or M30; it may be cut off."
        faults.append(Fault(0, "", message))
    if faults:
        raise sources.located(ProgramError(name, faults, ALLOWED_WORDS))
    return state.out.finish(text)


def _run_macros(
    rows: list[str], first: int, state: State, library: Library, *, is_wrapped: bool
) -> bool:
    """Carry out lines from one on, which has parameters or calls a subprogram.

    Returns:
        Whether a closing % ends them.
    """
    kept: dict[int, str] = {}
    marks = 0
    for number, row in enumerate(rows, 1):
        bare = row.strip(" \t\r")
        marks += bare == "%"
        is_end = bare == "%" and marks == 1 + is_wrapped
        if is_end and (is_wrapped or not any(map(str.strip, rows[number:]))):
            break
        if bare and not (bare == "%" and is_wrapped):
            if bare[0] == "/" and number >= first:
                bare = _undeleted(bare, number, state)
            kept[number] = bare.lstrip("/")
    dialect = state.setup.dialect or ("fanuc" if is_fanuc(kept) else "linuxcnc")
    named = {"fanuc": "Fanuc controls do", "linuxcnc": "LinuxCNC does"}[dialect]
    sentence = f"are carried out as {named} ([program] dialect in a job)"
    state.out.note("parameters, loops and calls", sentence, first)
    MacroReader(state, _run_words, dialect, library).run(kept, first)
    return marks == 1 + is_wrapped


def _undeleted(row: str, number: int, state: State) -> str:
    """A line without its block delete, or nothing where it is left out."""
    if state.setup.skips_blocks:
        state.out.note("/", "lines with a block delete are left out", number)
        return ""
    state.out.note("/", "lines with a block delete are carried out", number)
    # Of several switches (/2 to /9), all are set alike.
    return row[1:].lstrip("0123456789")


def _run_line(row: str, number: int, state: State) -> bool:
    """Read and execute one line of plain words; false if it has others."""
    if row[0] == "/":
        row = _undeleted(row, number, state)
    elif row[0] in "oO:" and not state.out.moves:
        row = row.replace(":", "O", 1)
        if _PROGRAM_NUMBER.fullmatch(row):
            state.out.note(row.split("(")[0].strip(), "is a program number", number)
            return True
    if "(" in row and _NESTED.search(row):
        sentence = "has brackets in it, and ends where all of them are closed"
        state.out.note("a comment", sentence, number)
    faults: list[Fault] = []
    words = _known(split_words(row, number, faults), number, state)
    if not words and not faults:
        return True
    block = sorted_block(words, number, faults)
    if faults and MACRO.search(row):
        return False
    _execute(block, state)
    if faults:
        compact = "".join(row.split())
        state.out.faults += sorted(faults, key=lambda fault: compact.find(fault.word))
    return True


def _run_words(words: list[Word], number: int, state: State) -> list[Fault]:
    """Execute the words of a line; return its faults in their order."""
    faults: list[Fault] = []
    words = _known(words, number, state)
    _execute(sorted_block(words, number, faults), state)
    texts = [word.text for word in words]
    known = [fault for fault in faults if fault.word in texts]
    known.sort(key=lambda fault: texts.index(fault.word))
    return known + [fault for fault in faults if fault.word not in texts]


def _known(words: list[Word], number: int, state: State) -> list[Word]:
    """Words of a line without those that a job passes over, and their own."""
    names = state.setup.pass_over
    if not names:
        return words
    passed = [word for word in words if f"{word.letter}{word.number:g}" in names]
    for word in passed:
        sentence = "is passed over, as [program] pass_over says"
        state.out.note(word.text, sentence, number)
    if not passed:
        return words
    # P, Q, R, S and E belong to it where no other code could take them.
    has_code = any(word.letter in "GM" and word not in passed for word in words)
    own = "" if has_code else "EPQRS"
    return [word for word in words if word not in passed and word.letter not in own]


def _execute(block: Block, state: State) -> None:
    """Carry out one block in the order of the standard."""
    codes = block.g
    if "refused" in codes:
        # What it would have changed is not known, so that its fault has no echo.
        state.motion = -1
        state.position = (math.nan, math.nan, math.nan)
    for word in block.rotary:
        state.out.note(word.text, "the axis does not turn", block.line)
    if "F" in block.values or "feed mode" in codes:
        set_feed(block, state)
    if "D" in block.values:
        # Other controls keep it for the next G41 or G42.
        state.radius_number = block.number("D")
    if "spindle mode" in codes:
        state.is_surface_speed = codes["spindle mode"] == 960
        if state.is_surface_speed:
            state.spindle_rpm = 0.0
    if state.compensation is not None:
        _check_compensated(block, state)
    if block.m or "S" in block.values or "T" in block.values:
        _set_tool(block, state)
        _set_speed(block, state)
        _note_codes(block, block.m, "M", state)
    if codes:
        _set_modes(block, state)
    if state.is_turned or "@" in block.values or "^" in block.values:
        turn_words(block, state)
    if codes.get("once") not in (None, 40, 530):
        _once(block, state)
    elif codes.get("tool length") != 431:
        _move(block, state)
    if len(block.used) < len(block.values):
        _report_unused(block, state)
    state.is_ended = block.m.get("end") in (2, 30)


def _set_modes(block: Block, state: State) -> None:
    """Apply the G codes of a block that move nothing themselves."""
    codes = block.g
    if codes.get("once") == 40:
        duration, text = block.number("P"), block.texts["once"]
        if duration is None:
            block.refuse(text, "a rest needs a P, its seconds.")
        else:
            (state.compensation or state.out).dwell(duration, block.line, text)
    if "plane" in codes:
        state.plane = _PLANES.index(codes["plane"])
        state.is_plane_known = True
    if "units" in codes:
        state.scale = MM_PER_INCH if codes["units"] in (200, 700) else 1.0
    if "cutter radius" in codes:
        compensate_radius(block, state)
    compensate_length(block, state)
    choose_system(block, state)
    if "distance" in codes:
        state.is_incremental = codes["distance"] == 910
    if "retract" in codes:
        state.is_retract_high = codes["retract"] == 980
    if "centres" in codes:
        state.is_centre_absolute = codes["centres"] == 901
    _note_codes(block, codes, "G", state)
    if "path control" in codes:
        block.used.update("PQ")
    if "diameter" in codes:
        block.used.add("P")
    if "look-ahead" in codes:
        block.used.update("PQR")
        if not set("XYZIJ").isdisjoint(block.values):
            message = "a spline is not supported; write it as arcs or lines."
            block.refuse(block.texts["look-ahead"], message, True)
    if not CANCELLED.isdisjoint(codes):
        set_turns(block, state)


def _check_compensated(block: Block, state: State) -> None:
    """Report codes that cannot stand between G41 or G42 and G40."""
    codes = block.g
    groups = [group for group in _NOT_COMPENSATED if codes.get(group, 40) != 40]
    if codes.get("plane") == _PLANES[state.plane]:
        groups.remove("plane")
    if codes.get("motion") in CYCLES:
        groups.append("motion")
    for group in groups:
        message = "it does not go with G41 and G42; needed is a G40 before."
        block.refuse(block.texts[group], message)
    if block.m.get("tool change") is not None:
        message = "a tool is changed behind G40, without a compensation of the radius."
        block.refuse(block.texts["tool change"], message)


def _note_codes(block: Block, codes: dict[str, int], letter: str, state: State) -> None:
    """Note codes that change no motion."""
    for group, code in codes.items():
        if group not in _NO_MOTION or (letter == "M" and code in (2, 3, 5, 13, 30)):
            continue
        sentence = _NO_MOTION["surface speed" if code == 960 else group]
        value = code / 10 if letter == "G" else code
        state.out.note(f"{letter}{value:g}", sentence, block.line)


def _set_tool(block: Block, state: State) -> None:
    """Apply T and M6."""
    number = block.number("T")
    if number is not None and not math.isnan(number):
        if number < 0 or abs(number - round(number)) > 1e-4:
            message = "a tool number is a whole number, not negative."
            block.refuse(block.values["T"].text, message)
        else:
            state.selected_tool = round(number)
            if state.out.tool is None and not state.out.moves:
                state.out.change_tool(state.selected_tool, block.line)
    if block.m.get("tool change") == 61:
        number = block.number("Q")
        if number is None or number < 0 or number % 1:
            message = "M61 needs a Q, the number of the tool."
            block.refuse(block.texts["tool change"], message)
        else:
            state.out.change_tool(int(number), block.line)
    elif "tool change" in block.m:
        if state.selected_tool is not None:
            state.out.change_tool(state.selected_tool, block.line)
        else:
            sentence = "no T says to which tool, and the same one is taken"
            state.out.note(block.texts["tool change"], sentence, block.line)


def _set_speed(block: Block, state: State) -> None:
    """Apply S."""
    number = block.number("S")
    if number is None:
        return
    if not 0 <= number <= LARGEST_SPEED_RPM and not math.isnan(number):
        message = f"a spindle speed lies between 0 and {LARGEST_SPEED_RPM:g} rpm."
        block.refuse(block.values["S"].text, message)
    if state.is_surface_speed:
        return
    state.spindle_rpm = number
    state.out.set_speed(number * 2 * math.pi / 60)


def _once(block: Block, state: State) -> None:
    """Carry out a code that holds for one block and takes its axis words."""
    code = block.g["once"]
    if code == 100:
        set_data(block, state)
    elif code in (280, 300):
        _return_home(block, state)
    elif code in (281, 301):
        require_place(AXES, block.texts["once"], block, state)
        x, y, z = state.position
        z += _known_length(block, state)
        state.references[code == 301] = x, y, z
    else:
        offset_axes(block, state)
    if "motion" in block.g:
        _choose_motion(block.g["motion"], state)


def _return_home(block: Block, state: State) -> None:
    """Go to a reference point of the machine, through the point of the axis words."""
    is_second = block.g["once"] == 300
    # Fanuc controls have a third and a fourth point.
    if is_second and block.number("P") not in (None, 2):
        message = "G30 goes to the second reference point, P2."
        block.refuse(block.texts["once"], message)
    reference = state.references[is_second]
    zero = state.setup.machine_zero
    if reference is None and zero is not None:
        places = zip(zero, state.setup.reference_points[is_second], strict=True)
        reference = point_of(1e3 * (a + b) for a, b in places)
    axes = block.axes()
    through = _end_point(block, state)
    if state.length is None and ("Z" in axes or not axes):
        reference = None
    if reference is None:
        if through != state.position:
            axes_stated = "" if state.is_incremental else "".join(axes)
            _go(block, state, through, Pace(), axes_stated)
        _leave("".join(axes) or AXES, block, state)
        return
    home = list(through)
    for axis, letter in enumerate(AXES):
        if letter in axes or not axes:
            home[axis] = reference[axis]
            state.unknown.pop(letter, None)
    if "Z" in axes or not axes:
        home[2] -= _known_length(block, state)
    _go(block, state, through, Pace(), "")
    _go(block, state, point_of(home), Pace(), "".join(axes) or AXES)


def _leave(axes: str, block: Block, state: State) -> None:
    """Leave by rapid for a place of the machine that is not known."""
    word, out = f"G{block.g['once'] // 10}", state.out
    is_cut = out.has_section and not out.moves[-1].is_rapid
    if axes == "Z" and is_cut and state.compensation is None:
        sentence = "goes up, by an unknown way; it is taken as a rapid move to "
        sentence += f"{_RETRACT:g} mm above the highest place so far"
        out.note(word, sentence, block.line)
        (x, y, _), start = state.position, metres(state.position)
        state.position = x, y, 1e3 * out.highest() + _RETRACT
        end = metres(state.position)
        state.retract = Move(start, end, is_rapid=True, line=block.line)
        state.is_beside = True
        state.unknown["Z"] = word
        return
    sentence = (
        "goes to a place of the machine; without its zero ([program] machine_zero in a "
        "job) and the length of the tool this way is left out"
    )
    out.note(word, sentence, block.line)
    if is_cut and state.retract is None:
        text = block.texts["once"]
        message = f"{NO_MACHINE_ZERO} The tool leaves a cut by it, and cuts again."
        state.unknown_exits[out.tool] = Fault(block.line, text, message)
    lose_place(axes, word, block, state)


def _known_length(block: Block, state: State) -> float:
    """Return the compensated tool length [mm]; that it is not known is a fault."""
    if state.length is None:
        message = (
            "a machine position needs the compensated length of the tool (in a job: "
            f"[program] tool_lengths; {state.length_word})."
        )
        block.refuse(block.texts["once"], message)
        return 0.0
    return state.length


def _move(block: Block, state: State) -> None:
    """Carry out the motion of a block, if it has one."""
    values, axes = block.values, block.axes()
    motion = block.g.get("motion")
    if motion is not None:
        _choose_motion(motion, state)
    elif axes and state.motion == 800 and state.plain_motion is not None:
        state.motion = state.plain_motion
        sentence = f"G{state.motion // 10} goes on behind it, where no motion is chosen"
        state.out.note("G80", sentence, block.line)
    motion = state.motion
    is_arc = motion in (20, 30)
    if not axes and not _moves_without_axes(block, is_arc):
        if motion in CYCLES and "motion" in block.g:
            message = "a canned cycle needs an axis word."
            block.refuse(block.texts["motion"], message)
        return
    if block.is_g_refused or motion == -1:
        block.used.update(values)
    if motion is None or motion == 800:
        if not block.is_g_refused:
            message = "no motion is chosen yet; needed is a G0, G1, G2 or G3 before."
            if block.g.get("motion") == 800:
                message = "G80 moves nothing; needed is a G0, G1, G2 or G3 with it, or "
                message += "a line of its own for the motion."
            block.refuse(values[axes[0]].text, message)
            block.used.update(values)
        motion = -1
    if motion in CYCLES:
        _cycle(block, state)
        return
    is_machine = block.g.get("once") == 530
    if motion in (10, 20, 30) and (state.unknown or state.unknown_exits):
        _require_way(block, state)
    is_known = state.setup.machine_zero is not None
    is_known &= state.length is not None or "Z" not in axes
    if is_machine and motion == 0 and not is_known:
        if axes and not state.is_incremental:
            block.used.update(axes)
            _leave("".join(axes), block, state)
            return
    end = _machine_point(block, state) if is_machine else _end_point(block, state)
    if motion == -1 or block.is_g_refused:
        state.position = end
        return
    pace = Pace()
    if motion != 0:
        pace = find_pace(block, state)
    axes_stated = "" if state.is_incremental and not is_machine else "".join(axes)
    if is_arc:
        _arc(block, state, end, pace)
        return
    _go(block, state, end, pace, axes_stated)


def _choose_motion(motion: int, state: State) -> None:
    """Apply a motion code; a cycle forgets the words of another one."""
    if motion not in (800, *CYCLES):
        state.plain_motion = motion
    if motion != state.motion:
        is_series = motion in CYCLES and state.motion in CYCLES
        state.cycle = Cycle(state.cycle.level if is_series else math.nan)
    state.motion = motion


def _moves_without_axes(block: Block, is_arc: bool) -> bool:
    """True if a block without X, Y and Z is a motion all the same."""
    if block.is_g_refused:
        return False
    if "motion" in block.g:
        return block.g["motion"] not in (*CYCLES, 800)
    return is_arc and any(letter in block.values for letter in "IJKR")


def _require_way(block: Block, state: State) -> None:
    """Report a cut from a place that is not known, or behind a way that is not."""
    require_place(AXES, motion_text(block), block, state)
    if fault := state.unknown_exits.pop(state.out.tool, None):
        block.faults.append(fault)


def _go(block: Block, state: State, end: Point, pace: Pace, axes: str) -> None:
    """Make a straight move; without a pace it is rapid."""
    start, state.position = state.position, end
    is_rapid = state.motion == 0 or block.g.get("once") in (280, 300)
    (state if state.is_beside else state.out).add(
        Move(
            metres(start),
            metres(end),
            None,
            0,
            pace.feed,
            pace.duration,
            is_rapid,
            block.line,
        ),
        axes,
    )


def _cycle(block: Block, state: State) -> None:
    """Carry out a canned cycle."""
    _require_way(block, state)
    pace = find_pace(block, state) if state.feed_mode != 930 else Pace()
    axes = "" if state.is_incremental else "".join(block.axes())

    def go(point: list[float], is_rapid: bool) -> None:
        start, state.position = state.position, point_of(point)
        move = Move(
            metres(start),
            metres(state.position),
            feed=None if is_rapid else pace.feed,
            is_rapid=is_rapid,
            line=block.line,
        )
        state.add(move, axes)

    if state.is_incremental and not {"@", "^"}.isdisjoint(block.values):
        if block.number("L") not in (None, 1):
            message = "several holes of a polar step are not supported; write a line "
            message += "for each."
            block.refuse(block.values["L"].text, message)
            block.used.update(block.values)
            return
    run_cycle(block, state, go)


def _machine_point(block: Block, state: State) -> Point:
    """End of a motion in machine coordinates (G53) [mm]."""
    text = block.texts["once"]
    if state.motion not in (0, 10) or state.is_incremental:
        message = "G53 needs G0 or G1, and G90."
        block.refuse(text, message)
    zero = machine_zero(block, text, state)
    end = list(state.position)
    for axis, letter in enumerate(AXES):
        value = block.number(letter)
        if value is not None and zero is not None:
            end[axis] = zero[axis] + value * state.scale
            if axis == 2:
                end[axis] -= _known_length(block, state)
    return point_of(end)


def _end_point(block: Block, state: State) -> Point:
    """End of a motion in `work` [mm]."""
    x, y, z = state.position
    shift = state.shift or find_shift(block, state)
    end = [x, y, z]
    values, scale = block.values, state.scale
    for axis, letter in enumerate(AXES):
        word = values.get(letter)
        if word is None:
            continue
        block.used.add(letter)
        value = word.number * scale
        if state.is_incremental:
            end[axis] += value
        else:
            end[axis] = value + shift[axis]
            state.unknown.pop(letter, None)
        if abs(end[axis]) > FARTHEST * 1e3:
            message = f"a position is {FARTHEST:g} m at most."
            block.refuse(word.text, message)
            end[axis] = math.nan
    return end[0], end[1], end[2]


def _arc(block: Block, state: State, end: Point, pace: Pace) -> None:
    """Make an arc or a helix in the working plane."""
    start, state.position = state.position, end
    turns = block.number("P")
    if turns is not None and not (turns >= 1 and turns % 1 == 0):
        message = "the number of turns P is a whole number from 1."
        block.refuse(block.values["P"].text, message)
        return
    sign = -1 if state.motion == 20 else 1
    for turn in state.turns.values():
        sign = -sign if turn.is_mirror else sign
    centre = _centre(block, state, start, end, sign)
    if centre is None:
        return
    state.add(
        Move(
            metres(start),
            metres(end),
            metres(centre),
            sign * int(turns or 1),
            pace.feed,
            pace.duration,
            line=block.line,
            normal=_NORMALS[state.plane],
        ),
        "",
    )


def _centre(
    block: Block,
    state: State,
    start: Point,
    end: Point,
    turn: int,
) -> Point | None:
    """Return the centre of an arc at its start's height [mm], or None with a fault."""
    values, scale = block.values, state.scale
    first, second = (state.plane + 1) % 3, (state.plane + 2) % 3
    letters = [_CENTRE_WORDS[axis] for axis in (first, second)]
    across = _CENTRE_WORDS[state.plane]
    stated = [block.number(letter) for letter in letters]
    radius = block.number("R")
    plane = AXES[min(first, second)] + AXES[max(first, second)]
    shown, message = motion_text(block), ""
    if block.number(across) == 0:
        sentence = f"an arc in the {plane} plane has no {across}; 0 changes nothing"
        state.out.note(values[across].text, sentence, block.line)
    elif across in values:
        shown = values[across].text
        message = f"an arc in the {plane} plane has no {across}."
    if message:
        pass
    elif radius is not None and stated != [None, None]:
        shown, message = values["R"].text, "an arc has either R, or its centre."
    elif radius is None and stated == [None, None]:
        message = f"an arc needs its centre ({' and '.join(sorted(letters))}) or its "
        message += "radius (R)."
    elif radius is not None and not {AXES[first], AXES[second]} & set(values):
        shown = values["R"].text
        message = f"an arc with R needs an end {plane[0]} or {plane[1]}."
    elif radius is None and state.is_centre_absolute and None in stated:
        message = "an absolute centre (G90.1) needs both of its words."
    if message:
        block.refuse(shown, message)
        return None
    # In the units of the program, because the tolerances are.
    begin, last = ((at[first] / scale, at[second] / scale) for at in (start, end))
    try:
        if radius is not None:
            centre = centre_from_radius(begin, last, radius, turn, state.arc_tolerance)
        else:
            offset = stated[0] or 0.0, stated[1] or 0.0
            if state.is_centre_absolute:
                shift = find_shift(block, state)
                offset = (
                    offset[0] + shift[first] / scale - begin[0],
                    offset[1] + shift[second] / scale - begin[1],
                )
            centre = centre_from_offset(begin, last, offset, state.arc_tolerance)
    except ArcError as error:
        message = str(error)
        if radius is None:
            message += _other_centre(block, state, begin, last)
        block.refuse(shown, message)
        return None
    out = list(start)
    out[first], out[second] = centre[0] * scale, centre[1] * scale
    return point_of(out)


def _other_centre(block: Block, state: State, begin: Point2, last: Point2) -> str:
    """Hint of a fault: what the centre counts from, or that it fits the other way."""
    first, second = (state.plane + 1) % 3, (state.plane + 2) % 3
    shift = find_shift(block, state)
    words = [block.number(_CENTRE_WORDS[axis]) or 0.0 for axis in (first, second)]
    zero = shift[first] / state.scale - begin[0], shift[second] / state.scale - begin[1]
    letters = " and ".join(sorted(_CENTRE_WORDS[axis] for axis in (first, second)))
    offset = words[0], words[1]
    if not state.is_centre_absolute:
        offset = words[0] + zero[0], words[1] + zero[1]
    try:
        centre_from_offset(begin, last, offset, state.arc_tolerance)
    except ArcError:
        measured = "the place of its centre" if state.is_centre_absolute else ""
        return f" {letters} are {measured or 'measured from the start of the arc'}."
    if state.is_centre_absolute:
        say, key = "as measured from its start, which G91.1 says", "relative"
    else:
        say, key = "as an absolute centre, which G90.1 says", "absolute"
    return f' {letters} fit {say} (in a job: [program] arc_centres = "{key}").'


def _report_unused(block: Block, state: State) -> None:
    """Report words that no code of the line makes use of."""
    if block.is_g_refused:
        return
    unused = [letter for letter in block.values if letter not in block.used]
    for letter in unused:
        if letter == "N":
            continue
        word = block.values[letter]
        if letter in "IJKR":
            message = f"{letter} belongs to an arc, but there is no G2 or G3."
            if state.motion == -1:
                continue
        else:
            message = f"{letter} belongs to no code of its line."
        block.refuse(word.text, message)
