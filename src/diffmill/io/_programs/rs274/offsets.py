"""Words that move, turn or scale the places of a program, and the radius of a tool."""

import cmath
import dataclasses
import math

from ....toolpath import Point
from ..geometry import point_of
from .blocks import Block
from .compensation import CutterCompensation
from .state import (
    AXES,
    State,
    Turn,
    find_shift,
    find_zero,
    lose_place,
    machine_zero,
    require_place,
)

_SYSTEMS = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
_MOST_SYSTEMS = 300


def choose_system(block: Block, state: State) -> None:
    """Apply G54 to G59.3, and G54.1 or G154 with the P of a further system."""
    code = block.g.get("system")
    if code is None:
        return
    state.system, state.shift = f"G{code / 10:g}", None
    if code in (541, 1540):
        number = block.number("P")
        if number is None or not (1 <= number <= _MOST_SYSTEMS and number % 1 == 0):
            message = (
                f"needed is a P from 1 to {_MOST_SYSTEMS}, the number of a system."
            )
            block.refuse(block.texts["system"], message)
            return
        state.system = f"G54.1 P{number:.0f}"


def offset_axes(block: Block, state: State) -> None:
    """Apply G92 and its followers, and G52, which states the same offset."""
    code = block.g["once"]
    if code == 920:
        _state_position(block, state)
        return
    if code == 923:
        state.own_offset = state.stored_offset
    elif code == 520:
        stated = [block.number(letter) for letter in AXES]
        state.own_offset = point_of(
            old if value is None else value * state.scale
            for old, value in zip(state.own_offset, stated, strict=True)
        )
        state.stored_offset = state.own_offset
    else:
        state.own_offset = (0.0, 0.0, 0.0)
        if code == 921:
            state.stored_offset = state.own_offset
    state.shift = None


def _state_position(block: Block, state: State) -> None:
    """Apply G92: the tool is where the words say."""
    axes = block.axes()
    if not axes:
        message = "G92 needs X, Y or Z."
        block.refuse(block.texts["once"], message)
    if state.out.moves:
        require_place("".join(axes), block.texts["once"], block, state)
    shift = list(find_shift(block, state))
    position = list(state.position)
    for letter in axes:
        axis = AXES.index(letter)
        stated = (block.number(letter) or 0.0) * state.scale
        if not state.out.moves:
            # Before any motion the place is not known but stated here.
            position[axis] = stated + shift[axis]
            state.out.known.add(letter)
            state.unknown.pop(letter, None)
        else:
            shift[axis] = position[axis] - stated
    zero = find_zero(state.system, block, state)
    state.position = point_of(position)
    state.own_offset = point_of(a - b for a, b in zip(shift, zero, strict=True))
    state.stored_offset = state.own_offset
    state.shift = None


def set_data(block: Block, state: State) -> None:
    """Apply G10 L2 and L20: the zero of a system."""
    kind, number = block.number("L"), block.number("P")
    text = block.texts["once"]
    if number is not None and number % 1 == 0:
        if _set_tool_data(kind, int(number), block, state):
            return
    if kind not in (2, 20) or block.number("R") not in (None, 0):
        message = (
            "G10 is supported as L2 or L20 without a rotation R, as L1 with Z and R, "
        )
        message += "and as L10 and L12 of Fanuc with R."
        block.refuse(text, message, True)
        return
    if number is None or number not in range(len(_SYSTEMS) + 1):
        message = f"G10 needs a P from 0 to {len(_SYSTEMS)}."
        block.refuse(text, message)
        return
    name = _SYSTEMS[int(number) - 1] if number else state.system
    if kind == 2 and state.setup.machine_zero is None:
        if _set_machine_place(name, block, state):
            return
    zero = _stated_zero(block, kind, name, state)
    if zero is not None:
        state.zeros[name] = zero
        state.shift = None


def _set_machine_place(name: str, block: Block, state: State) -> bool:
    """Keep the zero of a system in machine coordinates, of which only steps count.

    Where the first system that is used lies, nobody needs to know.

    Returns:
        False if the step from an older zero is needed, and not known.
    """
    places = state.machine_places
    if len(block.axes()) < 3 and name not in places:
        return False
    if name in state.zeros and name not in places:
        return False
    old = places.get(name, (0.0, 0.0, 0.0))
    place = list(old)
    for axis, letter in enumerate(AXES):
        value = block.number(letter)
        place[axis] = old[axis] if value is None else value * state.scale
    places[name] = point_of(place)
    if name in state.zeros:
        steps = zip(state.zeros[name], place, old, strict=True)
        state.zeros[name] = point_of(zero + at - was for zero, at, was in steps)
        state.shift = None
    sentence = "states a zero in machine coordinates, of which steps to others count"
    state.out.note("G10 L2", sentence, block.line)
    return True


def _set_tool_data(kind: float | None, number: int, block: Block, state: State) -> bool:
    """Apply G10 L1, of Fanuc L10 and L12: length and radius of a tool, if it is one."""
    setup, scale = state.setup, 1e-3 * state.scale
    lengths, radii = dict(setup.tool_lengths), dict(setup.tool_radii)
    z, radius = block.number("Z"), block.number("R")
    if kind == 1 and block.axes() in ([], ["Z"]):
        length = z
    elif kind in (10, 12) and not block.axes() and radius is not None:
        length, radius = (radius, None) if kind == 10 else (None, radius)
    else:
        return False
    lengths |= {} if length is None else {number: length * scale}
    radii |= {} if radius is None else {number: radius * scale}
    state.setup = dataclasses.replace(setup, tool_lengths=lengths, tool_radii=radii)
    return True


def _stated_zero(block: Block, kind: float, name: str, state: State) -> Point | None:
    """Return the zero of a system that G10 states [mm], or None with a fault."""
    machine = (0.0, 0.0, 0.0)
    if kind == 2:
        machine = machine_zero(block, block.texts["once"], state)
        if machine is None:
            return None
    else:
        axes = "".join(block.axes())
        require_place(axes, block.texts["once"], block, state)
    whole = len(block.axes()) == 3
    zero = [0.0] * 3 if whole else list(find_zero(name, block, state))
    for letter in block.axes():
        axis = AXES.index(letter)
        value = (block.number(letter) or 0.0) * state.scale
        if kind == 2:
            zero[axis] = machine[axis] + value
        else:
            zero[axis] = state.position[axis] - state.own_offset[axis] - value
    return point_of(zero)


def compensate_length(block: Block, state: State) -> None:
    """Apply G43 and G49: the tip is where the program says by another length."""
    code = block.g.get("tool length")
    if code is None:
        return
    text = block.texts["tool length"]
    length, word = 0.0, ""
    if code == 431:
        given = block.number("Z")
        if any(block.number(letter) for letter in "XY") or given is None:
            message = "G43.1 needs Z, the length of the tool, and no X or Y but 0."
            block.refuse(text, message)
            return
        length = given * state.scale
        word = f"G43.1 Z{length:g} mm"
    elif code != 490:
        given = block.number("H")
        if given is not None and math.isnan(given):
            return
        number = state.out.tool if given is None else round(given)
        if number is None:
            message = "G43 needs an H, or a tool before it."
            block.refuse(text, message)
            return
        word = f"H{number}"
        length = _length_of(number, block, state)
        if code == 432:
            word = f"{state.length_word} and {word}"
            if length is not None:
                length = None if state.length is None else length + state.length
    if word == state.length_word:
        return
    if length is None or state.length is None:
        if state.out.moves:
            lose_place("Z", text, block, state)
    elif length != state.length:
        x, y, z = state.position
        state.position = (x, y, z - (length - state.length))
        if state.out.moves and not state.out.is_approach:
            state.out.begin_section(block.line)
    state.length, state.length_word = length, word


def _length_of(number: int, block: Block, state: State) -> float | None:
    """Length that H compensates [mm]; None with a note if it is not known."""
    lengths = state.setup.tool_lengths
    if number in lengths:
        return 1e3 * lengths[number]
    if number == 0:
        return 0.0
    sentence = "its length is not given; the tip is where Z says after it"
    if state.out.tool not in (None, number):
        sentence += f", and tool T{state.out.tool} is taken to have this length"
    state.out.note(f"G43 H{number}", sentence, block.line)
    return None


def compensate_radius(block: Block, state: State) -> None:
    """Apply G40 to G42.1: the tool runs beside the programmed path."""
    code, text = block.g["cutter radius"], block.texts["cutter radius"]
    if code == 400:
        if state.compensation is None:
            sentence = "there is no compensation of the cutter's radius"
            state.out.note("G40", sentence, block.line)
        end_compensation(state)
        return
    if state.compensation is not None or state.plane == 0:
        message = "it is on already; needed is a G40 before."
        if state.plane == 0:
            message = "the radius is compensated in the XY plane or the XZ plane."
        block.refuse(text, message)
        return
    number, radius = state.radius_number, None
    if number is not None and math.isnan(number):
        return
    if code in (411, 421) and number is not None:
        radius = number * state.scale / 2e3
    elif code in (410, 420):
        tool = state.out.tool if number is None else round(number)
        radius = _radius_of(tool, text, block, state)
    if radius is None:
        message = (
            "the radius of the cutter is not known; needed is that of its D (in a "
        )
        message += "job: [program] tool_radii), or of the tool."
        block.refuse(text, message)
        return
    side = 1 if code in (410, 411) else -1
    side = side if radius >= 0 else -side
    sentence = "the path beside the programmed one is that of LinuxCNC; other controls "
    sentence += "enter, leave and go round corners in their own way"
    state.out.note(f"G{code / 10:g}", sentence, block.line)
    state.is_beside = True
    state.compensation = CutterCompensation(state.out, side, abs(radius), state.plane)


def end_compensation(state: State) -> None:
    """End the compensation of the radius; the next move leads back to the path."""
    if state.compensation is not None:
        state.departure = state.compensation.finish()
        state.compensation = None


def _radius_of(tool: int | None, text: str, block: Block, state: State) -> float | None:
    """Radius of a tool [m]; None if nothing tells it."""
    setup = state.setup
    if tool is not None and tool in setup.tool_radii:
        return setup.tool_radii[tool]
    if tool == 0:
        return 0.0
    if setup.radius is not None:
        sentence = f"D{tool} has the radius of the job's cutter, "
        sentence += f"{setup.radius * 1e3:g} mm"
        state.out.note(text, sentence, block.line)
    return setup.radius


def set_turns(block: Block, state: State) -> None:
    """Apply G15, G16, G50, G50.1, G51, G51.1, G68 and G69."""
    codes = block.g
    for group in ("rotation", "scaling", "mirror image"):
        if group not in codes:
            continue
        text = block.texts[group]
        if codes[group] in (500, 501, 690):
            if state.turns.pop(group, None) is None:
                state.out.note(text, "ends what is off here anyway", block.line)
            # On a lathe G50 sets zeros and limits the spindle.
            words = {*"XYZS"} & set(block.values)
            if codes[group] == 501 and "motion" not in codes:
                block.drop("XYZ")
            elif words and codes[group] == 500 and "motion" not in codes:
                message = "it is supported without X, Y, Z and S, as an end."
                block.refuse(text, message, True)
            continue
        turn, message = _turn_of(codes[group], block, state)
        block.drop("XYRP")
        if state.plane != 2 or state.is_incremental or state.compensation is not None:
            message = "it needs the XY plane, G90 and G40."
        if turn is not None and not message:
            state.turns[group] = turn
            state.out.note(text, "is carried out about its X and Y", block.line)
        else:
            block.refuse(text, message)
    state.is_turned = state.is_polar or bool(state.turns)
    if "polar coordinates" in codes:
        if not state.is_polar and codes["polar coordinates"] == 150:
            state.out.note("G15", "ends what is off here anyway", block.line)
        state.is_polar = codes["polar coordinates"] == 160
        state.is_turned = state.is_polar or bool(state.turns)
        if not state.is_polar:
            return
        if state.plane != 2 or state.is_incremental:
            message = "G16 needs the XY plane and G90."
            block.refuse(block.texts["polar coordinates"], message)


def _turn_of(code: int, block: Block, state: State) -> tuple[Turn | None, str]:
    """The turn that a code states, or what it lacks."""
    x, y, angle, factor = (block.number(letter) for letter in "XYRP")
    if code == 511:
        centre = complex(x or 0.0, y or 0.0)
        if x is None and y is None:
            return None, "G51.1 needs X or Y, the place of its mirror."
        if None in (x, y):
            return Turn(centre, -1.0 if y is None else 1.0, is_mirror=True), ""
        return Turn(centre, -1.0), ""
    if x is None or y is None:
        return None, "it needs X and Y, its centre."
    if code == 680:
        if angle is None:
            return None, "G68 needs R, its angle."
        return Turn(complex(x, y), cmath.rect(1.0, math.radians(angle))), ""
    # Z stays as it is only where a factor is 1.
    if factor is None or factor <= 0 or "." not in block.values["P"].text:
        message = "G51 is supported with a P above 0 and a decimal point (without one, "
        message += "controls read it as thousandths or not), and no I, J, K."
        return None, message
    if "Z" in block.values:
        return None, "G51 is supported for X and Y alone; Z would be scaled, too."
    return Turn(complex(x, y), factor), ""


def turn_words(block: Block, state: State) -> None:
    """Put plain X and Y, I and J in the place of words that are polar or turned."""
    values, scale = block.values, state.scale
    is_arc = block.g.get("motion", state.motion) in (20, 30)
    words = {*"XY@^", *"IJR" * is_arc} & set(values)
    if {"system", "once"} & set(block.g) and block.g.get("once") not in (40, 530):
        text = block.texts["system" if "system" in block.g else "once"]
        message = "it does not go with G16, G51, G51.1 or G68, or with @ and ^."
        block.refuse(text, message)
    if not words or "once" in block.g:
        return
    shift = find_shift(block, state)
    at = complex(state.position[0] - shift[0], state.position[1] - shift[1]) / scale
    before = at
    for turn in reversed(state.turns.values()):
        before = turn.before(before)
    x, y = block.number("X"), block.number("Y")
    radius, angle = block.number("@"), block.number("^")
    is_polar = radius is not None or angle is not None
    if is_polar and not (x is None and y is None):
        message = "a polar place (@ and ^) has no X or Y."
        block.refuse(values["@" if "@" in values else "^"].text, message)
    if state.is_polar and not is_polar:
        radius, angle, is_polar = x, y, not (x is None and y is None)
    if is_polar:
        length, direction = abs(before), math.degrees(cmath.phase(before))
        if state.is_incremental:
            radius, angle = length + (radius or 0.0), direction + (angle or 0.0)
        radius = length if radius is None else radius
        angle = direction if angle is None else angle
        place = cmath.rect(radius, math.radians(angle))
    elif state.is_incremental:
        place = before + complex(x or 0.0, y or 0.0)
    else:
        place = complex(
            before.real if x is None else x, before.imag if y is None else y
        )
    way = complex(block.number("I") or 0.0, block.number("J") or 0.0)
    length = block.number("R") if is_arc else None
    for turn in state.turns.values():
        place = turn.place(place)
        is_centre = state.is_centre_absolute and {"I", "J"} <= set(values)
        way = turn.place(way) if is_centre else turn.direction(way)
        length = None if length is None else length * abs(turn.factor)
    if {*"XY@^"} & words:
        require_place("XY" if len({"X", "Y"} & words) < 2 else "", "", block, state)
        made = place - at if state.is_incremental else place
        text = values[min({*"XY@^"} & words)].text
        block.put("X", made.real, text)
        block.put("Y", made.imag, text)
    if {"I", "J"} & words:
        text = values[min({"I", "J"} & words)].text
        block.put("I", way.real, text)
        block.put("J", way.imag, text)
    if length is not None:
        block.put("R", length, values["R"].text)
