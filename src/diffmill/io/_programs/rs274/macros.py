"""Lines of G-code with parameters, O-words and macros, as steps of a program.

O-words are those of LinuxCNC; IF, WHILE, GOTO, G65, M98 and M99 those of Fanuc.
"""

import functools
import math
import pathlib
import re
from collections.abc import Callable
from typing import NamedTuple

from ..control import Code, Machine
from ..expressions import (
    Expression,
    ExpressionError,
    Name,
    Parser,
    Value,
    Variable,
    constant,
    number_of,
)
from ..faults import SHOWN_FAULTS, Fault, ProgramError
from ..limits import LARGEST_NUMBER
from ..sources import Folder, Sources
from ..text import read_text
from .blocks import ALLOWED_WORDS
from .parameters import Parameters, variable_of
from .state import State
from .words import WORD, Word, compact_line, report_unknown, split_words

# What is no plain block: parameters, brackets, O-words, calls and jumps.
MACRO = re.compile(r"[#\[]|^[^(;]*O|M\s*0*9\s*[89]|G\s*6\s*[567]|^[^(;]*GOTO", re.I)
_FANUC = re.compile(r"^(?:N\d+)?(?:IF\[|WH(?:ILE)?\[.*DO\d|GOTO|.*G6[56](?!\d))")
_NUMBERED = re.compile(r"(?:N\d+(?:\.\d+)?)?")
_O_WORD = re.compile(
    r"O(\d+|<[^<>]*>|#.*?|\[.*?\])(SUB|ENDSUB|CALL|RETURN|IF|ELSEIF|ELSE|ENDIF|WHILE"
    r"|ENDWHILE|DO|REPEAT|ENDREPEAT|BREAK|CONTINUE)(?=[\[#(]|$)(.*)"
)
_PROGRAM = re.compile(r"O(\d+|<[^<>]*>)\(*")
_JUMP = re.compile(r"(?:IF(\[.*\]))?GOTO(.*)")
_THEN = re.compile(r"(IF|ELSEIF)(\[.*\])THEN(.*)")
_LOOP = re.compile(r"(?:WH(?:ILE)?(\[.*\]))?DO(\d+)\(*")
_SINGLE = re.compile(r"(END\d+|ELSE|ENDIF)\(*")
_CALL = re.compile(r"(M0*98|G65)(?!\d)")
_RETURN = re.compile(r"M0*99(?!\d)")
# Letters of a call by G65, and the parameters that they set.
_ARGUMENTS = dict(
    zip("ABCIJKDEFHMQRSTUVWXYZ", [*range(1, 10), 11, 13, *range(17, 27)], strict=True)
)
_WHOLE_NUMBER = re.compile(r"P(\d+)")
# Suffixes of files of subprograms; some controls write none.
_SUFFIXES = (".ngc", ".nc", ".cnc", ".tap", ".gcode", ".txt", ".sub", "")
# A whole number is as near to what an expression gives.
_WHOLE = 1e-6

RunBlock = Callable[[list[Word], int, State], list[Fault]]


class _Written(NamedTuple):
    """A word: its letter, the expression of its number, and how it is written."""

    letter: str
    number: Expression
    text: str


class _Assignment(NamedTuple):
    """A parameter, and the expression that it is set to."""

    variable: Variable
    value: Expression


class _Line(NamedTuple):
    """Words and assignments of a line."""

    words: list[_Written]
    assignments: list[_Assignment]


class Library(NamedTuple):
    """Files of the subprograms that a program calls: its folder, and those so far."""

    folder: Folder
    sources: Sources

    def find(self, label: str) -> pathlib.Path | None:
        """File of a subprogram: of its name, or as O and its number in four digits."""
        stem = label.strip("<>")
        stems = [stem]
        if stem.isdigit():
            stems = [f"O{stem:0>4}", f"O{stem}", stem, f"{stem:0>4}"]
        return self.folder.find(stems, _SUFFIXES)


class MacroReader:
    """Reader of the lines of a program with parameters or control flow."""

    def __init__(self, state: State, run: RunBlock, dialect: str, library: Library):
        self.state, self.run_block, self.library = state, run, library
        # Subprograms that are called by a number or a name which the text has.
        self.called: dict[str, None] = {}
        self.parameters = Parameters(dialect, state)
        self.code, self.has_words, self.in_program = Code(), False, False
        self.first = 0
        self.rows: dict[int, str] = {}
        # Lines with expressions, as they are read the second time.
        self.read: dict[str, _Line | None] = {}
        # One for all lines: a program may have a million.
        self.run_row = self._run_row

    def run(self, rows: dict[int, str], first: int) -> None:
        """Carry out the rows of a program from a line on.

        Args:
            rows: Texts of the lines that are carried out, by number.
            first: Line at which to begin; those before have been carried out.

        Raises:
            ProgramError: If a block has no end, or a line cannot be carried out.
        """
        out, self.first, self.rows = self.state.out, first, rows
        start = self._append(rows)
        self._append_files()
        self.code.finish()
        if out.faults or self.code.faults:
            faults = sorted([*out.faults, *self.code.faults])
            raise ProgramError(out.name, faults, ALLOWED_WORDS)
        machine = Machine(self.code, self.parameters.variables, out.name, out.faults)
        self.parameters.machine = machine
        machine.at = start
        machine.run()

    def _append(self, rows: dict[int, str]) -> int:
        """Append the steps of a file; return that of the line at which to begin."""
        start, out = 0, self.state.out
        for line, row in rows.items():
            start = len(self.code.steps) if line == self.first else start
            self.code.weigh(line, row)
            try:
                self._row(row, line)
            except ExpressionError as error:
                out.faults.append(Fault(line, error.word, str(error)))
            if len(out.faults) + len(self.code.faults) > SHOWN_FAULTS:
                break
        if self.in_program:
            self.code.end_routine(max(rows))
            self.in_program = False
        return start

    def _append_files(self) -> None:
        """Append subprograms that are called and stand in files of their own."""
        known, is_alone = set(self.code.routines), True
        while missing := self.called.keys() - known:
            for label in sorted(missing):
                file = self.library.find(label)
                if file is None or label in self.code.routines:
                    continue
                sources = self.library.sources
                if is_alone:
                    # The program ends before its subprograms.
                    self.code.plain(sources.count, lambda machine: machine.stop())
                is_alone, begun = False, sources.count
                rows = sources.lines(read_text(file), file.name, self.state.out)
                bare = {begun + n: row.strip() for n, row in enumerate(rows, 1)}
                bare = {n: row for n, row in bare.items() if row not in ("", "%")}
                self.rows |= bare
                self.has_words = True
                first = next((r for r in bare.values() if r[0] not in "(;"), "")
                if not first.upper().startswith("O"):
                    self.code.begin_routine(begun + 1, label)
                    self.in_program = True
                self._append(bare)
            known |= missing | self.code.routines.keys()

    def _row(self, row: str, line: int) -> None:
        """Append the steps of a line."""
        if not MACRO.search(row) and not row.upper().startswith(("E", "D", "N")):
            self._plain(row, line)
            return
        text = compact_line(row, line, self.state.out.faults)
        number = _NUMBERED.match(text)
        text = text[number.end() :] if number else text
        if number and number[0] and self.parameters.dialect == "fanuc":
            self.code.label(int(float(number[0][1:])))
        if match := _O_WORD.fullmatch(text):
            self._o_word(match, line)
        elif match := _PROGRAM.fullmatch(text):
            self._program(match[1], line)
        elif match := _JUMP.fullmatch(text):
            if match[1]:
                self.code.begin_if(line, self._expression(match[1]))
            self.code.jump(line, self._expression(match[2]))
            if match[1]:
                self.code.end(line, ("if",))
        elif match := _THEN.fullmatch(text):
            self._then(match, line)
        elif match := _LOOP.fullmatch(text):
            condition = self._expression(match[1]) if match[1] else None
            self.code.begin_loop(line, condition, label=match[2])
        elif match := _SINGLE.fullmatch(text):
            if match[1] == "ELSE":
                self.code.otherwise(line)
            elif match[1] == "ENDIF":
                self.code.end(line, ("if",))
            else:
                self.code.end(line, ("while",), match[1][3:])
        elif _CALL.search(text):
            self._subprogram(text, line)
        elif match := _RETURN.search(text):
            if before := text[: match.start()].strip("("):
                self._plain(before, line)
            if text[match.end() :].startswith(("P", "L")):
                raise ExpressionError("M99", "M99 goes back without a P here.")
            self.code.give_back(line)
        else:
            self._plain(row, line)

    def _expression(self, text: str) -> Expression:
        """Expression of a text, such as [#1 GT 2]."""
        parser = Parser(text.rstrip("("), self.parameters.grammar)
        expression = parser.expression()
        parser.finish()
        return expression

    def _expressions(self, text: str) -> list[Expression]:
        """Expressions in brackets, one behind the other."""
        parser, values = Parser(text, self.parameters.grammar), []
        while parser.kind:
            values.append(parser.operand())
        parser.finish()
        return values

    def _then(self, match: re.Match[str], line: int) -> None:
        """Append a Fanuc IF with one statement, or the begin of a block."""
        condition = self._expression(match[2])
        if match[1] == "ELSEIF":
            self.code.otherwise(line, condition)
            return
        self.code.begin_if(line, condition)
        if rest := match[3].strip("("):
            self._row(rest, line)
            self.code.end(line, ("if",))

    def _o_word(self, match: re.Match[str], line: int) -> None:
        """Append the steps of an O-word."""
        label, word, rest = match.groups()
        code, values = self.code, self._expressions(rest.replace("(", ""))
        value = values[0] if values else None
        if word in ("IF", "ELSEIF", "WHILE", "REPEAT") and len(values) != 1:
            raise ExpressionError(match[0], "needed is one value in brackets.")
        if label[0] in "#[" and word != "CALL":
            raise ExpressionError(match[0], "only a call computes its number.")
        number = value or (lambda variables: None)
        if word == "SUB":
            code.begin_routine(line, label)
        elif word == "ENDSUB":
            code.give_back(line, value)
            code.end(line, ("routine",), label)
        elif word == "RETURN":
            code.give_back(line, value)
        elif word == "CALL":
            computed = self._expression(label) if label[0] in "#[" else None
            name = constant(label) if computed is None else computed
            if computed is None:
                self.called.setdefault(label)
            code.plain(line, functools.partial(self._call, name, values))
        elif word == "IF":
            code.begin_if(line, number, label)
        elif word in ("ELSEIF", "ELSE"):
            code.otherwise(line, value, label)
        elif word == "WHILE" and code.is_open("do", label):
            code.end(line, ("do",), label, again=number)
        elif word == "WHILE":
            code.begin_loop(line, number, label=label)
        elif word == "DO":
            code.begin_loop(line, kind="do", label=label)
        elif word == "REPEAT":
            code.begin_repeat(line, number, label)
        elif word == "BREAK":
            code.leave(line, label)
        elif word == "CONTINUE":
            code.go_on(line, label)
        else:
            code.end(line, (word[3:].lower(),), label)

    def _call(
        self, name: Expression, values: list[Expression], machine: Machine
    ) -> None:
        """Call the routine of an O-word with #1, #2 and so on."""
        label = machine.value(name)
        label = label if isinstance(label, str) else f"{machine.number(name):.0f}"
        own: dict[Name, Value] = {
            index: machine.value(value) for index, value in enumerate(values, 1)
        }

        def done(_: dict[Name, Value]) -> None:
            shared, result = machine.variables.shared, machine.result
            shared["<_VALUE_RETURNED>"] = float(result is not None)
            shared["<_VALUE>"] = 0.0 if result is None else result

        machine.call(label, own, done)

    def _program(self, label: str, line: int) -> None:
        """Begin a subprogram of M98 and G65; the first number is the program's."""
        if self.in_program:
            self.code.end_routine(line)
            self.in_program = False
        if not self.has_words:
            self.has_words = True
            if line >= self.first:
                self.state.out.note(f"O{label}", "is a program number", line)
            return
        self.code.begin_routine(line, label.lstrip("0") or "0")
        self.in_program = True

    def _subprogram(self, text: str, line: int) -> None:
        """Append a call by M98 or G65, so often as L says."""
        before, call_word, behind = _CALL.split(text, maxsplit=1)
        if before.strip("("):
            self._plain(before, line)
        read = self._line(behind, line)
        words = {word.letter: word for word in read.words}
        if read.assignments or len(words) < len(read.words):
            message = "a call has each letter once, and assigns no parameter."
            raise ExpressionError(text, message)
        routine, count = words.pop("P", None), words.pop("L", None)
        is_macro = call_word[0] == "G"
        if routine is None or (words and not is_macro):
            message = "a call has a P, the number of its subprogram, and an L."
            raise ExpressionError(text, message)
        if unknown := words.keys() - _ARGUMENTS.keys():
            raise ExpressionError(min(unknown), "G65 gives this letter no parameter.")

        def label(number: Value) -> tuple[str, int]:
            """Routine and repetitions of a P, which has both above four digits."""
            value = int(number) if isinstance(number, int | float) else 0
            if value < 10_000 or str(value) in self.code.routines:
                return str(value), 1
            return str(value % 10_000), value // 10_000

        def call(machine: Machine) -> None:
            own = dict[Name, Value]()
            for letter, word in words.items():
                own[_ARGUMENTS[letter]] = machine.value(word.number)
            name = label(machine.value(routine.number))[0]
            machine.call(name, own if is_macro else None)

        if number := _WHOLE_NUMBER.fullmatch(routine.text):
            self.called |= dict.fromkeys(
                [str(int(number[1])), label(int(number[1]))[0]]
            )
        turns = count.number if count else lambda v: label(routine.number(v))[1]
        self.code.begin_repeat(line, turns)
        self.code.plain(line, call)
        self.code.end(line, ("repeat",))

    def _plain(self, row: str, line: int) -> None:
        """Append a line of words."""
        if not self.has_words:
            self.has_words = bool(compact_line(row, line, []).strip("("))
        is_whole = row is self.rows[line]
        own = self.run_row if is_whole else functools.partial(self._run_row, row=row)
        self.code.plain(line, own)

    def _run_row(self, machine: Machine, row: str = "") -> None:
        """Carry out a line of words, or the part of it that is given."""
        line, out, faults = machine.line, self.state.out, list[Fault]()
        row = row or self.rows[line]
        if "#" not in row and "[" not in row:
            words = split_words(row, line, faults)
        else:
            try:
                read = self.read.get(row) or self._line(row, line)
            except ExpressionError as error:
                machine.refuse(error.word, str(error))
            # Lines of loops are kept as read; all would fill the memory.
            self.read[row] = read if row in self.read else None
            words = self._words(read, machine)
        if words and not faults:
            faults = self.run_block(words, line, self.state)
        if faults:
            out.faults += [fault for fault in faults if fault not in out.faults]
            if len(out.faults) > SHOWN_FAULTS:
                raise ProgramError(out.name, out.faults, ALLOWED_WORDS)
        if self.state.is_ended:
            machine.stop()

    def _words(self, read: _Line, machine: Machine) -> list[Word]:
        """Words of a line, and its assignments; both have the values before it."""
        words: list[Word] = []
        for letter, expression, text in read.words:
            value = machine.value(expression)
            if value is None:
                continue
            number = float(value) if isinstance(value, int | float) else math.nan
            if letter not in "XYZIJKRF@^" and abs(number - round(number)) < _WHOLE:
                number = float(round(number))
            if abs(number) > LARGEST_NUMBER:
                machine.refuse(text, f"its size is beyond {LARGEST_NUMBER:g}.")
            words.append(Word(letter, number, text))
        values = [machine.value(one.value) for one in read.assignments]
        for one, value in zip(read.assignments, values, strict=True):
            try:
                self.parameters.set(one.variable.name(machine.variables), value)
            except ExpressionError as error:
                machine.refuse(error.word, str(error))
        return words

    def _line(self, row: str, line: int) -> _Line:
        """Read the words and assignments of a line."""
        read, at, faults = _Line([], []), 0, self.state.out.faults
        text = compact_line(row, line, faults)
        while at < len(text):
            if text[at] == "(":
                at += 1
            elif text[at] == "#":
                parser = Parser(text, self.parameters.grammar, at + 1)
                variable = variable_of(parser)
                parser.expect("=")
                read.assignments.append(_Assignment(variable, parser.expression()))
                at = parser.at
            elif match := WORD.match(text, at):
                number = constant(number_of(match[2]))
                read.words.append(_Written(match[1], number, match[0]))
                at = match.end()
            elif text[at] in "@^" or (text[at].isalpha() and text[at] != "O"):
                parser = Parser(text, self.parameters.grammar, at + 1)
                number = parser.operand()
                word = _Written(text[at], number, text[at : parser.at])
                read.words.append(word)
                at = parser.at
            else:
                at = report_unknown(text, at, line, faults, [])
        return read


def is_fanuc(rows: dict[int, str]) -> bool:
    """True if a program has words of Fanuc macros, which LinuxCNC does not know."""
    texts = (row for row in rows.values() if MACRO.search(row))
    return any(_FANUC.match(compact_line(row, 0, [])) for row in texts)
