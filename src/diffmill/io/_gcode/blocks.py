"""One block of G-code with its words sorted by meaning."""

from dataclasses import dataclass

from .words import Fault, Word

_G_GROUPS = {
    0: "motion",
    10: "motion",
    20: "motion",
    30: "motion",
    170: "plane",
    200: "units",
    210: "units",
    900: "distance",
    910: "distance",
    930: "feed mode",
    940: "feed mode",
}
_M_GROUPS = {2: "end", 30: "end", 3: "spindle", 5: "spindle", 6: "tool change"}
_WHY_NOT = {
    180: "arcs lie in the XY plane (G17) only",
    190: "arcs lie in the XY plane (G17) only",
    410: "program the path of the tool's centre",
    420: "program the path of the tool's centre",
}


@dataclass
class Block:
    """The words of one line.

    Attributes:
        line: Line of the file, from 1.
        g: G codes times ten, by modal group; "refused" holds one that is not known.
        m: M codes by modal group.
        values: Other words by letter.
        texts: How the code of a group is written.
        is_g_refused: Whether a G code of the line is not supported.
    """

    line: int
    g: dict[str, int]
    m: dict[str, int]
    values: dict[str, Word]
    texts: dict[str, str]
    is_g_refused: bool = False


def sorted_block(words: list[Word], line: int, faults: list[Fault]) -> Block:
    """Return the words of a line by their meaning; report those that have none."""
    block = Block(line, {}, {}, {}, {})
    for index, word in enumerate(words):
        if word.letter == "G":
            _add_code(block, word, round(word.number * 10), 10, faults)
        elif word.letter == "M":
            _add_code(block, word, round(word.number), 1, faults)
        elif word.letter == "N" and (index > 0 or word.number < 0):
            message = "a line number N is not negative and starts its line."
            faults.append(Fault(line, word.text, message))
        elif word.letter in "NXYZIJKRFST":
            if word.letter in block.values:
                message = f"only one {word.letter} is allowed in a line."
                faults.append(Fault(line, word.text, message))
            block.values.setdefault(word.letter, word)
        else:
            message = f"{word.letter} is not supported."
            faults.append(Fault(line, word.text, message, True))
    return block


def _add_code(
    block: Block, word: Word, code: int, factor: int, faults: list[Fault]
) -> None:
    """File a G or M code under its modal group, or report it."""
    groups, present = (
        (_G_GROUPS, block.g) if word.letter == "G" else (_M_GROUPS, block.m)
    )
    name = f"{word.letter}{code / factor:g}"
    group = groups.get(code)
    if group is None or abs(word.number * factor - code) > 1e-3:
        why = _WHY_NOT.get(code) if word.letter == "G" else None
        message = f"{name} is not supported{'' if why is None else f': {why}'}."
        faults.append(Fault(block.line, word.text, message, True))
        if word.letter == "G":
            block.is_g_refused = True
            block.g.setdefault("refused", code)
    elif group in present:
        message = f"only one code for {group} is allowed in a line."
        faults.append(Fault(block.line, word.text, message))
    else:
        present[group] = code
        block.texts[group] = word.text
