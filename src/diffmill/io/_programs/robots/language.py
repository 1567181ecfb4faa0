"""Base of the readers of KRL and RAPID, whose programs a `Machine` carries out."""

import math
import re
from collections.abc import Callable, Iterable
from typing import NamedTuple

from ..control import Code, Machine
from ..expressions import (
    NUMBER,
    Expression,
    ExpressionError,
    Name,
    Value,
    Variable,
    Variables,
    split_arguments,
)
from ..faults import SHOWN_FAULTS, ProgramError
from ..limits import LARGEST_NUMBER
from ..setup import ProgramSetup
from ..sources import Sources
from .reader import Reader
from .texts import Texts


def _too_many(count: int) -> str:
    return f"the routine takes {count} value(s) at most."


class Statement(NamedTuple):
    """A statement: the line at which it begins, and its text."""

    line: int
    text: str


class Language(Reader):
    """State of the reader of a program with routines, loops and variables.

    Attributes:
        code: The program.
        texts: Its expressions and variables.
        machine: Its run.
        pass_over: Names of routines that move nothing, in upper case.
        routine: The routine that is compiled now, "" outside of any.
        returned: By routine, the names of the parameters that go back to its call.
        is_running: Whether the program runs, and is no longer compiled.
        sources: Its files.
        called: Names of what may be a routine of another file, in their order.
    """

    def __init__(self, name: str, setup: ProgramSetup):
        super().__init__(tool_axis=setup.tool_axis or "z", feed=setup.feed)
        self.out.name = name
        self.pass_over = frozenset(one.upper() for one in setup.pass_over)
        self.sources, self.called = Sources(), dict[str, None]()
        self.code, self.routine, self.is_running = Code(), "", False
        self.returned: dict[str, tuple[str, ...]] = {}
        # Of the choices that are open: what each compares, and its cases.
        self.choices: list[list[str]] = []
        self._labels: dict[str, int] = {}
        # Texts of statements by their steps.
        self._rows: dict[int, str] = {}

    def use(
        self, texts: Texts, statement: Callable[[str, int], None], equal: str
    ) -> None:
        """Take the expressions of the language, and what carries out a statement.

        Args:
            texts: The expressions.
            statement: Carries out a statement, of its text and its line.
            equal: Operator that compares two values.
        """
        self._equal = equal
        self.texts, self._statement, self._go = texts, statement, self._carry_out_step
        self.machine = Machine(self.code, texts.variables, self.out.name, self.faults)

    def compile(
        self, statements: Iterable[Statement], append: Callable[[str, int], None]
    ) -> None:
        """Append statements to the code.

        Args:
            statements: In their order.
            append: Appends one, of its text and its line.

        Raises:
            ProgramError: If there are more faults than are shown.
        """
        code = self.code
        for line, row in statements:
            code.weigh(line, row)
            append(row, line)
            if len(self.faults) + len(code.faults) > SHOWN_FAULTS:
                raise ProgramError(self.out.name, sorted([*self.faults, *code.faults]))

    def result_of(self, name: str, arguments: list[Expression]) -> Expression:
        """Value that a function of the program gives back."""

        def value(variables: Variables) -> Value:
            routine = self.code.routines.get(name)
            if routine is None:
                raise ExpressionError(name, "the program has no such function.")
            values = [argument(variables) for argument in arguments]
            if len(values) > len(routine.parameters):
                raise ExpressionError(name, _too_many(len(routine.parameters)))
            own: dict[Name, Value] = dict.fromkeys(routine.parameters)
            own |= zip(routine.parameters, values, strict=False)
            return self.machine.result_of(name, own, done)

        def done(values: dict[Name, Value]) -> None:
            names = self.code.routines[name].parameters
            for parameter, place in zip(names, places, strict=False):
                if isinstance(place, Variable) and parameter in self.returned[name]:
                    place.set(self.texts.variables, values[parameter])

        # A variable alone is read by its own method.
        places = [getattr(one, "__self__", None) for one in arguments]
        return value

    def refuse_count(self, row: str, line: int, count: int) -> None:
        """Refuse a call that has more values than its routine takes."""
        self.refuse(line, row, _too_many(count))

    def number(self, text: str) -> float:
        """Value of a number or of an expression; NaN if it has none, or too large."""
        try:
            value = float(text)
        except ValueError:
            return self.texts.number(text)
        return value if abs(value) <= LARGEST_NUMBER else math.nan

    def label(self, name: str) -> int:
        """Number of a label."""
        return self._labels.setdefault(name.upper(), len(self._labels))

    def compile_control(self, kind: str, value: str, line: int) -> bool:
        """Append a statement of control flow; False if it is none, or incomplete.

        Args:
            kind: What the word of the language is; "" for none of these.
            value: The condition, the values or the label behind it.
            line: Its line.
        """
        code = self.code
        if kind == "end routine":
            if self.routine:
                code.end_routine(line)
            self.routine = ""
        elif kind == "return":
            self.let_matter()
            code.give_back(line, self.texts.expression(value) if value else None)
        elif kind in ("if", "while") and value:
            begin = code.begin_loop if kind == "while" else code.begin_if
            begin(line, self.condition_of(line, self.texts.expression(value)))
        elif kind == "else if" and value and self.branches:
            code.otherwise(line, self.condition(self.texts.expression(value)))
        elif kind == "else":
            code.otherwise(line)
        elif kind in ("end if", "end while", "end for", "end do"):
            if kind in ("end if", "end while"):
                del self.branches[-1:]
            code.end(line, (kind.removeprefix("end "),))
        elif kind == "choice" and value:
            self.choices.append([value])
        elif kind == "case" and self.choices:
            self._add_case(value, line)
        elif kind == "end choice" and self.choices:
            if len(self.choices.pop()) > 1:
                code.end(line, ("if",))
        elif kind == "goto" and value:
            self.let_matter()
            number = self.label(value)
            code.jump(line, lambda variables: number, value[:30])
        else:
            return False
        return True

    def _add_case(self, values: str, line: int) -> None:
        """Append a case of the innermost choice; "" is that for all other values."""
        choice, sign = self.choices[-1], self._equal
        tests = [
            f"(({choice[0]}) {sign} ({one}))" for one in split_arguments(values) if one
        ]
        condition = self.texts.expression(" OR ".join(tests) or "TRUE")
        if len(choice) == 1:
            self.code.begin_if(line, condition)
        else:
            self.code.otherwise(line, condition)
        choice.append(values)

    def add(self, line: int, row: str) -> None:
        """Append a statement."""
        # One action for all statements: a program may have a million.
        self._rows[len(self.code.steps)] = row
        self.code.plain(line, self._go)

    def _carry_out_step(self, machine: Machine) -> None:
        self.attempt(machine.line, self._rows[machine.at - 1])
        if len(self.faults) > SHOWN_FAULTS:
            machine.stop()

    def attempt(self, line: int, row: str) -> None:
        """Carry out a statement; what is wrong is told, once."""
        count = len(self.faults)
        try:
            self._statement(row, line)
        except ExpressionError as error:
            self.refuse(line, error.word or row, str(error))
        if self.faults[count:] and self.faults[count] in self.faults[:count]:
            # Another turn of a loop would tell nothing else.
            del self.faults[count:]
            self.machine.stop()

    def dwell(self, value: str, row: str, line: int) -> None:
        """Let the tool rest for so many seconds."""
        duration = self.number(value)
        if math.isnan(duration) and re.fullmatch(NUMBER, value.strip()):
            duration = float(value)
        if math.isnan(duration):
            self.refuse(line, row, "needed is a number of seconds.")
        else:
            self.out.dwell(duration, line, row)

    def passes(self, name: str, line: int) -> bool:
        """True if a job says that a routine of another file moves nothing."""
        if name.upper() in self.pass_over:
            sentence = "is passed over, as [program] pass_over says"
            self.out.note(name, sentence, line)
        return name.upper() in self.pass_over

    def refuse_statement(self, row: str, line: int, name: str | None) -> None:
        """Refuse a statement, which may be a call of a routine of another file."""
        message = "is no plain motion and is not supported"
        if name is not None:
            message += (
                f'; [program] pass_over = ["{name[:40]}"] leaves it out if it moves '
            )
            message += "neither arm nor work"
        self.refuse(line, row, f"{message}.")

    def run(self, last: int, main: str | None) -> None:
        """End what is open and carry the program out.

        Args:
            last: Last line of the program.
            main: Name of its main routine, if that has to have one.
        """
        code = self.code
        if self.routine:
            code.end_routine(last)
        if not code.faults:
            code.finish()
        self.faults.extend(code.faults)
        names = list(code.routines)
        if main is not None and len(names) > 1 and main not in names:
            message = f"which of several routines runs? Needed is one named {main}."
            self.refuse(0, "", message)
        if not self.faults:
            self.is_running = True
            first = next(iter(names), None)
            self.machine.run(main if main in names else first)
