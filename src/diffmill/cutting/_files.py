"""Read the table of materials: the only module of this subpackage that reads a file."""

import functools
import tomllib
from importlib import resources
from types import MappingProxyType
from typing import Any

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


def materials() -> tuple[str, ...]:
    """Return the names of the materials with published coefficients, sorted.

    Returns:
        Names that `material` and `[force] material` of a job take.

    Differentiability: not applicable, a host function.
    """
    return tuple(sorted(_table()))


def material(name: str) -> LinearEdgeLaw:
    """Return the force law of a material, with published coefficients.

    Coefficients belong to the cutter and conditions of their source, which
    `material_source` tells. Axial coefficients that a source lacks are zero.

    Args:
        name: One of `materials()`.

    Returns:
        The law with Python floats as coefficients [Pa, N/m].

    Raises:
        ValueError: If there is no such material; the message lists the names.

    Differentiability: not applicable, a host function; differentiate by the law's
    coefficients.
    """
    row = _row(name)
    return LinearEdgeLaw(
        **{
            coefficient: row.get(key, 0.0) * factor
            for coefficient, (key, factor) in _UNITS.items()
        }
    )


def material_source(name: str) -> str:
    """Return where a material's coefficients come from and what they lack.

    Args:
        name: One of `materials()`.

    Returns:
        One line: source, cutter, conditions, and which coefficients are missing.

    Raises:
        ValueError: If there is no such material; the message lists the names.

    Differentiability: not applicable, a host function.
    """
    row = _row(name)
    line = f"{row['source']}; cutter: {row['cutter']}; conditions: {row['conditions']}"
    return f"{line}; no {row['lacks']}: these are zero" if "lacks" in row else line


def material_classes() -> dict[str, tuple[float, float]]:
    """Return the least and the greatest published K_tc of each class of materials.

    Returns:
        K_tc [Pa] by class, as "aluminium" or "steel".

    Differentiability: not applicable, a host function.
    """
    pressures: dict[str, list[float]] = {}
    for name in materials():
        of_class = pressures.setdefault(_row(name)["class"], [])
        of_class.append(float(material(name).K_tc))
    return {name: (min(found), max(found)) for name, found in pressures.items()}


def _row(name: str) -> dict[str, Any]:
    if name not in _table():
        raise ValueError(
            f"found the unknown material {name!r}; allowed: {', '.join(materials())}"
        )
    return _table()[name]


@functools.cache
def _table() -> dict[str, Any]:
    file = resources.files("diffmill.cutting").joinpath("materials.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))
