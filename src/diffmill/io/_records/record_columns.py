"""Quantities of a record of forces, and what their columns are called."""

import re

from ...units import ANGLE, FORCE
from .quantity import TIME_COLUMN, Quantity

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
    """Return whether one of the names is that of a quantity of a record."""
    return any(
        re.fullmatch(q.pattern, name, re.IGNORECASE)
        or (q.loose and re.search(q.loose, name, re.IGNORECASE))
        for q in (*FORCES, *OTHERS)
        for name in names
    )
