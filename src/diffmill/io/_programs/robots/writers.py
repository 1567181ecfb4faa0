"""Programs as KRL, RAPID and APT: straight moves, arcs as such or in pieces."""

import functools
import math
import re
from collections.abc import Callable, Sequence

from ....toolpath import Move, Point, Program
from ..geometry import (
    ToolAxis,
    abc_of_rotation,
    arc_parts,
    arc_points,
    controller_matrix,
    program_moves,
    quaternion_of_rotation,
    straight_pieces,
)
from .robot_frame import RobotFrame, robot_frame

# Beyond this angle a controller could take the other way round a circle.
_LARGEST_ARC = math.radians(170.0)
_FLATNESS = 1e-7


def write_krl(
    program: Program,
    *,
    header: Sequence[str] = (),
    tolerance: float = 1e-6,
    is_spline: bool = False,
    tool_axis: ToolAxis = "z",
) -> str:
    """Return a program as KRL.

    What its source in KRL says around the motion stays: base, tool, outputs, comments.
    Moves with a duration become a SPLINE block whose TIME_BLOCKs state it. Positions
    are in the base that is in force, which is `work`, of the tool's tip. Where the
    program leaves the rotation about the tool axis open, x of the tool is as near to x
    of `work` as it can be.

    Args:
        program: The program.
        header: Lines of comment.
        tolerance: How far the pieces of a helix may lie beside it [m].
        is_spline: Whether moves with a duration are points of a cubic spline (SPL)
            instead of straight (SLIN).
        tool_axis: Axis of the controller's tool that points from the shank to the tip.
    """
    name = re.sub(r"\W", "_", program.name.split(".")[0])[:24] or "part"
    around = _around(program, ".src", tool_axis)
    lines = ["&ACCESS RVP", f"DEF {name if name[0].isalpha() else 'p' + name}( )"]
    texts = (*header, *around.comments, *_reminder(program, tool_axis, around))
    lines += [f";{' '.join(text.split())}" for text in texts]
    lines += around.opening
    frame = _frames(program, tool_axis)
    feed, timed = None, []
    moves = _placed(program, tolerance)
    for index, move in enumerate(moves):
        goes = _goes(move) or _turns(moves, index)
        if move.duration is not None and goes:
            timed.append(move)
            if move.rest:
                lines += [*_time_blocks(timed, is_spline, frame), _krl_dwell(move.rest)]
                timed = []
            continue
        lines += _time_blocks(timed, is_spline, frame)
        timed = []
        if move.feed is not None and move.feed != feed:
            feed = move.feed
            lines.append(f"$VEL.CP={feed:.9g}")
        if move.centre is not None:
            middle = frame(move._replace(end=_middle(move)))
            lines.append(f"CIRC {middle},{frame(move)}")
        elif index == 0 or goes:
            word = "PTP" if move.is_rapid else "LIN"
            place = frame(move)
            if index == 0 and len(program.first_status) == 2:
                status, turn = (int(one) for one in program.first_status)
                place = f"{place[:-1]},S {status},T {turn}}}"
            lines.append(f"{word} {place}")
        seconds = move.rest or (move.duration or 0.0)
        if seconds:
            lines.append(_krl_dwell(seconds))
    lines += _time_blocks(timed, is_spline, frame)
    return "\n".join([*lines, *around.closing, "END"]) + "\n"


def _krl_dwell(seconds: float) -> str:
    """Return a rest."""
    return f"WAIT SEC {seconds:.9g}"


def _around(program: Program, suffix: str, tool_axis: ToolAxis) -> RobotFrame:
    """Lines around the motion in the source of a program of the same language.

    Its tool is that of the positions only where the same axis of it points to the tip.
    """
    if program.tool_axis != tool_axis:
        return RobotFrame()
    return robot_frame(program.source, suffix, [move.line for move in program.moves])


def _reminder(
    program: Program, tool_axis: ToolAxis, around: RobotFrame
) -> tuple[str, ...]:
    """Reminder of the settings that the file needs before it runs on a robot."""
    if around.states_frames:
        text = (
            "base, tool and outputs are those of the program that was corrected; see "
        )
        return (f"{text}to the way to the first point before it runs",)
    speed = program.spindle_speed
    spindle = "" if speed is None else f" at {speed * 30 / math.pi:g} rpm"
    return (
        "motion only: before it runs, see to the base (zero of the workpiece), the "
        f"tool (its tip, {tool_axis} of it pointing from the shank to the tip), the "
        f"way there, and the spindle{spindle}",
    )


def write_rapid(
    program: Program,
    *,
    header: Sequence[str] = (),
    tolerance: float = 1e-6,
    tool_axis: ToolAxis = "z",
) -> str:
    """Return a program as a module of RAPID; arguments as `write_krl`."""
    around = _around(program, ".mod", tool_axis)
    lines = ["MODULE part", *(f"  {one}" for one in around.data), "  PROC main()"]
    texts = (*header, *around.comments, *_reminder(program, tool_axis, around))
    lines += [f"    ! {' '.join(text.split())}" for text in texts]
    lines += [f"    {one};" for one in around.opening]
    held = around.held
    moves = _placed(program, tolerance)
    for index, move in enumerate(moves):
        goes = _goes(move) or _turns(moves, index)
        is_last = index == len(moves) - 1 or moves[index + 1].is_rapid
        zone = "fine" if is_last or move.is_rapid or move.rest else "z0"
        speed = "vmax"
        if move.duration is not None:
            speed = f"v1000\\T:={move.duration:.9g}"
        elif move.feed is not None:
            speed = f"v1000\\V:={move.feed * 1e3:.9g}"
        status = program.first_status if index == 0 else ()
        end = _target(move, tool_axis, status)
        if move.centre is not None:
            middle = _target(move._replace(end=_middle(move)), tool_axis)
            lines.append(f"    MoveC {middle},{end},{speed},{zone},{held};")
        elif index == 0 or goes:
            word = "MoveJ" if move.is_rapid else "MoveL"
            lines.append(f"    {word} {end},{speed},{zone},{held};")
        seconds = move.rest or (0.0 if goes else move.duration or 0.0)
        if seconds:
            lines.append(f"    WaitTime {seconds:.9g};")
    lines += [f"    {one};" for one in around.closing]
    return "\n".join([*lines, "  ENDPROC", "ENDMODULE"]) + "\n"


def write_apt(
    program: Program, *, header: Sequence[str] = (), tolerance: float = 1e-6
) -> str:
    """Return a program as APT; a duration becomes a feed; arguments as `write_krl`."""
    lines = ["PARTNO/diffmill", "UNITS/MM"]
    # A $ would go on in the next line.
    texts = (" ".join(text.replace("$", "S").split()) for text in header)
    lines += [f"PPRINT/{text}" for text in texts]
    if program.spindle_speed is not None:
        lines.append(f"SPINDL/{program.spindle_speed * 30 / math.pi:.9g},RPM,CLW")
    feed, before = None, None
    for move in program_moves(program):
        pieces = straight_pieces(move, tolerance, before=before)
        before = move
        for piece in pieces:
            speed = piece.feed
            if piece.duration and _goes(piece):
                speed = piece.length / piece.duration
            if piece.is_rapid:
                lines.append("RAPID")
                feed = None
            elif speed is not None and speed != feed:
                feed = speed
                lines.append(f"FEDRAT/{feed * 6e4:.9g},MMPM")
            words = [_short(1e3 * value) for value in piece.end]
            words += [_short(value, 9) for value in piece.axis]
            lines.append("GOTO/" + ",".join(words))
            seconds = piece.rest or (0.0 if _goes(piece) else piece.duration or 0.0)
            if seconds:
                lines.append(f"DELAY/{seconds:.9g}")
    return "\n".join([*lines, "FINI"]) + "\n"


def _placed(program: Program, tolerance: float) -> list[Move]:
    """Return the moves, arcs that no circle statement can make in pieces."""
    out, before = [], None
    for move in program_moves(program):
        is_flat = (
            abs(move.rise) < _FLATNESS
            and abs(move.radii[0] - move.radii[1]) < _FLATNESS
        )
        if move.centre is None:
            out.append(move)
        elif not is_flat or move.duration is not None:
            out.extend(straight_pieces(move, tolerance, before=before))
        else:
            # A circle statement makes less than half a turn.
            count = max(1, math.ceil(abs(move.sweep) / _LARGEST_ARC))
            sign = 1 if move.turn > 0 else -1
            parts = arc_parts(move, count, before=before)
            out.extend(part._replace(turn=sign) for part in parts)
        before = move
    return out


def _middle(move: Move) -> Point:
    """Return the middle of an arc."""
    x, y, z = arc_points(move, 2)[0].tolist()
    return x, y, z


def _goes(move: Move) -> bool:
    """True if a move leads to another place."""
    return move.length > 0


def _turns(moves: Sequence[Move], index: int) -> bool:
    """True if a move leads to another orientation, as written, than before."""
    one, other = moves[index], moves[index - 1] if index else moves[index]
    if (one.axis, one.tool_x) == (other.axis, other.tool_x):
        return False
    before, after = (_target(move._replace(end=one.end), "z") for move in (other, one))
    return before != after


def _time_blocks(
    moves: list[Move], is_spline: bool, frame: Callable[[Move], str]
) -> list[str]:
    """Return moves with durations as a SPLINE block."""
    if not moves:
        return []
    total = math.fsum(move.duration or 0.0 for move in moves)
    word = "SPL" if is_spline else "SLIN"
    lines = ["SPLINE", "TIME_BLOCK START"]
    for move in moves:
        lines.append(f"{word} {frame(move)}")
        if move is not moves[-1]:
            share = 100 * (move.duration or 0.0) / total
            lines.append(f"TIME_BLOCK PART={share:.12g}")
    return [*lines, f"TIME_BLOCK END={total:.12g}", "ENDSPLINE"]


def _frames(program: Program, tool_axis: ToolAxis) -> Callable[[Move], str]:
    """Writer of positions in KRL.

    Two triples of angles state an orientation: it takes the one next to the position
    before, at the first position the one next to that of the program as read.
    """
    angles = program.first_angles or (0.0, 0.0, 0.0)

    def frame(move: Move) -> str:
        nonlocal angles
        angles = _angles(move.axis, move.tool_x, tool_axis, angles)
        values = [*(1e3 * value for value in move.end), *angles]
        pairs = zip("XYZABC", values, strict=True)
        return "{" + ",".join(f"{name} {_short(value)}" for name, value in pairs) + "}"

    return frame


# Most moves of a program have the orientation of the one before.
@functools.lru_cache(maxsize=256)
def _angles(
    axis: Point, tool_x: Point | None, tool_axis: ToolAxis, near: Point
) -> Point:
    """Angles A, B, C [deg] of an orientation, of two triples that next to angles."""
    return abc_of_rotation(controller_matrix(axis, tool_x, tool_axis), near)


@functools.lru_cache(maxsize=256)
def _quaternion(
    axis: Point, tool_x: Point | None, tool_axis: ToolAxis
) -> tuple[float, float, float, float]:
    """Quaternion of an orientation."""
    return quaternion_of_rotation(controller_matrix(axis, tool_x, tool_axis))


def _target(move: Move, tool_axis: ToolAxis, status: Sequence[float] = ()) -> str:
    """Return a robtarget of RAPID, with the configuration of the arm if it is known."""
    configuration = ",".join(_short(one) for one in status) if len(status) == 4 else ""
    configuration = configuration or "0,0,0,0"
    place = ",".join(_short(1e3 * value) for value in move.end)
    quaternion = _quaternion(move.axis, move.tool_x, tool_axis)
    turn = ",".join(_short(value, 9) for value in quaternion)
    return f"[[{place}],[{turn}],[{configuration}],[9E9,9E9,9E9,9E9,9E9,9E9]]"


def _short(value: float, decimals: int = 6) -> str:
    """Return a number without zeros behind it."""
    text = f"{value + 0.0:.{decimals}f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text
