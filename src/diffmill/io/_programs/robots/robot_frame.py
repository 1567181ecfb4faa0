"""What a program of a robot says around its motion: base, tool, outputs, comments."""

import re
from collections.abc import Collection
from typing import NamedTuple

_MOST_COMMENTS = 20
_DEF = re.compile(r"\s*(?:GLOBAL\s+)?DEF(?:FCT)?\b.*", re.IGNORECASE)
_PROC = re.compile(r"\s*(?:LOCAL\s+)?(?:PROC|FUNC|TRAP)\b.*", re.IGNORECASE)
# Statements that stay: they choose base and tool, set outputs, wait or call a routine.
_KEPT_KRL = re.compile(
    r"\$(?:BASE|TOOL|LOAD|ACC|OUT|ANOUT|IPO_MODE)\b.*|FDAT_ACT\s*=\s*\{.*\}|PULSE\s*\(.*"
    r"|BAS\s*\(\s*#(?:INITMOV|BASE|TOOL|FRAMES)\b.*|WAIT\b.*|(?!BAS\b)[A-Z_]\w*\s*\(.*\)",
    re.IGNORECASE,
)
_KEPT_RAPID = re.compile(
    r"(?:Set|SetDO|SetAO|SetGO|Reset|PulseDO|WaitTime|WaitDI|WaitDO|ConfL|ConfJ|AccSet"
    r"|SingArea|TPWrite)\b.*|(?!Move|Return|Exit|End|Else|Stop|If|For|While|Test|Case|Go|Var|Pers|Con"
    r"st|Local|Task|ClkRe)[A-Z]\w*(?:\s+[^:=]*)?",
    re.IGNORECASE,
)
_DATA = re.compile(
    r"^[ \t]*((?:(?:LOCAL|TASK)\s+)*(?:PERS|CONST|VAR)\s+(?:tooldata|wobjdata)\s+(\w+)"
    r"\s*:=[^;]*;)",
    re.IGNORECASE | re.MULTILINE,
)
_HELD = re.compile(r",\s*(\w+)\s*(?:\\WObj\s*:=\s*(\w+))?\s*;", re.IGNORECASE)


class RobotFrame(NamedTuple):
    """Lines of a program beside its motion.

    Attributes:
        comments: Comments above the first motion, without their sign.
        data: Declarations of the tool and the work object (RAPID).
        opening: Statements before the motion, without a semicolon.
        closing: Statements behind it.
        held: Tool and work object of the motion, as RAPID writes them.
    """

    comments: tuple[str, ...] = ()
    data: tuple[str, ...] = ()
    opening: tuple[str, ...] = ()
    closing: tuple[str, ...] = ()
    held: str = "tool0"

    @property
    def states_frames(self) -> bool:
        """True if base and tool are chosen in it."""
        text = "\n".join(self.opening).upper()
        is_chosen = re.search(r"\$BASE|#BASE|FDAT_ACT", text) is not None
        return bool(self.data) or is_chosen


def robot_frame(source: str, suffix: str, lines: Collection[int]) -> RobotFrame:
    """Frame of a program of a robot around the motion of some of its lines.

    Where the motion is in several routines, nobody can say what belongs around it: the
    frame is empty then, as it is for a source of another language.

    Args:
        source: The text of the program.
        suffix: Suffix of the program that is written, ".src" or ".mod".
        lines: Numbers of the lines that still move, from 1.
    """
    rows, moving = source.splitlines(), sorted(line for line in lines if line > 0)
    is_krl = suffix == ".src"
    begins, kept = (_DEF, _KEPT_KRL) if is_krl else (_PROC, _KEPT_RAPID)
    starts = [index for index, row in enumerate(rows) if begins.fullmatch(row)]
    if not starts or not moving or moving[-1] > len(rows):
        return RobotFrame()
    first, last = moving[0] - 1, moving[-1]
    before = [start for start in starts if start <= first]
    own = before[-1] if before else len(rows)
    if any(own < start < last for start in starts) or own == len(rows):
        return RobotFrame()
    end = next((one for one in range(last, len(rows)) if _is_end(rows[one])), len(rows))
    sign = ";" if is_krl else "!"
    comments = [
        row.strip()[1:].strip()
        for row in rows[:first]
        if row.strip().startswith(sign)
        and not re.match(r"\W*((END)?FOLD|motion only)", row.strip())
    ]
    # Routines of the file are not in the file that is written.
    known = {name.upper() for one in starts for name in re.findall(r"\w+", rows[one])}
    frame = RobotFrame(
        tuple(comments[:_MOST_COMMENTS]),
        (),
        _statements(rows[own + 1 : first], kept, sign, known),
        _statements(rows[last:end], kept, sign, known),
    )
    held = None if is_krl else _HELD.search(rows[first])
    if held is None:
        return frame
    names = {name.lower() for name in held.groups() if name}
    found = [m for m in _DATA.finditer(source) if m[2].lower() in names]
    data = [" ".join(one[1].split()) for one in found]
    work = f"\\WObj:={held[2]}" if held[2] else ""
    return frame._replace(data=tuple(data), held=f"{held[1]}{work}")


def _is_end(row: str) -> bool:
    return re.fullmatch(r"\s*END(?:PROC)?\s*", row, re.IGNORECASE) is not None


def _statements(
    rows: list[str], kept: re.Pattern[str], sign: str, known: Collection[str]
) -> tuple[str, ...]:
    """Statements of rows that stay, calls of known routines aside."""
    bare = [row.split(sign)[0].strip().rstrip(";").strip() for row in rows]
    stay = [row for row in bare if kept.fullmatch(row)]
    return tuple(row for row in stay if re.split(r"\W", row)[0].upper() not in known)
