"""One block of G-code with its words sorted by meaning."""

from dataclasses import dataclass, field

from ..faults import Fault
from .words import Word

# Codes of other controllers that end what has no beginning here, by modal group.
_CANCELLING = {
    131: "polar interpolation",
    150: "polar coordinates",
    401: "normal direction",
    500: "scaling",
    501: "mirror image",
    670: "modal macro",
    690: "rotation",
}
# Codes that turn, scale or mirror what follows, in the groups of those that end them.
_TURNING = {160: "polar coordinates", 510: "scaling", 511: "mirror image"}
_TURNING[680] = "rotation"
CANCELLED = frozenset(_CANCELLING.values())
TURNED = frozenset(_TURNING.values())
# G codes times ten, by modal group; "once" are those that hold for one block.
_G_GROUPS = {
    **dict.fromkeys([0, 10, 20, 30, 730, 800, 810, 820, 830, 850, 860, 890], "motion"),
    **dict.fromkeys(
        [40, 100, 280, 281, 300, 301, 520, 530, 920, 921, 922, 923], "once"
    ),
    **dict.fromkeys([170, 180, 190], "plane"),
    # G70 and G71 of Siemens controls, which posts of planning systems write for others.
    **dict.fromkeys([200, 210, 700, 710], "units"),
    **dict.fromkeys([400, 410, 411, 420, 421], "cutter radius"),
    **dict.fromkeys([430, 431, 432, 490], "tool length"),
    **dict.fromkeys([540, 550, 560, 570, 580, 590, 591, 592, 593], "system"),
    # Further systems, by P: those of Fanuc, and the same ones of Haas.
    **dict.fromkeys([541, 1540], "system"),
    # High-speed modes of Fanuc controls, and how many blocks one of Haas reads ahead.
    **dict.fromkeys([50, 51, 1030], "look-ahead"),
    **dict.fromkeys([610, 611, 640], "path control"),
    **dict.fromkeys([900, 910], "distance"),
    **dict.fromkeys([901, 911], "centres"),
    **dict.fromkeys([930, 940, 950], "feed mode"),
    **dict.fromkeys([960, 970], "spindle mode"),
    80: "diameter",
    **dict.fromkeys([980, 990], "retract"),
    1870: "smoothing",
    **_CANCELLING,
    **_TURNING,
}
_M_GROUPS = {
    **dict.fromkeys([0, 1, 2, 30, 60], "end"),
    **dict.fromkeys([3, 4, 5, 13, 14], "spindle"),
    **dict.fromkeys([6, 61], "tool change"),
    **dict.fromkeys([7, 8, 9], "coolant"),
    **dict.fromkeys([48, 49, 50, 51, 52, 53], "overrides"),
    19: "orientation",
    **dict.fromkeys([62, 63, 64, 65, 66, 67, 68], "signals"),
}
# Several of them may stand in a line.
_SHARED = frozenset({"coolant"})
_WHY_NOT = {
    **dict.fromkeys([380, 382, 383, 384, 385], "where a probe touches is not known"),
    **dict.fromkeys([330, 331, 740, 840], "threads are not simulated"),
    **dict.fromkeys([650, 660], "write the blocks of the macro out"),
    **dict.fromkeys([52, 53], "write the spline as arcs or lines"),
    **dict.fromkeys([760, 870, 880], "this cycle stops for the spindle or an operator"),
    70: "this is a diameter on a lathe",
    **dict.fromkeys([434, 435], "no kinematics of axes that turn the tool is given"),
    **dict.fromkeys([531, 682], "no kinematics of axes that turn the tool is given"),
}
_LETTERS = frozenset("NXYZIJKRFSTPQLHD@^")
_ROTARY = frozenset("ABC")
# Words of these codes are no words of a motion.
_OWN_WORDS = {
    "orientation": "PQR",
    "signals": "ELPQ",
    "overrides": "P",
    "smoothing": "PE",
}
ALLOWED_WORDS = (
    "N, G0 to G4, G5 P, G5.1 Q, G8, G10, G13.1, G15 to G21, G28, G28.1, G30, G30.1, "
    "G40 to G42.1, G43 to G43.2, G49, G50 to G54, G54.1 P, G55 to G59.3, G61, G61.1, "
    "G64, G67 to G71, G73, G80 to G83, G85, G86, G89, G90, G90.1, G91, G91.1, G92 to "
    "G92.3, G93 to G99, G103, G154 P, G187, X, Y, Z, I, J, K, R, P, Q, L, F, S, T, H, "
    "D, E, M0 to M9, M13, M14, M19, M30, M48 to M53, M60 to M68, M98, M99, G65, A0, "
    "B0, C0, a program number O, O-words, parameters # with expressions [ ], IF, "
    "WHILE, GOTO, @ and ^, block delete /, comments ( ) and ;, and a line of % before "
    "and after"
)


@dataclass(slots=True)
class Block:
    """The words of one line.

    Attributes:
        line: Line of the file, from 1.
        faults: Receives what is wrong with it.
        g: G codes times ten, by modal group; "refused" holds one that is not known.
        m: M codes by modal group.
        values: Other words by letter.
        texts: How the code of a group is written.
        is_g_refused: Whether a G code of the line is not supported.
        used: Letters that a code of the line has made use of.
        rotary: Words that leave an axis that turns at 0.
    """

    line: int
    faults: list[Fault]
    g: dict[str, int] = field(default_factory=dict)
    m: dict[str, int] = field(default_factory=dict)
    values: dict[str, Word] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    is_g_refused: bool = False
    used: set[str] = field(default_factory=set)
    rotary: list[Word] = field(default_factory=list)

    def refuse(self, word: str, message: str, is_unsupported: bool = False) -> None:
        """Report a fault of one of its words, as written."""
        self.faults.append(Fault(self.line, word, message, is_unsupported))

    def number(self, letter: str) -> float | None:
        """Return the number of a letter, or None; it counts as used."""
        word = self.values.get(letter)
        if word is None:
            return None
        self.used.add(letter)
        return word.number

    def put(self, letter: str, number: float, text: str) -> None:
        """Give a letter another number."""
        self.values[letter] = Word(letter, number, text)
        self.used.discard(letter)

    def drop(self, letters: str) -> None:
        """Take words out that a code has made use of, and that are no motion."""
        for letter in letters:
            self.values.pop(letter, None)

    def axes(self) -> list[str]:
        """Return the letters of linear axes that the block has."""
        values = self.values
        return [letter for letter in "XYZ" if letter in values]


def sorted_block(words: list[Word], line: int, faults: list[Fault]) -> Block:
    """Return the words of a line by their meaning; report those that have none."""
    block = Block(line, faults)
    codes = [round(word.number) for word in words if word.letter == "M"]
    groups = [_M_GROUPS.get(code, "") for code in codes]
    if any(word.letter == "G" and word.number == 187 for word in words):
        groups.append("smoothing")
    own = "".join(_OWN_WORDS.get(group, "") for group in groups)
    for index, word in enumerate(words):
        letter = word.letter
        if letter in own:
            continue
        if letter == "G":
            _add_code(block, word, round(word.number * 10), 10)
        elif letter == "M":
            _add_code(block, word, round(word.number), 1)
        elif letter == "N" and (index > 0 or word.number < 0):
            message = "a line number N is not negative and starts its line."
            block.refuse(word.text, message)
        elif letter in _LETTERS:
            if letter in block.values:
                message = f"only one {letter} is allowed in a line."
                block.refuse(word.text, message)
            block.values.setdefault(letter, word)
        elif letter in _ROTARY and word.number == 0:
            block.rotary.append(word)
        else:
            why = " (an axis that turns)" if letter in _ROTARY else ""
            message = f"{letter}{why} is not supported."
            block.refuse(word.text, message, True)
    if block.g.get("once", 530) not in (280, 300, 530):
        # It would set the zero of the axis.
        for word in block.rotary:
            message = f"{word.letter} (an axis that turns) stands still here."
            block.refuse(word.text, message, True)
    return block


def _add_code(block: Block, word: Word, code: int, factor: int) -> None:
    """File a G or M code under its modal group, or report it."""
    groups, present = (
        (_G_GROUPS, block.g) if word.letter == "G" else (_M_GROUPS, block.m)
    )
    name = f"{word.letter}{code / factor:g}"
    group = groups.get(code)
    if group is None or abs(word.number * factor - code) > 1e-3:
        why = _WHY_NOT.get(code) if word.letter == "G" else None
        message = f"{name} is not supported{'' if why is None else f': {why}'}."
        if word.letter == "M":
            message = f'{name} is not supported; [program] pass_over = ["{name}"] '
            message += "leaves it out if it moves nothing."
        block.refuse(word.text, message, True)
        if word.letter == "G":
            block.is_g_refused = True
            block.g.setdefault("refused", code)
    elif group == "motion" and group in present and 800 in (code, present[group]):
        # G80 ends a cycle, and another motion of its line begins.
        if code != 800:
            present[group], block.texts[group] = code, word.text
    elif group in present and group not in _SHARED:
        message = f"only one code for {group} is allowed in a line."
        block.refuse(word.text, message)
    else:
        present[group] = code
        block.texts[group] = word.text
