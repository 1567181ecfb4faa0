"""A sampled path as G-code that a controller travels at the sampled instants."""

import collections
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...._types import RealScalarLike
from ....toolpath import Move, Path, Program
from ..geometry import program_moves, straight_pieces
from ..text import plain_number
from .frame import ProgramFrame, comment_block

_DECIMALS = 6


def write_gcode(
    path: Path,
    *,
    header: Sequence[str] = (),
    spindle_speed: RealScalarLike | None = None,
    frame: ProgramFrame | None = None,
) -> str:
    """Return a program with one straight move per row in inverse time (G93).

    The program goes to the first row at rapid feed, and from there every row takes
    exactly the time since the row before it, whatever the controller's acceleration.
    A row that repeats the one before it (a dwell) would be a move of no length, which
    has no speed and which controllers skip; it is written one last decimal (1 nm)
    beside, in z, so that its time is kept. Whether a row was rapid is not kept.

    Args:
        path: The path; its tool axis must be +z.
        header: Lines of comment for the top of the program.
        spindle_speed: Speed that the program sets [rad/s]; None sets none.
        frame: What stands before, between and behind the motion; a comment or coolant
            stands before the first row of its line or of a later one.

    Returns:
        The program's text, in millimetres.

    Raises:
        ValueError: If the tool axis is tilted, a number is not finite, or the time
            does not increase.
    """
    time, positions = np.asarray(path.time), np.asarray(path.positions)
    if not path.is_upright:
        raise ValueError(
            "Argument `path` must keep the tool axis along +z, but tilts it; a program "
            "with X, Y and Z only cannot."
        )
    if not (np.all(np.isfinite(positions)) and np.all(np.isfinite(time))):
        raise ValueError("Argument `path` must be finite, but is not.")
    steps = np.diff(time)
    if not np.all(steps > 0):
        raise ValueError("Argument `path` must have increasing time, but has not.")
    points = _distinct(np.round(positions * 1e3, _DECIMALS))
    frame = ProgramFrame() if frame is None else frame
    lines = [comment_block(text) for text in (*header, *frame.comments)]
    lines += ["G17 G21 G90 G93", *frame.opening]
    if spindle_speed is not None:
        lines.append(_spindle_block(float(spindle_speed), frame))
    lines.append(f"G0 {_coordinates(points[0])}")
    between = collections.deque(frame.between)
    numbers = np.asarray(path.line)[1:].tolist()
    for point, step, number in zip(points[1:], steps, numbers, strict=True):
        while between and between[0][0] <= number:
            lines.append(between.popleft()[1])
        lines.append(f"G1 {_coordinates(point)} F{60 / step:.9f}")
    return "\n".join([*lines, *frame.closing]) + "\n"


def _distinct(
    points: Float[np.ndarray, "step 3"],
) -> Float[np.ndarray, "step 3"]:
    """Return points of which none repeats the one before, some moved by 1 nm."""
    points = points + 0.0
    nudge = 10.0**-_DECIMALS
    for row in range(1, len(points)):
        if np.all(np.abs(points[row] - points[row - 1]) < nudge / 2):
            points[row, 2] = round(points[row, 2] + nudge, _DECIMALS)
    return points


def _spindle_block(speed: float, frame: ProgramFrame) -> str:
    """Block that sets the spindle speed [rad/s] and starts the spindle."""
    return f"S{plain_number(round(speed * 30 / math.pi, 6))} {frame.spindle}"


def _coordinates(point: Float[np.ndarray, " 3"]) -> str:
    """Return a point in millimetres as words."""
    x, y, z = (f"{value + 0.0:.{_DECIMALS}f}" for value in point)
    return f"X{x} Y{y} Z{z}"


def write_moves(
    program: Program,
    *,
    header: Sequence[str] = (),
    tolerance: RealScalarLike = 1e-6,
    frame: ProgramFrame | None = None,
) -> str:
    """Return a program as G-code: its lines, arcs, feeds, durations and rests.

    Args:
        program: The program; its tool axis must be +z.
        header: Lines of comment for the top of the program.
        tolerance: How far straight pieces may lie beside an arc whose axis is none of
            x, y and z [m].
        frame: What stands before, between and behind the motion, as `write_gcode` takes
            it; None for the spindle and the end alone.

    Raises:
        ValueError: If the tool axis is tilted.
    """
    moves = program_moves(program)
    if not program.is_upright:
        raise ValueError(
            "the program tilts the tool axis; G-code with X, Y and Z only cannot."
        )
    closing = (*["M5"] * bool(program.spindle_speeds), "M2")
    frame = ProgramFrame(closing=closing) if frame is None else frame
    lines = [comment_block(text) for text in (*header, *frame.comments)]
    lines += ["G17 G21 G40 G49 G90 G94", *frame.opening]
    if program.spindle_speed is not None:
        lines.append(_spindle_block(program.spindle_speed, frame))
    plane, feed, mode = 2, None, 940
    between = collections.deque(frame.between)
    for move in moves:
        while between and between[0][0] <= move.line:
            lines.append(between.popleft()[1])
        normal = [round(value, 9) + 0.0 for value in move.normal]
        is_plane = sorted(map(abs, normal)) == [0.0, 0.0, 1.0]
        whole = [move] if is_plane else straight_pieces(move, float(tolerance))
        for one in whole:
            words = []
            if (
                one.centre is not None
                and abs(normal.index(max(normal, key=abs))) != plane
            ):
                plane = normal.index(max(normal, key=abs))
                words.append(f"G{(19, 18, 17)[plane]}")
            if not one.is_rapid and one.length > 0:
                wanted = 940 if one.duration is None else 930
                if wanted != mode:
                    mode, feed = wanted, None
                    words.append(f"G{mode // 10}")
            words.append(_motion_words(one, plane, normal))
            if one.duration is not None and one.length > 0:
                words.append(f"F{60 / one.duration:.9f}")
            elif one.feed is not None and one.feed != feed:
                feed = one.feed
                words.append(f"F{plain_number(feed * 6e4, 9)}")
            if one.length > 0 or one.duration is None:
                lines.append(" ".join(words))
            seconds = one.rest or (0.0 if one.length > 0 else one.duration or 0.0)
            if seconds:
                lines.append(f"G4 P{plain_number(seconds, 9)}")
    return "\n".join([*lines, *frame.closing]) + "\n"


def _motion_words(move: Move, plane: int, normal: list[float]) -> str:
    """Return the words of one motion, without its feed."""
    end = _coordinates(np.array(move.end) * 1e3)
    if move.centre is None:
        return f"G{0 if move.is_rapid else 1} {end}"
    is_left = move.turn * normal[plane] > 0
    offset = [1e3 * (c - s) for c, s in zip(move.centre, move.start, strict=True)]
    centre = " ".join(
        f"{letter}{offset[axis]:.{_DECIMALS}f}"
        for axis, letter in enumerate("IJK")
        if axis != plane
    )
    turns = f" P{abs(move.turn)}" if abs(move.turn) > 1 else ""
    return f"G{3 if is_left else 2} {end} {centre}{turns}"
