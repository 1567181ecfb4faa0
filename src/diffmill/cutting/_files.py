"""Table of materials: the only module of this subpackage that reads a file."""

import functools
import tomllib
from collections.abc import Mapping
from importlib import resources
from types import MappingProxyType
from typing import Any, NamedTuple

from ._linear_edge import LinearEdgeLaw

# Key in the file and factor to SI for each coefficient.
_UNITS = MappingProxyType(
    {
        "K_tc": ("K_tc_MPa", 1e6),
        "K_rc": ("K_rc_MPa", 1e6),
        "K_ac": ("K_ac_MPa", 1e6),
        "K_te": ("K_te_N_per_mm", 1e3),
        "K_re": ("K_re_N_per_mm", 1e3),
        "K_ae": ("K_ae_N_per_mm", 1e3),
    }
)


class Material(NamedTuple):
    """A material with published coefficients.

    They belong to the cutter and conditions of their source. Axial coefficients that a
    source lacks are zero.

    Attributes:
        law: The force law with Python floats as coefficients [Pa, N/m].
        source: Their source, cutter and conditions, and the missing coefficients.
        kind: Class of materials, as "aluminium" or "steel".
    """

    law: LinearEdgeLaw
    source: str
    kind: str


def material(name: str) -> Material:
    """Material with published coefficients.

    Args:
        name: One of `materials()`.

    Raises:
        ValueError: If there is no such material; the message lists the names.
    """
    if name not in materials():
        raise ValueError(
            f"found the unknown material {name!r}; allowed: {', '.join(materials())}"
        )
    return materials()[name]


@functools.cache
def materials() -> Mapping[str, Material]:
    """Materials that `[force] material` of a job takes, by name, sorted."""
    file = resources.files("diffmill.cutting").joinpath("materials.toml")
    table: dict[str, Any] = tomllib.loads(file.read_text(encoding="utf-8"))
    result = {}
    for name, row in sorted(table.items()):
        source = f"{row['source']}; cutter: {row['cutter']}; conditions: "
        source += row["conditions"]
        if "lacks" in row:
            source += f"; no {row['lacks']}: these are zero"
        values = {
            symbol: row.get(key, 0.0) * factor
            for symbol, (key, factor) in _UNITS.items()
        }
        result[name] = Material(LinearEdgeLaw(**values), source, row["class"])
    return MappingProxyType(result)
