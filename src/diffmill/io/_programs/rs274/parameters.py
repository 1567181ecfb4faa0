"""Parameters and expressions of G-code: as LinuxCNC has them, or macros of Fanuc.

The two agree but in what is told here: values that nothing has set, comparison of
nearly equal numbers, rounding of negative ones, and the operators AND and MOD.
"""

import functools
import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass

from ..control import Machine
from ..expressions import (
    Expression,
    ExpressionError,
    Grammar,
    Name,
    Parser,
    Value,
    Variable,
    Variables,
)
from .state import AXES, State

# Without blanks, only a list tells where a word ends, as in 1ANDABS[#2].
_WORDS = (
    "EXISTS ROUND ATAN ASIN ACOS SQRT AND XOR MOD SIN COS TAN ABS EXP FIX FUP SQR POW "
    "OR LN EQ NE GT GE LT LE"
)
_TOKEN = re.compile(
    r"(?:(?P<number>[0-9]+\.?[0-9]*|\.[0-9]+)"
    rf"|(?P<name>{'|'.join(_WORDS.split())}|<[^<>]*>)"
    r"|(?P<sign>\*\*|[-+*/\[\],#=]))"
)
# LinuxCNC, interp_internal.hh: nearer numbers are equal.
_EQUAL = 1e-4
# Numbers of own parameters of a call, and of those that a program may use freely.
_OWN = {"linuxcnc": 30, "fanuc": 33}
_FREE = {"linuxcnc": range(1, 5001), "fanuc": range(1, 1000)}
_NUMBERS = range(1, 5603)
# Switches and messages: none changes a path.
_QUIET = {"linuxcnc": {5599}, "fanuc": {3001, 3002, 3003, 3004, 3006}}


def _number(value: Value) -> float:
    """Number of a value; nothing counts as 0."""
    return float(value) if isinstance(value, int | float) else 0.0


def _plain(action: Callable[[float, float], float]) -> Callable[[Value, Value], Value]:
    return lambda a, b: float(action(_number(a), _number(b)))


def _whole(action: Callable[[int, int], int]) -> Callable[[Value, Value], Value]:
    return lambda a, b: float(action(round(_number(a)), round(_number(b))))


def _is_equal(a: Value, b: Value) -> bool:
    """Fanuc's comparison: nothing equals nothing alone."""
    return a == b if None in (a, b) else _number(a) == _number(b)


def _degrees(action: Callable[[float], float]) -> Callable[[Value], Value]:
    return lambda angle: action(math.radians(_number(angle)))


def _angle(action: Callable[[float], float]) -> Callable[[Value], Value]:
    return lambda value: math.degrees(action(_number(value)))


def _rounded(value: float) -> float:
    """The nearest whole number; half goes away from zero."""
    return math.copysign(math.floor(abs(value) + 0.5), value)


def _operand(parser: Parser) -> Expression | None:
    """Read a parameter, an arc tangent, or a number with a plus before it."""
    if parser.take("#"):
        return variable_of(parser).get
    if parser.take("+"):
        return parser.operand()
    if parser.take(("EXISTS",)):
        parser.expect("[")
        parser.expect("#")
        name = variable_of(parser).name
        parser.expect("]")
        # Every parameter with a number that there is has a value.
        return lambda variables: float(
            name(variables) in variables or name(variables) in _NUMBERS
        )
    if not parser.take(("ATAN",)):
        return None
    first, *second = parser.arguments()
    if parser.take("/"):
        second = parser.arguments()
    if len(second) != 1:
        raise ExpressionError("ATAN", "needed is ATAN[a]/[b].")

    def angle(variables: Variables) -> Value:
        y, x = _number(first(variables)), _number(second[0](variables))
        return math.degrees(math.atan2(y, x))

    return angle


def variable_of(parser: Parser) -> Variable:
    """Read the parameter behind a #."""
    if parser.kind == "name":
        word = parser.advance()
        if not word.startswith("<"):
            raise ExpressionError(f"#{word}", "a parameter is #1, #<name> or #[..].")
        return Variable(lambda variables: word)
    number = parser.operand()

    def name(variables: Variables) -> Name:
        value = _number(number(variables))
        if abs(value - round(value)) > _EQUAL:
            raise ExpressionError(f"#{value:g}", "its number is not whole.")
        return round(value)

    return Variable(name)


_COMPARED = {
    "GT": _plain(operator.gt),
    "GE": _plain(operator.ge),
    "LT": _plain(operator.lt),
    "LE": _plain(operator.le),
}
_SUMS = {"+": _plain(operator.add), "-": _plain(operator.sub)}
_PRODUCTS = {"*": _plain(operator.mul), "/": _plain(operator.truediv)}
_FUNCTIONS: dict[str, Callable[..., Value]] = {
    "SIN": _degrees(math.sin),
    "COS": _degrees(math.cos),
    "TAN": _degrees(math.tan),
    "ASIN": _angle(math.asin),
    "ACOS": _angle(math.acos),
    "SQRT": lambda a: math.sqrt(_number(a)),
    "EXP": lambda a: math.exp(_number(a)),
    "LN": lambda a: math.log(_number(a)),
    "ABS": lambda a: abs(_number(a)),
    "ROUND": lambda a: _rounded(_number(a)),
    "FIX": lambda a: float(math.floor(_number(a))),
    "FUP": lambda a: float(math.ceil(_number(a))),
}
_GRAMMAR = functools.partial(
    Grammar, token=_TOKEN, brackets=("[]", "[]", ""), operand=_operand
)


def _is_true(value: Value) -> bool:
    return _number(value) != 0


LINUXCNC = _GRAMMAR(
    binary=(
        {
            "AND": lambda a, b: float(_is_true(a) and _is_true(b)),
            "OR": lambda a, b: float(_is_true(a) or _is_true(b)),
            "XOR": lambda a, b: float(_is_true(a) != _is_true(b)),
        },
        _COMPARED
        | {
            "EQ": _plain(lambda a, b: abs(a - b) < _EQUAL),
            "NE": _plain(lambda a, b: abs(a - b) >= _EQUAL),
        },
        _SUMS,
        _PRODUCTS | {"MOD": _plain(lambda a, b: a % abs(b))},
        {"**": _plain(math.pow)},
    ),
    unary={"-": (lambda a: -_number(a), 5)},
    functions=_FUNCTIONS,
)
FANUC = _GRAMMAR(
    binary=(
        _COMPARED
        | {
            "EQ": lambda a, b: float(_is_equal(a, b)),
            "NE": lambda a, b: float(not _is_equal(a, b)),
        },
        _SUMS | {"OR": _whole(operator.or_), "XOR": _whole(operator.xor)},
        _PRODUCTS | {"AND": _whole(operator.and_), "MOD": _plain(math.fmod)},
    ),
    unary={"-": (lambda a: -_number(a), 3)},
    functions=_FUNCTIONS
    | {
        "FIX": lambda a: float(math.trunc(_number(a))),
        "FUP": lambda a: math.copysign(math.ceil(abs(_number(a))), _number(a)),
        "SQR": _FUNCTIONS["SQRT"],
        "POW": lambda a, b: math.pow(_number(a), _number(b)),
    },
)


@dataclass
class Parameters:
    """Parameters of a program at work, with those that tell the state of the machine.

    Attributes:
        dialect: "linuxcnc" or "fanuc".
        state: State between two blocks.
        machine: The program's run; None before it begins.
        variables: The values.
    """

    dialect: str
    state: State

    def __post_init__(self) -> None:
        self.machine: Machine | None = None
        own = _OWN[self.dialect]
        self.variables = Variables(
            self._missing,
            lambda name: name <= own if isinstance(name, int) else name[1] != "_",
        )
        self.variables.shared |= {"<_VALUE>": 0.0, "<_VALUE_RETURNED>": 0.0}

    @property
    def line(self) -> int:
        """Line at work."""
        return 0 if self.machine is None else self.machine.line

    @property
    def grammar(self) -> Grammar:
        """Grammar of the expressions of a dialect."""
        return FANUC if self.dialect == "fanuc" else LINUXCNC

    def set(self, name: Name, value: Value) -> None:
        """Assign a value to a parameter."""
        state, word = self.state, _text(name)
        if name == 3000 and self.dialect == "fanuc":
            raise ExpressionError(word, "the program raises an alarm here.")
        if name in _QUIET[self.dialect]:
            state.out.note(word, "changes no path", self.line)
        elif isinstance(name, int) and name not in _FREE[self.dialect]:
            message = "this parameter belongs to the control, and is not set here."
            raise ExpressionError(word, message)
        elif isinstance(name, str) and name in self._known():
            raise ExpressionError(word, "this parameter belongs to the control.")
        else:
            self.variables.set(name, value)

    def _missing(self, name: Name) -> Value:
        """Value of a parameter that nothing has set."""
        if self.dialect == "fanuc" and (name == 0 or name in _FREE["fanuc"]):
            return None
        if name in _FREE["linuxcnc"] and self.dialect == "linuxcnc":
            if not isinstance(name, int) or name > _OWN["linuxcnc"]:
                sentence = "has no value in the program, and is 0"
                self.state.out.note(_text(name), sentence, self.line)
            return 0.0
        if isinstance(name, str) and (value := self._known().get(name)) is not None:
            return value()
        if self.dialect == "linuxcnc" and name in (5420, 5421, 5422):
            return self._place(int(name) - 5420)
        if name == 5400 and self.dialect == "linuxcnc":
            return float(self.state.out.tool or 0)
        if name == 5410 and self.dialect == "linuxcnc" and self.state.out.tool:
            radius = self.state.setup.tool_radii.get(self.state.out.tool)
            if radius is not None:
                return 2e3 * radius / self.state.scale
        message = "no line before sets this parameter."
        if isinstance(name, int):
            message = "the value of a parameter of the control is not known here."
        raise ExpressionError(_text(name), message)

    def _known(self) -> dict[str, Callable[[], float]]:
        """Parameters with names that tell the state of the machine."""
        state = self.state
        return {
            "<_X>": lambda: self._place(0),
            "<_Y>": lambda: self._place(1),
            "<_Z>": lambda: self._place(2),
            "<_FEED>": lambda: (state.feed or 0.0) * 60 / state.scale,
            "<_RPM>": lambda: state.spindle_rpm,
            "<_METRIC>": lambda: float(state.scale == 1),
            "<_IMPERIAL>": lambda: float(state.scale != 1),
            "<_ABSOLUTE>": lambda: float(not state.is_incremental),
            "<_INCREMENTAL>": lambda: float(state.is_incremental),
            "<_PLANE>": lambda: (190.0, 180.0, 170.0)[state.plane],
            "<_CURRENT_TOOL>": lambda: float(state.out.tool or 0),
            "<_SELECTED_TOOL>": lambda: float(state.selected_tool or 0),
            "<_CALL_LEVEL>": lambda: float(len(self.variables.calls) - 1),
            "<_LINE>": lambda: float(self.line),
            "<_VMAJOR>": lambda: 2.9,
            "<_VMINOR>": lambda: 0.0,
            "<_TASK>": lambda: 1.0,
        }

    def _place(self, axis: int) -> float:
        """Place of the tool along an axis, in the program's system and units."""
        state = self.state
        if AXES[axis] in state.unknown or state.shift is None or not state.out.moves:
            message = f"where the tool is in {AXES[axis]} is not known here."
            raise ExpressionError("", message)
        return (state.position[axis] - state.shift[axis]) / state.scale


def _text(name: Name) -> str:
    return f"#{name}"
