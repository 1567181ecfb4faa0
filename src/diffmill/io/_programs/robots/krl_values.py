"""Values of KRL: expressions, declared variables, arrays and structures, frames."""

import math
import operator
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from ..expressions import (
    Expression,
    ExpressionError,
    Grammar,
    Name,
    Parser,
    Value,
    Variables,
    number_of,
    split_arguments,
)
from ..geometry import abc_of_rotation, rotation_of_abc
from ..limits import LARGEST_NUMBER, MOST_VALUES
from .texts import FUNCTIONS, NUMBER, ORDERS, Texts, logical

# A component with a number, and a place of such ones alone.
_COMPONENT = rf"[A-Z]\w*\s+{NUMBER}"
_COMPONENTS = re.compile(rf"([A-Z]\w*)\s+({NUMBER})")
_TOKEN = re.compile(
    rf"\s*(?:(?P<literal>\{{\s*(?:\w+\s*:\s*)?{_COMPONENT}\s*"
    rf"(?:,\s*{_COMPONENT}\s*)*\}})"
    r"|(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:E[+-]?[0-9]+)?)"
    r"|(?P<text>\"[^\"]*\"|'[BH][0-9A-F]+')|(?P<name>[A-Z_$#][\w$]*)"
    r"|(?P<sign>==|<>|<=|>=|[-+*/()\[\],.:{}<>=]))",
    re.IGNORECASE,
)
_DECLARATION = re.compile(
    r"((?:(?:GLOBAL|DECL|CONST)\s+)*)([A-Z_]\w*)\s+([A-Z_$]\w*.*)", re.IGNORECASE
)
_ITEM = re.compile(
    r"([A-Z_$]\w*)\s*(\[[\d\s,]*\])?\s*(?:=(?!=)\s*(.*))?", re.IGNORECASE
)
_ASSIGNMENT = re.compile(
    r"([A-Z_]\w*(?:\s*[\[.][^=<>]*)?)\s*=(?!=)\s*(.*)", re.IGNORECASE
)
_STRUCTURE = re.compile(
    # No text is a list of components in two ways: a long one is read once.
    r"(?:(?:GLOBAL|DECL)\s+)*STRU[C]\s+(\w+)\s+(\w+\s+\w+(?:\[\d*\])?"
    r"(?: ?, ?\w+(?: \w+)*(?:\[\d*\])?)*)",
    re.IGNORECASE,
)
_AXES = tuple("XYZABC")
_EXTERNAL = tuple(f"E{n}" for n in range(1, 7))
_JOINTS = tuple(f"A{n}" for n in range(1, 7))
# Components of the structures of places, and of other types without any.
_TYPES: dict[str, tuple[str, ...]] = {
    "FRAME": _AXES,
    "POS": (*_AXES, "S", "T"),
    "E6POS": (*_AXES, "S", "T", *_EXTERNAL),
    "AXIS": _JOINTS,
    "E6AXIS": (*_JOINTS, *_EXTERNAL),
    **dict.fromkeys(("INT", "REAL", "BOOL", "CHAR"), ()),
}
_LENGTHS = frozenset({*_AXES, *_EXTERNAL, *_JOINTS})
_PARTS = _LENGTHS | {"S", "T"}
Frame = dict[str, float]


def _quotient(a: Any, b: Any) -> Value:
    """Quotient; that of two whole numbers is cut to a whole one."""
    return int(a / b) if isinstance(a, int) and isinstance(b, int) else a / b


def _negative(x: Any) -> Value:
    return -x


def _product(a: Value, b: Value) -> Value:
    """Frame b, given in frame a, in the frame in which that is given."""
    if not (isinstance(a, dict) and isinstance(b, dict)):
        raise TypeError
    (at, R), (to, turn) = _pose(a), _pose(b)
    return _frame(at + R @ to, R @ turn)


def _inverse(a: Value) -> Value:
    if not isinstance(a, dict):
        raise TypeError
    at, R = _pose(a)
    return _frame(-R.T @ at, R.T)


def _pose(
    frame: Mapping[str, Any],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Place [mm] and rotation of a frame."""
    values = [float(frame.get(key) or 0.0) for key in "XYZABC"]
    return np.array(values[:3]), rotation_of_abc(*values[3:])


def _frame(at: Float[np.ndarray, "3"], R: Float[np.ndarray, "3 3"]) -> Value:
    return dict(zip("XYZABC", [*at.tolist(), *abc_of_rotation(R)], strict=True))


def _literal(text: str) -> Value:
    """Structure of components with a number.

    Raises:
        ExpressionError: If one is too large.
    """
    parts = _COMPONENTS.findall(text.upper())
    values = {n: float(x) if n in _LENGTHS else number_of(x) for n, x in parts}
    if max(map(abs, values.values())) > LARGEST_NUMBER:
        message = f"a number is {LARGEST_NUMBER:g} at most."
        raise ExpressionError(text, message)
    return values


def _operand(parser: Parser) -> Expression | None:
    """Read a structure such as {X 1,Y 2}, a constant #NAME or bits such as 'B01'."""
    if parser.kind == "name" and parser.word.startswith("#"):
        word = parser.advance()
        return lambda variables: word
    if parser.kind == "text" and parser.word.startswith("'"):
        word = parser.advance()
        number = int(word[2:-1], 2 if word[1] in "Bb" else 16)
        return lambda variables: number
    if not parser.take("{"):
        return None
    parts: list[tuple[str, Expression]] = []
    while not parser.take("}"):
        if parts:
            parser.expect(",")
        name = parser.advance()
        if not parts and parser.take(":"):
            name = parser.advance()
        if parser.take("["):
            parser.expect("]")
        parts.append((name, parser.expression()))

    def value(variables: Variables) -> Value:
        return {name: _typed("", name, part(variables)) for name, part in parts}

    return value


def _typed(kind: str, component: Name | None, value: Value) -> Value:
    """Value as a variable of a type, or a component of a place, keeps it."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    if component in _LENGTHS or kind == "REAL":
        return float(value)
    return math.floor(value + 0.5) if kind == "INT" else value


class KrlValues:
    """Variables of a KRL program, by name in upper case.

    Attributes:
        variables: Their values.
        texts: Expressions of them.
    """

    def __init__(
        self,
        missing: Callable[[Name], Value],
        call: Callable[[str, list[Expression]], Expression],
    ) -> None:
        self.variables = Variables(missing)
        # Places of a controller's own arrays, filled where a program does so.
        for name in ("BASE_DATA", "TOOL_DATA"):
            self.variables.declare(name, [None] * 128, self.variables.shared)
        grammar = Grammar(
            token=_TOKEN,
            # The operators of comparison bind least of all.
            binary=(
                {"==": operator.eq, **ORDERS},
                {"OR": logical(operator.or_), "B_OR": operator.or_},
                {"EXOR": logical(operator.xor), "B_EXOR": operator.xor},
                {"AND": logical(operator.and_), "B_AND": operator.and_},
                {"+": operator.add, "-": operator.sub},
                {"*": operator.mul, "/": _quotient},
                {":": _product},
            ),
            unary={
                "-": (_negative, 6),
                "+": (lambda x: x, 6),
                "NOT": (operator.not_, 6),
            },
            functions={**FUNCTIONS, "INV_POS": _inverse},
            constants={
                "TRUE": True,
                "FALSE": False,
                "$NULLFRAME": dict.fromkeys("XYZABC", 0.0),
                "$WORLD": dict.fromkeys("XYZABC", 0.0),
            },
            literal=_literal,
            operand=_operand,
            call=call,
        )
        self.texts = Texts(self.variables, grammar)
        self._types = dict(_TYPES)

    def declare_data(
        self, name: str, text: str, values: dict[Name, Value] | None
    ) -> None:
        """Declare data of an inline form such as {TOOL_NO 1,BASE_NO 2}, as written."""
        self.variables.declare(f"data {name.upper()}", text, values)

    def data(self, name: str) -> str:
        """Data of an inline form; "" where none of this name are declared."""
        key = f"data {name.strip().upper()}"
        return str(self.variables.get(key)) if key in self.variables else ""

    def frame(self, text: str) -> Frame | None:
        """Components of a place that an expression is; None if it is none.

        Raises:
            ExpressionError: If it is written out, with a fault.
        """
        is_written = text.startswith("{")
        try:
            frame = components_of(self.texts.value(text))
        except ExpressionError:
            if is_written:
                raise
            return None
        if frame is None and is_written:
            message = "a place has X, Y, Z, A, B, C, S, T, and A1 to A6, E1 to E6."
            raise ExpressionError(text, message)
        return frame

    def declare(self, row: str, values: dict[Name, Value] | None) -> bool:
        """Declare the variables of a row; False if it is no declaration.

        Args:
            row: A line without its comment.
            values: Those among which they are; None for those of the call at work.

        Raises:
            ExpressionError: If an array is too large, or a value has a fault.
        """
        if structure := _STRUCTURE.fullmatch(row):
            names = re.findall(r"(\w+)(?:\[\d*\])? ?(?:,|$)", structure[2].upper())
            self._types[structure[1].upper()] = tuple(names)
            return True
        match = _DECLARATION.fullmatch(row)
        if match is None or not (match[1] or match[2].upper() in self._types):
            return False
        kind = match[2].upper()
        for text in split_arguments(match[3]):
            item = _ITEM.fullmatch(text)
            if item is None:
                return kind not in self._types
            name, value = item[1].upper(), item[3]
            if value is not None and kind not in ("INT", "REAL", "BOOL", "CHAR"):
                if self._types.get(kind) and value.startswith("{"):
                    start = self.texts.value(value)
                    if item[2]:
                        self.put(f"{name}{item[2]}", start)
                    else:
                        start = _whole(self._types[kind], start)
                        self.variables.declare(name, start, values)
                continue
            own = self.variables.calls[-1]
            if values is None and name in own:
                # A parameter has its value from the call.
                self.variables.declare(f"type {name}", kind)
                if own[name] is not None:
                    self.put(name, own[name])
                continue
            start = (
                None if value is None else _typed(kind, None, self.texts.value(value))
            )
            if item[2] and value is not None:
                self.put(f"{name}{item[2]}", start)
                continue
            parts = self._types.get(kind, ())
            if value is None:
                sizes = [float(one) for one in re.findall(r"\d+", item[2] or "")]
                element = dict.fromkeys(parts) if parts else None
                self.variables.declare_array(name, sizes, element, values)
            else:
                self.variables.declare(name, start, values)
            self.variables.declare(f"type {name}", kind, values)
        return True

    def assign(self, row: str) -> bool:
        """Carry out an assignment; False if a row is none.

        Raises:
            ExpressionError: If the value has a fault, or nothing can take it.
        """
        match = _ASSIGNMENT.fullmatch(row)
        if match is None:
            return False
        self.put(match[1], self.texts.value(match[2]))
        return True

    def put(self, text: str, value: Value) -> None:
        """Put a value to a place: a variable, an element or a component."""
        variables, place = self.variables, self.texts.place(text)
        name = place.name(variables)
        kind = ""
        if f"type {name}" in variables:
            kind = str(variables.get(f"type {name}"))
        last = place.path[-1] if place.path else None
        component = last if isinstance(last, str) else None
        if component is None and isinstance(value, dict):
            parts = self._types.get(kind) or _TYPES["E6POS"]
            value = _whole(parts, value) if set(value) <= set(parts) else value
        index = place.path[0] if place.path else None
        if index is not None and not isinstance(index, str):
            self._grow(name, index(variables))
        place.set(
            variables, _typed(kind if component is None else "", component, value)
        )

    def _grow(self, name: Name, index: Value) -> None:
        """Make an array that nothing declares as long as it is used."""
        variables = self.variables
        if f"type {name}" in variables or not isinstance(index, int):
            return
        values = variables.get(name) if name in variables else []
        if isinstance(values, list) and len(values) < index <= MOST_VALUES:
            longer = [*values, *[None] * max(index - len(values), len(values))]
            variables.declare(name, longer, variables.file)


def components_of(value: Value) -> Frame | None:
    """Components of a place that have a number; None if a value is no place."""
    if not isinstance(value, dict) or not _PARTS.issuperset(value):
        return None
    return {
        key: float(part) for key, part in value.items() if isinstance(part, int | float)
    }


def _whole(parts: tuple[str, ...], value: Value) -> Value:
    """Structure with all components, of which those of a value have one."""
    return dict.fromkeys(parts) | value if isinstance(value, dict) else value
