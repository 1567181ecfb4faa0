"""Numbers that a program writes as sums and products, and lists of arguments."""

import ast
import math
import operator
import re
from collections.abc import Mapping

from .limits import LARGEST_NUMBER

_OPERATORS = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_LONGEST_TEXT = 200
# A number as robot programs write it.
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
# Controllers read 05 as 5, Python refuses it.
_ZEROS = re.compile(r"(?<![\w.])0+(?=\d)")


def value_of(
    text: str, known: Mapping[str, float], *, truncates: bool = False
) -> float:
    """Return the value of numbers and names with + - * / and parentheses.

    Args:
        text: Such as "V1 / 60".
        known: Values by name in upper case.
        truncates: Whether the controller makes a whole number of a quotient of two;
            such a quotient has no value here.

    Returns:
        The value; NaN where a name is not known, it is too large, or anything else is
        found.
    """
    if len(text) > _LONGEST_TEXT:
        return math.nan
    try:
        plain = _ZEROS.sub("", text.strip().upper())
        body = ast.parse(plain, mode="eval").body
        value = float(_value(body, known, truncates))
    except (SyntaxError, ValueError, ArithmeticError):
        return math.nan
    return value if abs(value) <= LARGEST_NUMBER else math.nan


def _value(node: ast.expr, known: Mapping[str, float], truncates: bool) -> int | float:
    """Return the value of a part, a whole number as such."""
    match node:
        case ast.Constant(int() | float() as value) if not isinstance(value, bool):
            return value
        case ast.Name() | ast.Subscript():
            return known.get(ast.unparse(node), math.nan)
        case ast.UnaryOp(ast.USub(), operand):
            return -_value(operand, known, truncates)
        case ast.UnaryOp(ast.UAdd(), operand):
            return _value(operand, known, truncates)
        case ast.BinOp(left, sign, right) if type(sign) in _OPERATORS:
            pair = _value(left, known, truncates), _value(right, known, truncates)
            if truncates and isinstance(sign, ast.Div):
                if all(isinstance(one, int) for one in pair):
                    return math.nan
            return _OPERATORS[type(sign)](*pair)
    return math.nan


def split_arguments(text: str) -> list[str]:
    """Return arguments that are separated by commas outside of brackets."""
    out, depth, begun = [], 0, 0
    for index, letter in enumerate(text):
        depth += (letter in "[({") - (letter in "])}")
        if letter == "," and depth == 0:
            out.append(text[begun:index].strip())
            begun = index + 1
    return [*out, text[begun:].strip()]
