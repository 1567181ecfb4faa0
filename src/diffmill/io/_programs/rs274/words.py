"""Words of a G-code block: comments taken out, letters and numbers taken apart."""

import math
import re
import string
from typing import NamedTuple

from ..faults import Fault
from ..limits import LARGEST_NUMBER, fault_of_length

# No text is a number in two ways, so that a long line of words is read once.
_NUMBER = r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)"
WORD = re.compile(rf"([A-Z@^])({_NUMBER})")
# A line of words and nothing else, O aside, is split at once.
_PLAIN = re.compile(rf"(?:[A-NP-Z@^]{_NUMBER})*")
_MARK = re.compile(r"[();]")
_BRACKET = re.compile(r"[()]")
_BLANKS = str.maketrans("", "", " \t\r")
# What a word that is not understood is shown as: up to the next plausible letter.
_UNKNOWN = re.compile(r"[A-Z]?[^A-Z(]+|[A-Z]")
_UPPER = str.maketrans(string.ascii_lowercase, string.ascii_uppercase)
_VALUES = frozenset("XYZIJKRFSTPQLHD@^")


class Word(NamedTuple):
    """A letter with its number, and how it was written."""

    letter: str
    number: float
    text: str


def split_words(text: str, line: int, faults: list[Fault]) -> list[Word]:
    """Return the words of one line; report in `faults` what is none.

    Letters may be lower or upper case; blanks mean nothing, even inside a number.
    """
    compact = _compact(text, line, faults)
    upper = compact.translate(_UPPER)
    words: list[Word] = []
    if _PLAIN.fullmatch(upper):
        for match in WORD.finditer(upper):
            _take(match, compact, line, words, faults)
        return words
    position = 0
    while position < len(compact):
        if upper[position] == "(":
            position += 1
            continue
        match = WORD.match(upper, position)
        if match and upper[position] != "O":
            position = match.end()
            _take(match, compact, line, words, faults)
            continue
        position = report_unknown(compact, position, line, faults, words)
    return words


def compact_line(text: str, line: int, faults: list[Fault]) -> str:
    """A line in upper case, without blanks, with a ( for each comment inside it."""
    return _compact(text, line, faults).translate(_UPPER)


def _compact(text: str, line: int, faults: list[Fault]) -> str:
    if message := fault_of_length(text):
        faults.append(Fault(line, text[:30], message))
        return ""
    code = split_comments(text, line, faults)[0] if _MARK.search(text) else text
    return code.translate(_BLANKS)


def _take(
    match: re.Match[str],
    compact: str,
    line: int,
    words: list[Word],
    faults: list[Fault],
) -> None:
    """Add the word of a match; one that is too large is reported."""
    letter, number = match[1], float(match[2])
    shown = compact[match.start() : match.end()]
    if abs(number) > LARGEST_NUMBER:
        message = f"its size is beyond {LARGEST_NUMBER:g}."
        faults.append(Fault(line, shown[:30], message))
        number = math.nan
    if not math.isnan(number) or letter in _VALUES:
        words.append(Word(letter, number, shown))


def report_unknown(
    compact: str, position: int, line: int, faults: list[Fault], words: list[Word]
) -> int:
    """Report what is no word at a position; return where to go on."""
    match = _UNKNOWN.match(compact.translate(_UPPER), position)
    end = match.end() if match else position + 1
    letter = compact[position].upper()
    if letter == "O":
        end = len(compact)
    shown = compact[position:end].split("(")[0]
    if letter == "/":
        message = "a block delete / is allowed at the start of its line only."
    elif letter == "%":
        message = "a % is allowed alone on the first and on the last line only."
    elif letter == "O":
        message = "this is no O-word; known are sub, endsub, call, return, if, elseif, "
        message += (
            "else, endif, while, endwhile, do, repeat, endrepeat, break, continue."
        )
    elif letter in string.ascii_uppercase:
        message = f"{letter} needs a number such as 5, 5., -.5 or +3.25."
    else:
        message = "no word starts like this."
    faults.append(Fault(line, shown[:30], message, message.startswith("no word")))
    # Its value is unknown, but the words of the line keep their meaning.
    words += [Word(letter, math.nan, shown[:30])] * (letter in _VALUES)
    return end


def split_comments(
    text: str, line: int, faults: list[Fault]
) -> tuple[str, tuple[str, ...]]:
    """Line without its comments, and the texts of these.

    A ( stands in the place of each comment inside the line, so that a word ends there.
    Posts write names with brackets, such as (Pocket (2)), which controllers end at the
    first closing one; here it is the last one, behind which words may stand.
    """
    code: list[str] = []
    texts: list[str] = []
    position = 0
    while mark := _MARK.search(text, position):
        code.append(text[position : mark.start()])
        begin = mark.end()
        if mark[0] == ";":
            return "".join(code), (*texts, text[begin:].strip())
        if mark[0] == ")":
            faults.append(Fault(line, ")", "there is no comment that it closes."))
            position = begin
            continue
        position = _end_of_comment(text, begin)
        if position < 0:
            message = "the comment is not closed; a ) must end it on its line."
            faults.append(Fault(line, text[mark.start() :][:30], message))
            return "".join(code), tuple(texts)
        code.append("(")
        texts.append(text[begin : position - 1].strip())
    return "".join(code) + text[position:], tuple(texts)


def _end_of_comment(text: str, begin: int) -> int:
    """Position behind a comment whose brackets are all closed; -1 if they are not."""
    depth = 1
    for bracket in _BRACKET.finditer(text, begin):
        depth += 1 if bracket[0] == "(" else -1
        if depth == 0:
            return bracket.end()
    return -1
