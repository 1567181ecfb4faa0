"""Programs as KRL, RAPID and APT: straight moves, arcs as such or in pieces."""

import math
import re
from collections.abc import Sequence

from ....toolpath import Move, Point, Program
from ..geometry import (
    abc_of_axis,
    arc_parts,
    arc_points,
    program_moves,
    quaternion_of_axis,
    straight_pieces,
)

# Beyond this angle a controller could take the other way round a circle.
_LARGEST_ARC = math.radians(170.0)
_FLAT = 1e-7


def write_krl(
    program: Program,
    *,
    header: Sequence[str] = (),
    tolerance: float = 1e-6,
    is_spline: bool = False,
) -> str:
    """Return a program as KRL.

    Moves with a duration become a SPLINE block whose TIME_BLOCKs state it. Positions
    are in the base that is in force, which is `work`, of the tool's tip.

    Args:
        program: The program.
        header: Lines of comment.
        tolerance: How far the pieces of a helix may lie beside it [m].
        is_spline: Whether moves with a duration are points of a cubic spline (SPL)
            instead of straight (SLIN).
    """
    name = re.sub(r"\W", "_", program.name.split(".")[0])[:24] or "part"
    lines = ["&ACCESS RVP", f"DEF {name if name[0].isalpha() else 'p' + name}( )"]
    lines += [f";{' '.join(text.split())}" for text in (*header, _reminder(program))]
    feed, timed = None, []
    moves = _placed(program, tolerance)
    for index, move in enumerate(moves):
        goes = _goes(move) or _turns(moves, index)
        if move.duration is not None and goes:
            timed.append(move)
            if move.rest:
                lines += [*_time_blocks(timed, is_spline), _krl_rest(move.rest)]
                timed = []
            continue
        lines += _time_blocks(timed, is_spline)
        timed = []
        if move.feed is not None and move.feed != feed:
            feed = move.feed
            lines.append(f"$VEL.CP={feed:.9g}")
        if move.centre is not None:
            middle, end = _halves(move)
            lines.append(f"CIRC {_frame(middle, move.axis)},{_frame(end, move.axis)}")
        elif index == 0 or goes:
            word = "PTP" if move.is_rapid else "LIN"
            lines.append(f"{word} {_frame(move.end, move.axis)}")
        rest = move.rest or (move.duration or 0.0)
        if rest:
            lines.append(_krl_rest(rest))
    return "\n".join([*lines, *_time_blocks(timed, is_spline), "END"]) + "\n"


def _krl_rest(seconds: float) -> str:
    """Return a rest."""
    return f"WAIT SEC {seconds:.9g}"


def _reminder(program: Program) -> str:
    """Return what the user has to see to before the file runs on a robot."""
    speed = program.spindle_speed
    spindle = "" if speed is None else f" at {speed * 30 / math.pi:g} rpm"
    return (
        "motion only: before it runs, see to the base (zero of the workpiece), the "
        f"tool (its tip, z up the shank), the way there, and the spindle{spindle}"
    )


def write_rapid(
    program: Program, *, header: Sequence[str] = (), tolerance: float = 1e-6
) -> str:
    """Return a program as a module of RAPID; arguments as `write_krl`."""
    lines = ["MODULE part", "  PROC main()"]
    texts = (*header, _reminder(program))
    lines += [f"    ! {' '.join(text.split())}" for text in texts]
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
        end = _target(move.end, move.axis)
        if move.centre is not None:
            middle, end = (_target(point, move.axis) for point in _halves(move))
            lines.append(f"    MoveC {middle},{end},{speed},{zone},tool0;")
        elif index == 0 or goes:
            word = "MoveJ" if move.is_rapid else "MoveL"
            lines.append(f"    {word} {end},{speed},{zone},tool0;")
        rest = move.rest or (0.0 if goes else move.duration or 0.0)
        if rest:
            lines.append(f"    WaitTime {rest:.9g};")
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
    feed, axis = None, None
    for move in program_moves(program):
        pieces = straight_pieces(move, tolerance, start_axis=axis)
        axis = move.axis
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
            rest = piece.rest or (0.0 if _goes(piece) else piece.duration or 0.0)
            if rest:
                lines.append(f"DELAY/{rest:.9g}")
    return "\n".join([*lines, "FINI"]) + "\n"


def _placed(program: Program, tolerance: float) -> list[Move]:
    """Return the moves, arcs that no circle statement can make in pieces."""
    out, axis = [], None
    for move in program_moves(program):
        is_flat = abs(move.rise) < _FLAT and abs(move.radii[0] - move.radii[1]) < _FLAT
        if move.centre is None:
            out.append(move)
        elif not is_flat or move.duration is not None:
            out.extend(straight_pieces(move, tolerance, start_axis=axis))
        else:
            # A circle statement makes less than half a turn.
            count = max(1, math.ceil(abs(move.sweep) / _LARGEST_ARC))
            sign = 1 if move.turn > 0 else -1
            parts = arc_parts(move, count, start_axis=axis)
            out.extend(part._replace(turn=sign) for part in parts)
        axis = move.axis
    return out


def _halves(move: Move) -> tuple[Point, Point]:
    """Return the middle and the end of an arc."""
    x, y, z = arc_points(move, 2)[0].tolist()
    return (x, y, z), move.end


def _goes(move: Move) -> bool:
    """Return whether a move leads to another place."""
    return move.length > 0


def _turns(moves: Sequence[Move], index: int) -> bool:
    """Return whether a move leads to another axis, as it is written, than before."""
    if index == 0 or moves[index].axis == moves[index - 1].axis:
        return False
    before, after = (
        _frame(moves[index].end, moves[k].axis) for k in (index - 1, index)
    )
    return before != after


def _time_blocks(moves: list[Move], is_spline: bool) -> list[str]:
    """Return moves with durations as a SPLINE block."""
    if not moves:
        return []
    total = math.fsum(move.duration or 0.0 for move in moves)
    word = "SPL" if is_spline else "SLIN"
    lines = ["SPLINE", "TIME_BLOCK START"]
    for move in moves:
        lines.append(f"{word} {_frame(move.end, move.axis)}")
        if move is not moves[-1]:
            share = 100 * (move.duration or 0.0) / total
            lines.append(f"TIME_BLOCK PART={share:.12g}")
    return [*lines, f"TIME_BLOCK END={total:.12g}", "ENDSPLINE"]


def _frame(point: Point, axis: Point) -> str:
    """Return a position of KRL."""
    values = [1e3 * value for value in point] + list(abc_of_axis(axis))
    pairs = zip("XYZABC", values, strict=True)
    return "{" + ",".join(f"{name} {_short(value)}" for name, value in pairs) + "}"


def _target(point: Point, axis: Point) -> str:
    """Return a robtarget of RAPID."""
    place = ",".join(_short(1e3 * value) for value in point)
    turn = ",".join(_short(value, 9) for value in quaternion_of_axis(axis))
    return f"[[{place}],[{turn}],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"


def _short(value: float, decimals: int = 6) -> str:
    """Return a number without zeros behind it."""
    text = f"{value + 0.0:.{decimals}f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text
