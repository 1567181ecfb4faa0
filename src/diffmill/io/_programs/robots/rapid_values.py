"""Values of RAPID: expressions, records such as robtarget, arrays, functions."""

import math
import operator
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from ..expressions import (
    Expression,
    ExpressionError,
    Grammar,
    Name,
    Parser,
    Value,
    Variables,
)
from ..geometry import quaternion_of_rotation, rotation_of_abc, rotation_of_quaternion
from .texts import FUNCTIONS, NUMBER, ORDERS, Texts, logical

_LIST = rf"\[\s*{NUMBER}\s*(?:,\s*{NUMBER}\s*)*\]"
_NUMBERS = re.compile(r"\[([^\[\]]*)\]")
_TOKEN = re.compile(
    rf"\s*(?:(?P<literal>{_LIST}|\[\s*{_LIST}\s*(?:,\s*{_LIST}\s*)*\])"
    r"|(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:E[+-]?[0-9]+)?)|(?P<text>\"[^\"]*\")"
    r"|(?P<name>[A-Z_]\w*)|(?P<sign>:=|<>|<=|>=|[-+*/()\[\]{},.<>=\\:]))",
    re.IGNORECASE,
)
# Components of records, with the record of which each is one.
_RECORDS: dict[str, dict[str, str]] = {
    "POS": dict.fromkeys("XYZ", "NUM"),
    "ORIENT": dict.fromkeys(("Q1", "Q2", "Q3", "Q4"), "NUM"),
    "CONFDATA": dict.fromkeys(("CF1", "CF4", "CF6", "CFX"), "NUM"),
    "EXTJOINT": dict.fromkeys([f"EAX_{letter}" for letter in "ABCDEF"], "NUM"),
    "ROBJOINT": dict.fromkeys([f"RAX_{n}" for n in range(1, 7)], "NUM"),
    "POSE": {"TRANS": "POS", "ROT": "ORIENT"},
    "ROBTARGET": {
        "TRANS": "POS",
        "ROT": "ORIENT",
        "ROBCONF": "CONFDATA",
        "EXTAX": "EXTJOINT",
    },
    "JOINTTARGET": {"ROBAX": "ROBJOINT", "EXTAX": "EXTJOINT"},
    "SPEEDDATA": dict.fromkeys(("V_TCP", "V_ORI", "V_LEAX", "V_REAX"), "NUM"),
}
_FIRST_VALUES: dict[str, Value] = {"NUM": 0.0, "DNUM": 0.0, "BOOL": False, "STRING": ""}
# A controller wants a quaternion of length 1.
LEAST_QUATERNION = 1e-3


class Records:
    """Records by name in upper case: their components, with the type of each."""

    def __init__(self) -> None:
        self._parts = dict(_RECORDS)

    def define(self, name: str, parts: dict[str, str]) -> None:
        """Define a record of a program."""
        self._parts[name] = parts

    def of(self, kind: str, value: Value) -> Value:
        """Record of a list in brackets, or what a variable of a type keeps of a value.

        Raises:
            ExpressionError: If a list has another number of components.
        """
        parts = self._parts.get(kind)
        if parts is None or not isinstance(value, list):
            return float(value) if type(value) is int and kind == "NUM" else value
        if len(value) != len(parts):
            message = f"a {kind.lower()} has {len(parts)} components, not {len(value)}."
            raise ExpressionError("", message)
        pairs = zip(parts.items(), value, strict=True)
        return {
            name: part if type(part) is float else self.of(inner, part)
            for (name, inner), part in pairs
        }

    def array_of(self, kind: str, sizes: list[float], value: Value) -> Value:
        """Value of a variable, or of an array, of a list in brackets.

        Raises:
            ExpressionError: If a list has another number of components.
        """
        if not sizes:
            return self.of(kind, value)
        if not isinstance(value, list) or len(value) != sizes[0]:
            message = f"needed are {sizes[0]:g} values of {kind.lower()}."
            raise ExpressionError("", message)
        return [self.array_of(kind, sizes[1:], part) for part in value]

    def made(self, kind: str) -> Value:
        """Value of a variable that has none yet."""
        if parts := self._parts.get(kind):
            return {name: self.made(inner) for name, inner in parts.items()}
        return _FIRST_VALUES.get(kind)

    def kind_of(self, kind: str, path: tuple[Expression | str, ...]) -> str:
        """Type of a part of a variable of a type."""
        for step in path:
            if isinstance(step, str):
                kind = self._parts.get(kind, {}).get(step, "")
        return kind


def numbers_of(value: Value) -> list[float]:
    """Numbers of a record in their order.

    Raises:
        ExpressionError: If one of them has no value.
    """
    if isinstance(value, dict):
        return [
            number
            for part in value.values()
            for number in ([part] if type(part) is float else numbers_of(part))
        ]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ExpressionError("", "a component has no value in numbers.")
    return [float(value)]


def _sum(sign: float) -> Callable[[Any, Any], Value]:
    """Sum or difference of two numbers, or of two places."""

    def value(a: Any, b: Any) -> Value:
        if isinstance(a, dict) and isinstance(b, dict):
            return {name: part + sign * b[name] for name, part in a.items()}
        if sign > 0 and isinstance(a, str):
            return a + b
        return a + sign * b

    return value


def _times(a: Any, b: Any) -> Value:
    if isinstance(a, dict):
        a, b = b, a
    return (
        {name: a * part for name, part in b.items()} if isinstance(b, dict) else a * b
    )


def _whole_quotient(a: Any, b: Any) -> Value:
    return int(a / b)


def _remainder(a: Any, b: Any) -> Value:
    return math.fmod(a, b)


def _moved(name: str, values: list[Any], turns: dict[str, Any]) -> Value:
    """Target that Offs moves along the work object, RelTool along the tool."""
    target, *way = values
    target = Records().of("ROBTARGET", target)
    x, y, z, *rot = numbers_of(target)
    R = np.eye(3)
    step = np.array(way, float)
    rot = rot[:4]
    if len(step) != 3 or not isinstance(target, dict):
        raise ExpressionError(name, "needed are a robtarget and 3 numbers.")
    if name == "RELTOOL" and math.hypot(*rot) >= LEAST_QUATERNION:
        R = rotation_of_quaternion(rot[0], rot[1], rot[2], rot[3])
        step = R @ step
        if turns:
            a, b, c = (float(turns.get(f"R{axis}", 0.0)) for axis in "XYZ")
            # About x first, then about the new y and z.
            R = R @ rotation_of_abc(0.0, 0.0, a) @ rotation_of_abc(0.0, b, 0.0)
            rot = list(quaternion_of_rotation(R @ rotation_of_abc(c, 0.0, 0.0)))
    place = np.array([x, y, z]) + step
    turned = dict(zip(_RECORDS["ORIENT"], rot, strict=True))
    return {**target, "TRANS": dict(zip("XYZ", place.tolist(), strict=True))} | {
        "ROT": turned
    }


def _orient(name: str, values: list[Any], turns: dict[str, Any]) -> Value:
    """Orientation of angles about z, y and x [deg]."""
    a, b, c = map(float, values)
    quaternion = quaternion_of_rotation(rotation_of_abc(a, b, c))
    return dict(zip(_RECORDS["ORIENT"], quaternion, strict=True))


def _size(name: str, values: list[Any], turns: dict[str, Any]) -> Value:
    """Length of an array in one of its dimensions."""
    array, dimension = values
    for _ in range(int(dimension) - 1):
        array = array[0]
    return len(array)


_FUNCTIONS = {
    "OFFS": _moved,
    "RELTOOL": _moved,
    "ORIENTZYX": _orient,
    "DIM": _size,
}


def _literal(text: str) -> Value:
    """Array of numbers, or of such arrays."""
    rows = [list(map(float, one.split(","))) for one in _NUMBERS.findall(text)]
    return rows if text[1:].lstrip().startswith("[") else rows[0]


def _operand(parser: Parser) -> Expression | None:
    """Read a list in brackets, or a function whose arguments have names."""
    parts: list[Expression] = []
    if parser.take("["):
        while not parser.take("]"):
            if parts:
                parser.expect(",")
            parts.append(parser.expression())
        return lambda variables: [part(variables) for part in parts]
    if not (parser.kind == "name" and parser.word in _FUNCTIONS):
        return None
    name, named = parser.advance(), dict[str, Expression]()
    parser.expect("(")
    while not parser.take(")"):
        if parser.take("\\"):
            option = parser.advance()
            parser.expect(":=")
            named[option] = parser.expression()
        elif parts and not parser.take(","):
            parser.expect(")")
            break
        elif not (parser.kind == "sign" and parser.word == "\\"):
            parts.append(parser.expression())

    def value(variables: Variables) -> Value:
        turns = {option: one(variables) for option, one in named.items()}
        return _FUNCTIONS[name](name, [one(variables) for one in parts], turns)

    return value


def texts_of_rapid(
    missing: Callable[[Name], Value],
    call: Callable[[str, list[Expression]], Expression],
) -> Texts:
    """Expressions of RAPID, without any variable yet.

    Args:
        missing: Value of a name that has none; it may raise an `ExpressionError`.
        call: Call of a function that the program defines.
    """
    grammar = Grammar(
        token=_TOKEN,
        binary=(
            {"OR": logical(operator.or_), "XOR": logical(operator.xor)},
            {"AND": logical(operator.and_)},
            {"=": operator.eq, "<>": operator.ne, **ORDERS},
            {"+": _sum(1.0), "-": _sum(-1.0)},
            {
                "*": _times,
                "/": operator.truediv,
                "DIV": _whole_quotient,
                "MOD": _remainder,
            },
        ),
        unary={
            "-": (lambda x: _times(-1.0, x), 5),
            "+": (lambda x: x, 5),
            "NOT": (operator.not_, 2),
        },
        functions={
            **FUNCTIONS,
            "ASIN": lambda x: math.degrees(math.asin(x)),
            "ATAN": lambda x: math.degrees(math.atan(x)),
            "POW": math.pow,
            "EXP": math.exp,
            "TRUNC": lambda x: int(x),
            "ROUND": lambda x: math.floor(x + 0.5),
            "NUMTOSTR": lambda x, digits: f"{x:.{min(int(digits), 15)}f}",
            "STRLEN": len,
            "STRPART": lambda text, at, count: text[int(at) - 1 :][: int(count)],
        },
        constants={"TRUE": True, "FALSE": False, "PI": math.pi},
        brackets=("()", "()", "{}"),
        literal=_literal,
        operand=_operand,
        call=call,
    )
    return Texts(Variables(missing), grammar)
