"""Programs of another language than their suffix says, told by their lines."""

import re
from typing import NamedTuple

from .faults import Fault

# Lines that are looked through.
_FIRST_LINE_COUNT = 200
_COMMENT = re.compile(r"\([^()]*\)|;.*")


class _Dialect(NamedTuple):
    """A language, and how a line of it shows.

    Attributes:
        name: Its name.
        suffixes: Suffixes under which it is read; none if it is not.
        mark: What only its lines have; comments of G-code are taken out before.
        header: What only its comments have.
        instead: What to post where it is not read.
    """

    name: str
    suffixes: tuple[str, ...]
    mark: re.Pattern[str]
    header: re.Pattern[str] | None = None
    instead: str = "G-code as LinuxCNC and Fanuc controls read it"


def _pattern(*parts: str) -> re.Pattern[str]:
    """Pattern of one of several marks at the begin of a line, behind its number."""
    return re.compile(rf"\s*(?:N?\d+\s+)?(?:{'|'.join(parts)})", re.IGNORECASE)


_OF_ROBOTS = "the path as APT (CLDATA), or as points over time in a .csv"
_DIALECTS = (
    _Dialect(
        "KRL",
        (".src",),
        _pattern(r"&ACCESS\b", r"(?:GLOBAL\s+)?DEF\s+\w+\s*\(", r"(?:LIN|PTP)\s*\{"),
    ),
    _Dialect(
        "RAPID",
        (".mod", ".modx", ".prg"),
        _pattern(r"MODULE\s+\w+\s*(?:\(.*\))?$", r"(?:CONST|PERS)\s+robtarget\b"),
    ),
    _Dialect(
        "APT",
        (".apt", ".cls", ".cl", ".cldata", ".ncl", ".aptsource"),
        _pattern(r"PARTNO\b", r"GOTO\s*/", r"TOOL PATH\s*/", r"UNITS?\s*/\s*(?:MM|IN)"),
    ),
    _Dialect(
        "the dialogue language of Heidenhain controls",
        (),
        _pattern(
            r"BEGIN\s+PGM\b",
            r"(?:TOOL\s+(?:CALL|DEF)|CYCL\s+DEF|BLK\s+FORM)\b",
            r"LN?\s+[XYZ][+-]\d.*\b(?:F\w*|R[0LR])\b",
            r"CC\s+[XYZ][+-]\d",
        ),
    ),
    _Dialect(
        "DIN/ISO of Heidenhain controls",
        (),
        re.compile(r"\s*%\w+\s+G7[01]\s*\*|\s*N\d+\s*G.*\*\s*$", re.IGNORECASE),
    ),
    _Dialect(
        "the language of Siemens controls",
        (),
        re.compile(
            r"\s*%_N_\w+|.*\bT\s*=\s*\"|.*\b(?:[XYZIJKFS]|CR|AR|TURN)\s*=(?!=)|.*\bG50[0-9]\b"
            r"|.*\bG60[0-9]\b"
            r"|\s*(?:N\d+\s*)?(?:A?TRANS|A?ROT|A?MIRROR|A?SCALE|CYCLE\d+|POCKET\d|WORKPIECE"
            r"|MSG|STOPRE|SUPA|TRAORI|TRAFOOF|FFWON|SOFT|COMPOF|COMPCAD|DEF\s+(?:REAL|INT)"
            r"|EXTCALL)\b",
            re.IGNORECASE,
        ),
        re.compile(r";\s*(?:%_N_\w+|\$PATH=)", re.IGNORECASE),
    ),
    _Dialect(
        "a program of a printer",
        (),
        _pattern(r"M1(?:04|09|40|90)\s+S\d", r"G1\b.*\bE-?\d*\.\d+"),
    ),
    _Dialect(
        "a program of Fanuc robots",
        (),
        _pattern(r"/(?:PROG|ATTR|MN|POS)\b", r"J\s+P\[\d+", r"L\s+P\[\d+"),
        instead=_OF_ROBOTS,
    ),
    _Dialect(
        "a job of Yaskawa robots",
        (),
        _pattern(r"/JOB\s*$", r"//(?:NAME|POS|INST)\b", r"MOV[LJC]\s+[CP]\d+"),
        instead=_OF_ROBOTS,
    ),
)
_DECIMAL_COMMA = re.compile(r"[XYZIJKRFQ]\s*[+-]?\d+,\d+", re.IGNORECASE)


def recognised(text: str, suffix: str, *, is_gcode: bool) -> Fault | None:
    """The one fault of a program that was refused as what its suffix says.

    Args:
        text: The program.
        suffix: Suffix of its file, in lower case.
        is_gcode: Whether that says G-code.

    Returns:
        What it is instead; None if nothing is recognised.
    """
    rows = text.splitlines()[:_FIRST_LINE_COUNT]
    if any("\0" in row for row in rows):
        return Fault(0, "", "the file is binary; needed is a program as text.")
    for number, row in enumerate(rows, 1):
        code = _COMMENT.sub(" ", row)
        for dialect in _DIALECTS:
            if suffix in dialect.suffixes:
                continue
            if not (is_gcode or dialect.suffixes or dialect.instead == _OF_ROBOTS):
                continue
            is_header = dialect.header is not None and dialect.header.match(row.strip())
            line = row if dialect.suffixes else code
            if not (is_header or dialect.mark.match(line)):
                continue
            message = f"this is {dialect.name}, which is not read; needed is "
            message += f"{dialect.instead}, KRL, RAPID or APT."
            if dialect.suffixes:
                message = f"this is {dialect.name}; needed is one of its suffixes, "
                message += f"{', '.join(dialect.suffixes)}."
            return Fault(number, row.strip()[:40], message)
        if is_gcode and (comma := _DECIMAL_COMMA.search(code)):
            point = comma[0].replace(",", ".")
            message = f"numbers have a decimal comma; needed is a point, as in {point}."
            return Fault(number, comma[0], message)
    return None
