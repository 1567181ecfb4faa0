"""Control flow of program languages: branches, loops, jumps and routines.

A reader calls the methods of `Code` in the order of the text; each appends steps, with
which a `Machine` runs the program, bounded in lines, depth and values.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, NoReturn

from .expressions import (
    Expression,
    ExpressionError,
    Name,
    Value,
    Variable,
    Variables,
    evaluated,
)
from .faults import Fault, ProgramError
from .limits import (
    DEEPEST_BLOCKS,
    DEEPEST_CALLS,
    LINE_OF_ONE_STEP,
    MOST_REPEATED,
)

Action = Callable[["Machine"], None]
_OTHER = {"if": "IF", "while": "WHILE", "do": "DO", "repeat": "REPEAT", "for": "FOR"}


class Routine(NamedTuple):
    """A routine.

    Attributes:
        start: Its first step.
        parameters: Names of its parameters.
        file: Values of its file; None where all files are one.
    """

    start: int
    parameters: tuple[str, ...] = ()
    file: dict[Name, Value] | None = None


@dataclass
class _Open:
    """A block that is not closed yet.

    Attributes:
        kind: "if", "while", "do", "repeat", "for" or "routine".
        line: Line at which it begins.
        label: Label of an O-word, or the name of a routine.
        start: Step to which a loop goes back.
        otherwise: Jump of a condition that does not hold, to be set at the next branch.
        leaving: Jumps to the step behind the block.
        going_on: Jumps to the step that ends a turn of a loop.
        turn: What ends a turn of a loop.
    """

    kind: str
    line: int
    label: str = ""
    start: int = 0
    otherwise: list[int] | None = None
    leaving: list[list[int]] = field(default_factory=list)
    going_on: list[list[int]] = field(default_factory=list)
    turn: Action | None = None


class Code:
    """Steps of a program.

    Attributes:
        steps: What each step so far does.
        lines: Line of each.
        routines: Routines by name.
        faults: What is wrong with its blocks.
        long_lines: How many steps more each step of a long line counts for.
        file: Values of the file that is compiled; None where all files are one.
    """

    def __init__(self) -> None:
        # Two lists: an object for each of a million steps would cost more time.
        self.steps: list[Action] = []
        self.lines: list[int] = []
        self.routines: dict[str, Routine] = {}
        self.faults: list[Fault] = []
        self.long_lines: dict[int, int] = {}
        self.file: dict[Name, Value] | None = None
        self._open: list[_Open] = []
        # Steps of a label by routine and label.
        self._labels: dict[tuple[str, int], list[int]] = {}

    def weigh(self, line: int, text: str) -> None:
        """Let the steps of a long line count for several, as they take longer."""
        if len(text) > LINE_OF_ONE_STEP:
            self.long_lines[line] = len(text) // LINE_OF_ONE_STEP

    def plain(self, line: int, action: Action) -> None:
        """Append a step that goes on to the next one, or sets `Machine.at`."""
        self.steps.append(action)
        self.lines.append(line)

    def assign(self, line: int, place: Variable, value: Expression) -> None:
        """Append an assignment."""

        def put(machine: "Machine") -> None:
            machine.put(place, machine.value(value))

        self.plain(line, put)

    def begin_if(self, line: int, condition: Expression, label: str = "") -> None:
        """Begin a block that is carried out where a condition holds."""
        self._begin("if", line, label).otherwise = self._branch(line, condition)

    def otherwise(
        self, line: int, condition: Expression | None = None, label: str = ""
    ) -> None:
        """Begin the block that is carried out where no condition before holds."""
        block = self._block(("if",), line, label)
        if block is None:
            return
        block.leaving.append(self._jump(line))
        self._land(block)
        if condition is not None:
            block.otherwise = self._branch(line, condition)

    def begin_loop(
        self,
        line: int,
        condition: Expression | None = None,
        *,
        kind: str = "while",
        label: str = "",
    ) -> None:
        """Begin a loop with a condition before each turn, or without ("do")."""
        block = self._begin(kind, line, label)
        if condition is not None:
            block.otherwise = self._branch(line, condition)

    def begin_repeat(self, line: int, count: Expression, label: str = "") -> None:
        """Begin a loop of so many turns; none where the number is not above 0."""
        counter = f"repeat {len(self.steps)}"

        def begin(machine: "Machine") -> None:
            machine.variables.declare(counter, machine.number(count))

        def turn(machine: "Machine") -> None:
            machine.variables.declare(counter, _number(own(machine)) - 1)

        def own(machine: "Machine") -> Value:
            return machine.variables.calls[-1][counter]

        self.plain(line, begin)
        block = self._begin("repeat", line, label)
        block.otherwise = self._branch(line, lambda v: _number(v.get(counter)) >= 0.5)
        block.turn = turn

    def begin_for(
        self,
        line: int,
        place: Variable,
        first: Expression,
        last: Expression,
        step: Expression | None = None,
    ) -> None:
        """Begin a loop that counts; last value and step are those at its begin."""
        bounds = f"for {len(self.steps)}"

        def begin(machine: "Machine") -> None:
            by = 1 if step is None else machine.number(step)
            if by == 0:
                machine.refuse("", "the step of a loop is not 0.")
            start, end = machine.value(first), machine.number(last)
            machine.variables.declare(bounds, [end, by])
            machine.put(place, start)

        def is_inside(variables: Variables) -> bool:
            value = variables.get(bounds)
            end, by = value if isinstance(value, list) else (0, 0)
            left = _number(end) - _number(place.get(variables))
            return left * _number(by) >= 0

        def turn(machine: "Machine") -> None:
            value = machine.variables.calls[-1].get(bounds)
            if not isinstance(value, list):
                machine.refuse("", "a jump into a loop does not begin it.")
            by = value[1]
            machine.put(place, machine.number(place.get) + _number(by))

        self.plain(line, begin)
        block = self._begin("for", line, "")
        block.otherwise = self._branch(line, is_inside)
        block.turn = turn

    def end(
        self,
        line: int,
        kinds: tuple[str, ...],
        label: str = "",
        *,
        again: Expression | None = None,
    ) -> None:
        """End a block; a loop goes on where `again` holds, if that is given."""
        block = self._block(kinds, line, label)
        if block is None:
            return
        self._open.pop()
        self._set(block.going_on, len(self.steps))
        if block.turn is not None:
            self.plain(line, block.turn)
        if again is not None:
            block.otherwise = self._branch(line, again)
        if block.kind not in ("if", "routine"):
            self._jump(line)[0] = block.start
        self._land(block)
        self._set(block.leaving, len(self.steps))

    def leave(self, line: int, label: str = "") -> None:
        """Append a jump behind the innermost loop, or the block of a label."""
        if block := self._loop(line, label):
            block.leaving.append(self._jump(line))

    def go_on(self, line: int, label: str = "") -> None:
        """Append a jump to the next turn of the innermost loop, or that of a label."""
        if block := self._loop(line, label):
            block.going_on.append(self._jump(line))

    def label(self, name: int) -> None:
        """Give the next step a label, which holds inside its routine."""
        self._labels.setdefault((self._routine(), name), []).append(len(self.steps))

    def jump(self, line: int, label: Expression, word: str = "") -> None:
        """Append a jump to the next step of a label, or its first one.

        Args:
            line: Its line.
            label: The label.
            word: How it is written, for messages; "" for the number of a line.
        """
        routine = self._routine()

        def go(machine: "Machine") -> None:
            number = machine.number(label)
            places = self._labels.get((routine, int(number)), [])
            if not places or number % 1:
                found = f"label {word}" if word else f"line N{number:g}"
                machine.refuse("", f"there is no {found} to go to.")
            machine.at = next((at for at in places if at >= machine.at), places[0])

        self.plain(line, go)

    def begin_routine(
        self, line: int, name: str, parameters: tuple[str, ...] = ()
    ) -> None:
        """Begin a routine, which is carried out where it is called."""
        if any(block.kind == "routine" for block in self._open):
            message = "a routine begins where the one before it has ended."
            self.faults.append(Fault(line, name, message))
        if name in self.routines:
            self.faults.append(Fault(line, name, "a routine has this name already."))
        over = self._jump(line)
        self._begin("routine", line, name).leaving.append(over)
        self.routines[name] = Routine(len(self.steps), parameters, self.file)

    def end_routine(self, line: int, label: str = "") -> None:
        """End a routine: it goes back to its call."""
        self.give_back(line)
        self.end(line, ("routine",), label)

    def give_back(self, line: int, value: Expression | None = None) -> None:
        """Append the return from a routine, with its value."""

        def go(machine: "Machine") -> None:
            machine.give_back(None if value is None else machine.value(value))

        self.plain(line, go)

    def is_open(self, kind: str, label: str = "") -> bool:
        """True if the innermost block has a kind and a label."""
        last = self._open[-1] if self._open else _Open("", 0)
        return (last.kind, last.label) == (kind, label)

    def finish(self) -> None:
        """Report the blocks that are not closed."""
        for block in self._open:
            message = f"this {_OTHER.get(block.kind, 'routine')} has no end."
            self.faults.append(Fault(block.line, block.label, message))

    def _begin(self, kind: str, line: int, label: str) -> _Open:
        if len(self._open) >= DEEPEST_BLOCKS:
            message = f"blocks are in each other more than {DEEPEST_BLOCKS} deep."
            self.faults.append(Fault(line, label, message))
        self._open.append(_Open(kind, line, label, len(self.steps)))
        return self._open[-1]

    def _block(self, kinds: tuple[str, ...], line: int, label: str) -> _Open | None:
        """The innermost block, if it is of some kinds and has a label."""
        block = self._open[-1] if self._open else None
        if (
            block is not None
            and block.kind in kinds
            and (block.label == label or "" in (label, block.label))
        ):
            return block
        names = " or ".join(_OTHER.get(kind, "routine") for kind in kinds)
        message = f"there is no {names} that it belongs to."
        if block is not None:
            what = _OTHER.get(block.kind, "routine")
            message += f" The {what} of line {block.line} is open."
        self.faults.append(Fault(line, label, message))
        return None

    def _loop(self, line: int, label: str) -> _Open | None:
        for block in reversed(self._open):
            if block.kind not in ("if", "routine") and label in ("", block.label):
                return block
        self.faults.append(Fault(line, label, "there is no loop around it."))
        return None

    def _routine(self) -> str:
        names = [block.label for block in self._open if block.kind == "routine"]
        return names[0] if names else ""

    def _jump(self, line: int) -> list[int]:
        """Append a jump; return the cell of its target."""
        target = [0]

        def go(machine: "Machine") -> None:
            machine.at = target[0]

        self.plain(line, go)
        return target

    def _branch(self, line: int, condition: Expression) -> list[int]:
        """Append a jump where a condition does not hold; return its target's cell."""
        target = [0]

        def go(machine: "Machine") -> None:
            if not machine.value(condition):
                machine.at = target[0]

        self.plain(line, go)
        return target

    def _land(self, block: _Open) -> None:
        """Let the condition that did not hold go on here."""
        if block.otherwise is not None:
            block.otherwise[0] = len(self.steps)
            block.otherwise = None

    def _set(self, jumps: list[list[int]], target: int) -> None:
        for jump in jumps:
            jump[0] = target


class _Call(NamedTuple):
    """A call at work: where it goes back to, and what it does with its own values."""

    back: int
    has_own: bool
    done: Callable[[dict[Name, Value]], None] | None


class Machine:
    """Run of a program.

    Attributes:
        code: The program.
        variables: Its values.
        name: Name of its file, for messages.
        faults: What is wrong with the program so far.
        at: The step that comes next.
        line: The line at work.
        result: Value that the last routine has given back.
    """

    def __init__(
        self, code: Code, variables: Variables, name: str, faults: list[Fault]
    ):
        self.code, self.variables, self.name, self.faults = (
            code,
            variables,
            name,
            faults,
        )
        self.at = 0
        self.result: Value = None
        self.line, self._step_count = 0, 0
        self._calls: list[_Call] = []

    @property
    def depth(self) -> int:
        """Number of the calls at work."""
        return len(self._calls)

    def run(self, routine: str | None = None) -> None:
        """Carry the program out, or a routine.

        Raises:
            ProgramError: If it reaches a bound, or an expression has no value.
        """
        if routine is not None:
            self.at = self.code.routines[routine].start
        try:
            self._run(-1)
        except RecursionError:
            self.refuse("", f"calls are in each other more than {DEEPEST_CALLS} deep.")

    def stop(self) -> None:
        """End the program."""
        self.at = len(self.code.steps)

    def call(
        self,
        routine: str,
        own: dict[Name, Value] | None = None,
        done: Callable[[dict[Name, Value]], None] | None = None,
    ) -> None:
        """Go to a routine.

        Args:
            routine: Its name.
            own: Its own values; None if it has those of its caller.
            done: Takes its own values after its return, for those that go back.
        """
        if routine not in self.code.routines:
            self.refuse(routine, "it is called, and is not in the program's file.")
        if len(self._calls) >= DEEPEST_CALLS:
            self.refuse("", f"calls are in each other more than {DEEPEST_CALLS} deep.")
        self._calls.append(_Call(self.at, own is not None, done))
        if own is not None:
            try:
                self.variables.enter(own, self.code.routines[routine].file)
            except ExpressionError as error:
                self.refuse(error.word, str(error))
        self.at = self.code.routines[routine].start

    def result_of(
        self,
        routine: str,
        own: dict[Name, Value],
        done: Callable[[dict[Name, Value]], None] | None = None,
    ) -> Value:
        """Value that a routine gives back, within an expression; see `call`."""
        back, line, depth = self.at, self.line, len(self._calls)
        self.result = None
        self.call(routine, own, done)
        self._run(depth)
        if len(self._calls) > depth:
            self.refuse(routine, "the program ends inside of an expression.")
        self.at, self.line = back, line
        return self.result

    def give_back(self, value: Value = None) -> None:
        """Go back to the call at work; without one the program ends."""
        self.result = value
        if not self._calls:
            self.stop()
            return
        call = self._calls.pop()
        own = self.variables.leave() if call.has_own else {}
        if call.done is not None:
            call.done(own)
        self.at = call.back

    def value(self, expression: Expression) -> Value:
        """Value of an expression of the line at work."""
        try:
            return evaluated(expression, self.variables)
        except ExpressionError as error:
            self.refuse(error.word, str(error))

    def number(self, expression: Expression) -> float | int:
        """Value of an expression that is a number."""
        value = self.value(expression)
        if not isinstance(value, int | float):
            self.refuse("", f"found {value!r} where a number is needed.")
        return value

    def put(self, place: Variable, value: Value) -> None:
        """Assign a value."""
        try:
            place.set(self.variables, value)
        except ExpressionError as error:
            self.refuse(error.word, str(error))

    def refuse(self, word: str, message: str) -> NoReturn:
        """End the program with a fault of the line at work.

        Raises:
            ProgramError: Always.
        """
        raise ProgramError(self.name, [*self.faults, Fault(self.line, word, message)])

    def _run(self, depth: int) -> None:
        """Carry steps out until calls are as deep, or the program ends."""
        steps, lines = self.code.steps, self.code.lines
        end, long_lines = len(steps), self.code.long_lines
        # What is carried out once is no repetition.
        most = end + MOST_REPEATED
        if long_lines:
            most += sum(long_lines.get(line, 0) for line in lines)
        while self.at < end and len(self._calls) > depth:
            self.line, action = lines[self.at], steps[self.at]
            self.at += 1
            self._step_count += 1 + long_lines.get(self.line, 0)
            if self._step_count > most:
                message = f"loops and calls carry out more than {MOST_REPEATED} lines."
                self.refuse("", message)
            action(self)


def _number(value: Value) -> float | int:
    return value if isinstance(value, int | float) else 0
