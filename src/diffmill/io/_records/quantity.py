"""Quantities that a table may have, and what their columns are called."""

import re
from typing import NamedTuple

from ...units import ANGLE, FORCE, TIME, QuantityKind

# What may stand between a word and the letter of an axis.
_PARTS = r"[\s_.\-]*"


class Quantity(NamedTuple):
    """A quantity that a table may have a column of.

    Attributes:
        key: Its name, as in `channels`.
        pattern: Regular expression of a column's whole name, whatever its case.
        kinds: Dimensions that it may have; none takes the numbers as they are.
        units: Keys of `units` under which its unit may stand, the first one counts.
        loose: Regular expression to be found within a name if none fits as a whole.
    """

    key: str
    pattern: str
    kinds: tuple[QuantityKind, ...] = ()
    units: tuple[str, ...] = ()
    loose: str = ""

    @classmethod
    def vector(
        cls, letter: str, words: str, kind: QuantityKind, unit: str | None = None
    ) -> "tuple[Quantity, ...]":
        """Return the three quantities of a vector, such as Fx, Fy, Fz.

        Args:
            letter: Before x, y and z in their keys.
            words: Regular expression of what may stand before or after an axis.
            kind: Their dimension.
            unit: Key of `units` for all three.
        """
        units = () if unit is None else (unit,)
        return tuple(
            cls(
                f"{letter}{a}",
                rf"({words}){_PARTS}{a}|{a}{_PARTS}({words})",
                (kind,),
                units,
            )
            for a in "xyz"
        )


# LabVIEW writes the device before the name: `Dev1/Time`.
TIME_COLUMN = Quantity(
    "time",
    r"([^/\\]+[/\\])?(t|time|zeit|x_?value|time ?stamp|"
    r"(abs\w*|rel\w*|elapsed)[ _]?time|temps|seconds|sekunden)",
    (TIME,),
    ("time",),
)
# Names that leave no doubt, and names that hold the force's as a word:
# `Dyno Fx filtered`, `Ch1_Fx`.
FORCES = tuple(
    q._replace(units=(q.key, "force"), loose=rf"(?<![a-z])f[ _]?{q.key[1]}(?![a-z])")
    for q in Quantity.vector("F", "f|force|kraft", FORCE)
)
OTHERS = (
    TIME_COLUMN,
    Quantity("tacho", r"tacho\w*|trigger|pulses?|key ?phasor|once per rev\w*"),
    Quantity(
        "angle",
        r"((spindle|tool|rotation|encoder|spindel|dreh)[ _]?)?(angle|winkel)",
        (ANGLE,),
        ("angle",),
    ),
)


def has_quantity_names(names: list[str]) -> bool:
    """True if one of the names is that of a quantity of a record."""
    return any(
        re.fullmatch(q.pattern, name, re.IGNORECASE)
        or (q.loose and re.search(q.loose, name, re.IGNORECASE))
        for q in (*FORCES, *OTHERS)
        for name in names
    )
