"""Expressions of a robot's program as text, each read once."""

import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

from ..expressions import (
    Expression,
    ExpressionError,
    Grammar,
    Parser,
    Value,
    Variable,
    Variables,
    evaluated,
)
from ..limits import LARGEST_NUMBER, MOST_VALUES

# A number of a literal: no text is one in two ways, so that a long one is read once.
NUMBER = r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:E[+-]?[0-9]+)?"
_Binary = Callable[[Any, Any], Value]
ORDERS: Mapping[str, _Binary] = {
    "<>": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
}


def logical(action: Callable[[bool, bool], bool]) -> _Binary:
    """Operator between two truth values, and between nothing else."""

    def value(a: Value, b: Value) -> Value:
        if isinstance(a, bool) and isinstance(b, bool):
            return action(a, b)
        raise TypeError

    return value


def _of_degrees(action: Callable[[float], float]) -> Callable[[Any], Value]:
    return lambda x: action(math.radians(x))


# Angles are in degrees, as on the controllers.
FUNCTIONS: Mapping[str, Callable[..., Value]] = {
    "ABS": lambda x: -x if x < 0 else x,
    "SQRT": math.sqrt,
    "SIN": _of_degrees(math.sin),
    "COS": _of_degrees(math.cos),
    "TAN": _of_degrees(math.tan),
    "ACOS": lambda x: math.degrees(math.acos(x)),
    "ATAN2": lambda y, x: math.degrees(math.atan2(y, x)),
}


class Texts:
    """Texts of expressions, with the grammar and the variables that give them values.

    Attributes:
        variables: The values.
    """

    def __init__(self, variables: Variables, grammar: Grammar) -> None:
        self.variables, self._grammar = variables, grammar
        self._parsed: dict[str, Expression | None] = {}

    def expression(self, text: str) -> Expression:
        """Expression of a text; what is wrong with it is told when it is evaluated."""
        return lambda variables: self._read(text)(variables)

    def _read(self, text: str) -> Expression:
        known = self._parsed.get(text)
        if known is None:
            parser = Parser(text, self._grammar)
            known = parser.expression()
            parser.finish()
            # Those of loops are kept as read; all would fill the memory.
            if len(self._parsed) < MOST_VALUES:
                self._parsed[text] = known if text in self._parsed else None
        return known

    def split(self, text: str) -> tuple[str, str]:
        """Split a text into the expression at its begin and what follows.

        Raises:
            ExpressionError: If it begins with none.
        """
        parser = Parser(text, self._grammar)
        parser.expression()
        return text[: parser.at], text[parser.at :].strip()

    def place(self, text: str) -> Variable:
        """Place in which a value is kept.

        Raises:
            ExpressionError: If it is none.
        """
        parser = Parser(text, self._grammar)
        place = parser.variable()
        parser.finish()
        return place

    def value(self, text: str) -> Value:
        """Value of an expression.

        Raises:
            ExpressionError: If it has none.
        """
        return evaluated(self._read(text), self.variables)

    def number(self, text: str) -> float:
        """Value of an expression that is a number; NaN if it has none, or too large."""
        try:
            value = self.value(text)
        except ExpressionError:
            return math.nan
        if isinstance(value, bool) or not isinstance(value, int | float):
            return math.nan
        return float(value) if abs(value) <= LARGEST_NUMBER else math.nan
