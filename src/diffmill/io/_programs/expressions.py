"""Expressions of program languages: operators by precedence, values, variables.

A language has a `Grammar`; `Parser` makes an `Expression` of its text, a function of
`Variables`. What is parsed once may be evaluated often.
"""

import functools
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias

from .faults import ProgramError
from .limits import MOST_COPIED, MOST_OPERANDS, MOST_VALUES

# A list is an array, counted from 1, a dictionary a structure; None has no value yet.
Value: TypeAlias = int | float | bool | str | list[Any] | dict[str, Any] | None
Name: TypeAlias = str | int
Expression: TypeAlias = Callable[["Variables"], Value]

# Brackets, signs and names of names that stand in each other.
_DEEPEST_OPERAND = 40
_LARGEST_VALUE = 1e100
_LONGEST_STRING = 10_000
_MOST_DIMENSIONS = 3


class ExpressionError(ValueError):
    """An expression that cannot be read, or that has no value.

    Attributes:
        word: What was found; may be empty.
    """

    def __init__(self, word: str, message: str):
        self.word = word[:30]
        super().__init__(message)


class Variables:
    """Values by name: those of the program, of each file, and each call's own.

    Attributes:
        shared: Values that all routines see.
        file: Values that the routines of the file at work see.
        calls: Own values of the calls at work, the main program's first.
        is_own: Whether a name that nothing declares belongs to its call.
        missing: Value of a name that has none; it may raise an `ExpressionError`.
    """

    def __init__(
        self,
        missing: Callable[[Name], Value],
        is_own: Callable[[Name], bool] = lambda name: False,
    ):
        self.shared: dict[Name, Value] = {}
        self.file: dict[Name, Value] = {}
        self._callers: list[dict[Name, Value]] = []
        self.calls: list[dict[Name, Value]] = [{}]
        self.is_own, self.missing = is_own, missing
        # Values that are kept, and those that have been copied so far.
        self._size = self._copied_count = 0

    def __contains__(self, name: Name) -> bool:
        """True if a name has a value."""
        return any(name in values for values in self._scopes())

    def _scopes(self) -> Sequence[dict[Name, Value]]:
        """Values that the call at work sees, those first that hide others."""
        return self.calls[-1], self.file, self.shared

    def get(self, name: Name) -> Value:
        """Value of a name."""
        own, file = self.calls[-1], self.file
        values = own if name in own else file if name in file else self.shared
        value = values.get(name)
        return self.missing(name) if value is None else value

    def set(self, name: Name, value: Value) -> None:
        """Give a name a value, where it is declared, else where it belongs."""
        new = self.calls[-1] if self.is_own(name) else self.shared
        values = next((one for one in self._scopes() if name in one), new)
        self.put(values, name, value)

    def declare(
        self, name: Name, value: Value, values: dict[Name, Value] | None = None
    ) -> None:
        """Give a name a value among some; None for those of the call at work."""
        self.put(self.calls[-1] if values is None else values, name, value)

    def declare_array(
        self,
        name: Name,
        sizes: Sequence[float],
        element: Value,
        values: dict[Name, Value] | None = None,
    ) -> None:
        """Declare an array of equal elements, or one of them where it has no size.

        Raises:
            ExpressionError: If it has more values than a program may keep; it is not
                made then.
        """
        if not all(size >= 1 and size % 1 == 0 for size in sizes):
            message = "the size of an array is a whole number from 1."
            raise ExpressionError(str(name), message)
        if len(sizes) > _MOST_DIMENSIONS:
            message = f"an array has {_MOST_DIMENSIONS} dimensions at most."
            raise ExpressionError(str(name), message)
        count: float = _count(element)
        for size in reversed(sizes):
            count = 1 + size * count
        if self._size + count > MOST_VALUES:
            raise ExpressionError(str(name), _TOO_MANY)
        self.declare(name, _array(list(map(int, sizes)), element), values)

    def put(
        self, holder: dict[Name, Value] | list[Value], key: Name, value: Value
    ) -> None:
        """Put a copy of a value in the place of another one, and count their parts."""
        places: Any = holder
        is_there = isinstance(holder, list) or key in holder
        count = _count(value)
        self._size += count - (_count(places[key]) if is_there else 0)
        self._copied_count += count
        if self._size > MOST_VALUES:
            raise ExpressionError("", _TOO_MANY)
        if self._copied_count > MOST_COPIED:
            message = f"assignments and calls copy more than {MOST_COPIED} values."
            raise ExpressionError("", message)
        places[key] = _copied(value)

    def hide(self, name: Name) -> None:
        """Hide a variable of the call at work behind a new one, which is 0."""
        self.declare(f"hidden {name}", self.calls[-1].get(name))
        self.declare(name, 0)

    def show(self, name: Name) -> None:
        """Show the variable again that `hide` has hidden."""
        hidden = self.calls[-1].pop(f"hidden {name}", None)
        if hidden is None:
            self.calls[-1].pop(name, None)
        else:
            self.declare(name, hidden)

    def enter(self, own: dict[Name, Value], file: dict[Name, Value] | None) -> None:
        """Begin a call with own values, in a file with values; None for the same."""
        self.calls.append({})
        self._callers.append(self.file)
        self.file = self.file if file is None else file
        for name, value in own.items():
            self.put(self.calls[-1], name, value)

    def leave(self) -> dict[Name, Value]:
        """End a call; return its own values."""
        own, self.file = self.calls.pop(), self._callers.pop()
        self._size -= sum(map(_count, own.values()))
        return own


# Types of values that have others in them; large ones are gone through often.
_HOLDERS = (list, dict)
_HOLDER_TYPES = frozenset(_HOLDERS)
_TOO_MANY = f"the program keeps more than {MOST_VALUES} values."


def _count(value: Value, depth: int = 0) -> int:
    """Number of the values that a value has in it, both bounded."""
    if not isinstance(value, _HOLDERS):
        return 1
    if depth > _DEEPEST_OPERAND:
        message = f"values are in each other more than {_DEEPEST_OPERAND} deep."
        raise ExpressionError("", message)
    count = 1 + len(value)
    parts = value.values() if isinstance(value, dict) else value
    for part in () if _are_numbers(parts) else parts:
        if isinstance(part, _HOLDERS):
            count += _count(part, depth + 1) - 1
        if count > MOST_VALUES:
            break
    if count > MOST_VALUES:
        raise ExpressionError("", _TOO_MANY)
    return count


class Variable(NamedTuple):
    """Variable, or a part of one, to which a value is assigned.

    Attributes:
        name: The variable's name.
        path: Indices, counted from 1, and names of components that lead to the part.
    """

    name: Callable[[Variables], Name]
    path: tuple[Expression | str, ...] = ()

    def get(self, variables: Variables) -> Value:
        """Value of the variable."""
        value = variables.get(self.name(variables))
        for step in self.path:
            holder, key = _part(value, step, variables)
            value = holder[key]
        return value

    def set(self, variables: Variables, value: Value) -> None:
        """Put a copy of a value."""
        name = self.name(variables)
        if not self.path:
            variables.set(name, value)
            return
        holder = variables.get(name)
        for step in self.path[:-1]:
            inner, key = _part(holder, step, variables)
            holder = inner[key]
        inner, key = _part(holder, self.path[-1], variables)
        variables.put(inner, key, value)


def _part(
    value: Value, step: Expression | str, variables: Variables
) -> tuple[Any, Any]:
    """Array or structure of a value, and the index or name of a part that it has."""
    if isinstance(step, str):
        if isinstance(value, dict) and step in value:
            return value, step
        raise ExpressionError(step, "there is no such component.")
    index = step(variables)
    if not isinstance(value, list):
        raise ExpressionError("", "what has an index is an array.")
    if not isinstance(index, int | float) or index % 1 or not 1 <= index <= len(value):
        message = f"the index is {index}; allowed is 1 to {len(value)}."
        raise ExpressionError("", message)
    return value, int(index) - 1


def _are_numbers(parts: Iterable[Value]) -> bool:
    """True if no part has others in it; an array of numbers is long, and has none."""
    return _HOLDER_TYPES.isdisjoint(map(type, parts))


def _copied(value: Value) -> Value:
    if isinstance(value, list):
        if _are_numbers(value):
            return value.copy()
        return [_copied(x) if isinstance(x, _HOLDERS) else x for x in value]
    if isinstance(value, dict):
        # Most parts of a place are numbers.
        return {
            n: _copied(x) if isinstance(x, _HOLDERS) else x for n, x in value.items()
        }
    return value


def _array(sizes: list[int], element: Value) -> Value:
    """Array of copies of an element."""
    if not sizes:
        return _copied(element)
    return [_array(sizes[1:], element) for _ in range(sizes[0])]


class _Operand(NamedTuple):
    """Operator with the operand behind it."""

    operator: Callable[[Value, Value], Value]
    value: Expression


def _no_operand(parser: "Parser") -> Expression | None:
    return None


@dataclass(frozen=True)
class Grammar:
    """Grammar of the expressions of a language. Words are in upper case.

    Attributes:
        token: Pattern of a token; its groups `number`, `name`, `text` (a string, with
            its quotes), `literal` (an array or a structure of numbers alone) and `sign`
            tell what it is.
        binary: Operators between operands by precedence, the weakest first.
        unary: Operators before an operand, with the index in `binary` of the weakest
            operators that their operand has in it.
        functions: Functions of values, called with brackets behind their name.
        constants: Values of names.
        brackets: Those around an operand, around arguments and around an index; an
            empty index is none.
        literal: Value of a literal.
        operand: Reader of operands that only this language has; None for no such one.
        is_calling: Whether any name may be a function, which `call` then carries out.
    """

    token: re.Pattern[str]
    binary: tuple[Mapping[str, Callable[[Value, Value], Value]], ...]
    unary: Mapping[str, tuple[Callable[[Value], Value], int]]
    functions: Mapping[str, Callable[..., Value]]
    constants: Mapping[str, Value] = field(default_factory=dict)
    brackets: tuple[str, str, str] = ("()", "()", "[]")
    literal: Callable[[str], Value] = str
    operand: "Callable[[Parser], Expression | None]" = _no_operand
    call: Callable[[str, list[Expression]], Expression] | None = None

    @functools.cached_property
    def levels(self) -> dict[str, int]:
        """Index of the precedence of every operator between operands."""
        return {word: at for at, level in enumerate(self.binary) for word in level}


class Parser:
    """Reader of the tokens of a text from a position on.

    Attributes:
        at: Position behind the last token that was taken.
        kind: Group of the next token, "" at the end or where there is none.
        word: The next token, a name or a sign in upper case.
    """

    def __init__(self, text: str, grammar: Grammar, at: int = 0):
        self.text, self.grammar, self.at = text, grammar, at
        self._depth = self._count = 0
        self._read_token()

    def _read_token(self) -> None:
        match = self.grammar.token.match(self.text, self.at)
        if match is None or match.lastgroup is None:
            self.kind, self.word, self._end = "", "", self.at
            return
        self.kind, self._end = match.lastgroup, match.end()
        self.word = match[self.kind]
        if self.kind != "text":
            self.word = self.word.upper()

    def advance(self) -> str:
        """Take the next token; return its word."""
        word, self.at = self.word, self._end
        self._read_token()
        return word

    def take(self, words: Collection[str]) -> str:
        """Take the next token if it is one of some words; else return ""."""
        is_word = self.kind in ("name", "sign") and self.word in words
        return self.advance() if is_word else ""

    def expect(self, word: str) -> None:
        """Take a token that has to follow."""
        if not self.take((word,)):
            found = self.text[self.at :].strip()
            raise ExpressionError(found or self.text, f"needed is a {word} here.")

    def finish(self) -> None:
        """Refuse anything behind what was taken."""
        if rest := self.text[self.at :].strip():
            raise ExpressionError(rest, "does not belong to the expression before it.")

    def expression(self, level: int = 0) -> Expression:
        """Read an expression of the operators from a level of precedence on."""
        levels, value = self.grammar.levels, self.operand()
        chain, before = list[_Operand](), -1
        while self.kind in ("name", "sign"):
            at = levels.get(self.word, -1)
            if at < level:
                break
            action = self.grammar.binary[at][self.advance()]
            if at != before:
                # What is there is the first operand of the weaker operators behind it.
                chain, before = [], at
                value = _chain(value, chain)
            chain.append(_Operand(action, self.expression(at + 1)))
        return value

    def operand(self) -> Expression:
        """Read a number, a variable, a call, or an expression in brackets."""
        self._depth += 1
        if self._depth > _DEEPEST_OPERAND:
            message = f"brackets and signs are nested deeper than {_DEEPEST_OPERAND}."
            raise ExpressionError(self.text[self.at :], message)
        self._count += 1
        if self._count > MOST_OPERANDS:
            message = f"an expression has more than {MOST_OPERANDS} values."
            raise ExpressionError(self.text[self.at :], message)
        grammar, (opening, closing) = self.grammar, self.grammar.brackets[0]
        if self.kind == "number":
            value = constant(number_of(self.advance()))
        elif self.kind == "literal":
            value = constant(grammar.literal(self.advance()))
        elif (value := grammar.operand(self)) is not None:
            pass
        elif self.kind == "text":
            value = constant(self.advance()[1:-1])
        elif word := self.take(grammar.unary):
            action, level = grammar.unary[word]
            value = _call(action, [self.expression(level)])
        elif self.take(opening):
            value = self.expression()
            self.expect(closing)
        elif self.kind == "name":
            value = self._named()
        else:
            found = self.text[self.at :].strip()
            raise ExpressionError(found or self.text, "needed is a number or a name.")
        self._depth -= 1
        return value

    def _named(self) -> Expression:
        """Read a constant, a call or a variable."""
        grammar = self.grammar
        if self.word in grammar.constants:
            return constant(grammar.constants[self.advance()])
        position = self.at
        name = self.advance()
        if self.kind == "sign" and self.word == grammar.brackets[1][0]:
            function = grammar.functions.get(name)
            if function is not None:
                return _call(function, self.arguments())
            if grammar.call is not None:
                return grammar.call(name, self.arguments())
            raise ExpressionError(self.text[position:].strip(), "no such function.")
        return self._variable_behind(name).get

    def arguments(self) -> list[Expression]:
        """Read expressions in brackets, separated by commas."""
        opening, closing = self.grammar.brackets[1]
        self.expect(opening)
        values: list[Expression] = []
        while not self.take(closing):
            if values:
                self.expect(",")
            values.append(self.expression())
        return values

    def variable(self) -> Variable:
        """Read a variable, with an index or components."""
        if self.kind != "name":
            found = self.text[self.at :].strip()
            raise ExpressionError(found or self.text, "needed is the name of a value.")
        return self._variable_behind(self.advance())

    def _variable_behind(self, name: str) -> Variable:
        path: list[Expression | str] = []
        opening, closing = self.grammar.brackets[2] or ("", "")
        while self.kind == "sign":
            if self.take("."):
                path.append(self.advance())
            elif opening and self.take(opening):
                path.append(self.expression())
                while self.take(","):
                    path.append(self.expression())
                self.expect(closing)
            else:
                break
        return Variable(lambda variables: name, tuple(path))


def number_of(text: str) -> float | int:
    """Value of a number as written, a whole one without a point as such."""
    return int(text) if text.isdecimal() and len(text) < 20 else float(text)


def constant(value: Value) -> Expression:
    """A value as an expression."""
    return lambda variables: value


def _chain(
    first: Expression,
    operands: list[_Operand],
) -> Expression:
    """Operators of one precedence from left to right, their results bounded."""

    def value(variables: Variables) -> Value:
        result = first(variables)
        for operand in operands:
            result = _bounded(operand.operator(result, operand.value(variables)))
        return result

    return value


def _call(function: Callable[..., Value], arguments: list[Expression]) -> Expression:
    def value(variables: Variables) -> Value:
        return _bounded(function(*[argument(variables) for argument in arguments]))

    return value


def _bounded(value: Value) -> Value:
    """The value, if it is neither too large nor no number."""
    if type(value) is float and -_LARGEST_VALUE <= value <= _LARGEST_VALUE:
        return value
    if isinstance(value, str) and len(value) > _LONGEST_STRING:
        raise ExpressionError(value, "a string is too long.")
    if isinstance(value, int | float) and not abs(value) <= _LARGEST_VALUE:
        raise ExpressionError("", f"a number is beyond {_LARGEST_VALUE:g}.")
    return value


def evaluated(expression: Expression, variables: Variables) -> Value:
    """Value of an expression.

    Raises:
        ExpressionError: If it has none.
    """
    try:
        return expression(variables)
    except ZeroDivisionError:
        raise ExpressionError("", "a number is divided by zero.") from None
    except ArithmeticError:
        raise ExpressionError("", "a number is too large.") from None
    except TypeError:
        message = "an operator or a function has no value for what it is given."
        raise ExpressionError("", message) from None
    except (ExpressionError, ProgramError):
        # A function of the program has told what is wrong, and in which line.
        raise
    except ValueError:
        message = "a function has no value for its argument."
        raise ExpressionError("", message) from None


# A number as robot programs write it.
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
# Brackets with none in them are one match.
_BRACKET = re.compile(r"[\[({][^\[\](){}]*[\])}]|[\[\](){},]")


def split_arguments(text: str) -> list[str]:
    """Return arguments that are separated by commas outside of brackets."""
    out, depth, begun = [], 0, 0
    for match in _BRACKET.finditer(text):
        sign, index = match[0], match.start()
        if sign == ",":
            if depth == 0:
                out.append(text[begun:index].strip())
                begun = index + 1
        elif len(sign) == 1:
            depth += 1 if sign in "[({" else -1
    return [*out, text[begun:].strip()]
