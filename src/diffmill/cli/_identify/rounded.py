"""A number and its standard error as text."""

import math
from typing import NamedTuple

# Digits of a standard error; digits of a value at most; of one without an error.
_OF_ERROR, _MOST, _UNKNOWN = 2, 6, 4
# Whole numbers of more digits, and decimals beyond these, take an exponent.
_WHOLE, _DECIMALS = 8, 8


class Rounded(NamedTuple):
    """A number and its standard error as text, with the same last digit.

    Attributes:
        value: The number.
        error: Its standard error; "unknown" if that is not finite.
    """

    value: str
    error: str

    @classmethod
    def of(cls, value: float, error: float) -> "Rounded":
        """Round a number to two digits of its standard error, to six at most.

        Args:
            value: The number, finite.
            error: Its standard error; not finite if it is not known, which leaves the
                number four digits.
        """
        size = _exponent(value) + 1
        if not math.isfinite(error):
            return cls(_fixed(value, size - _UNKNOWN), "unknown")
        last = size - _MOST
        if not error > 0:
            return cls(_fixed(value, last), "0")
        own = _exponent(error, _OF_ERROR) + 1 - _OF_ERROR
        return cls(_fixed(value, max(last, own)), _fixed(error, own))


def _exponent(value: float, digits: int = _MOST) -> int:
    """Power of ten of the first digit once rounded; 0 for zero."""
    return int(f"{abs(value):.{digits - 1}e}".partition("e")[2]) if value else 0


def _fixed(value: float, last: int) -> str:
    """Text of a number down to the digit of 10 ** last."""
    number = round(value, -last) + 0.0
    if last > 0 and abs(number) >= 10**_WHOLE:
        return f"{number:.{max(_exponent(number) - last, 0)}e}"
    if -last > _DECIMALS:
        return f"{number:.{max(_exponent(number) - last, 0)}e}"
    return f"{number:.{max(-last, 0)}f}"
