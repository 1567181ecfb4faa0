"""`[force]` of a job: a material, or a law with its coefficients."""

import re
import tomllib
from importlib import resources
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, StrictStr, field_validator

from ...settings.fields import (
    PositiveLength,
    ToothEdgeForce,
    ToothExponent,
    ToothPositivePressure,
    ToothPressure,
)
from ...settings.tables import TomlTable, validated

if TYPE_CHECKING:
    from ...cutter import AbstractCutter
    from ...cutting import AbstractForceLaw


# A coefficient so many times the tangential one is none of a metal.
_LARGE = 1.5
# Of a shear and of an edge coefficient, by the last letter of its name.
_UNITS = {"c": (1e6, "N/mm^2"), "e": (1e3, "N/mm")}


class MaterialTable(TomlTable):
    """`[force]` with a material.

    `[force.bottom]`, with a material or a law, holds what `[force]` does of the bottom
    edges; without it that follows from the side.
    """

    material: StrictStr = Field(
        description="name of a material with published coefficients, such as "
        '"aluminium_6082_t6"'
    )

    @field_validator("material")
    @classmethod
    def _known(cls, value: str) -> str:
        # Its law imports JAX, which a name that is known can do without.
        file = resources.files("diffmill").joinpath("cutting", "materials.toml")
        if value not in tomllib.loads(file.read_text(encoding="utf-8")):
            from ...cutting import material

            material(value)
        return value

    def force_law(self) -> "AbstractForceLaw":
        """Return the law of the material."""
        from ...cutting import material

        return material(self.material).law

    def notes(self, place: str) -> tuple[str, ...]:
        """Return what the user should know about the coefficients."""
        from ...cutting import material

        row = material(self.material)
        numbers = ", ".join(
            f"{name} {getattr(row.law, name) / scale:g} {unit}"
            for name in row.law.NAMES
            for scale, unit in [_UNITS[name[-1]]]
        )
        # Where a table was read is of interest to who looks into the library's file.
        source = re.sub(r"; read at \S+( \([^)]*\))?", "", row.source)
        return (f"{place} material {self.material}: {numbers}. {source}",)


class LinearEdgeTable(TomlTable):
    """`[force]` with `law = "linear_edge"`."""

    law: Literal["linear_edge"] = Field(
        default="linear_edge",
        description="force per chip width K_c h + K_e, of the chip thickness h",
    )
    K_tc: ToothPositivePressure = Field(
        description='tangential cutting coefficient, such as "989.8 N/mm^2"'
    )
    K_rc: ToothPressure = Field(
        description='radial cutting coefficient, such as "337.3 N/mm^2"'
    )
    K_ac: ToothPressure = Field(
        description='axial cutting coefficient, such as "66.9 N/mm^2"'
    )
    K_te: ToothEdgeForce = Field(
        default=0.0, description='tangential edge coefficient, such as "3.0 N/mm"'
    )
    K_re: ToothEdgeForce = Field(
        default=0.0, description='radial edge coefficient, such as "3.0 N/mm"'
    )
    K_ae: ToothEdgeForce = Field(
        default=0.0, description='axial edge coefficient, such as "3.0 N/mm"'
    )

    def force_law(self) -> "AbstractForceLaw":
        """Return the law."""
        from ...cutting import LinearEdgeLaw

        return LinearEdgeLaw(**_arrays(self))

    def notes(self, place: str) -> tuple[str, ...]:
        """Return that a coefficient is large beside the tangential one."""
        return _interchanged(place, self, ("K_tc", "K_rc", "K_ac"))


class KienzleTable(TomlTable):
    """`[force]` with `law = "kienzle"`."""

    law: Literal["kienzle"] = Field(
        description="force per chip width K_c11 (h / h_1)^-m h + K_e, of the chip "
        "thickness h"
    )
    K_tc11: ToothPositivePressure = Field(
        description="tangential cutting coefficient at the reference thickness h_1 "
        '(k_c1.1), such as "1500 N/mm^2"'
    )
    K_rc11: ToothPressure = Field(
        description='radial cutting coefficient at h_1, such as "500 N/mm^2"'
    )
    K_ac11: ToothPressure = Field(
        description='axial cutting coefficient at h_1, such as "0 N/mm^2"'
    )
    m_t: ToothExponent = Field(
        description="exponent of the tangential coefficient (m_c), a number from 0 to "
        "below 1, such as 0.25"
    )
    m_r: ToothExponent | None = Field(
        default=None, description="exponent of the radial coefficient; m_t if left out"
    )
    m_a: ToothExponent | None = Field(
        default=None, description="exponent of the axial coefficient; m_t if left out"
    )
    K_te: ToothEdgeForce = Field(
        default=0.0, description='tangential edge coefficient, such as "3.0 N/mm"'
    )
    K_re: ToothEdgeForce = Field(
        default=0.0, description='radial edge coefficient, such as "3.0 N/mm"'
    )
    K_ae: ToothEdgeForce = Field(
        default=0.0, description='axial edge coefficient, such as "3.0 N/mm"'
    )
    reference_thickness: PositiveLength = Field(
        default=1e-3,
        description="chip thickness h_1 at which K_tc11, K_rc11 and K_ac11 hold",
    )
    least_thickness: PositiveLength = Field(
        default=1e-6,
        description="chip thickness below which a cutting coefficient follows its "
        "tangent",
    )

    def force_law(self) -> "AbstractForceLaw":
        """Return the law; exponents that are left out are the tangential one."""
        from ...cutting import KienzleLaw

        values = _arrays(self)
        return KienzleLaw(**{"m_r": values["m_t"], "m_a": values["m_t"]} | values)

    def notes(self, place: str) -> tuple[str, ...]:
        """Return that a coefficient is large beside the tangential one."""
        return _interchanged(place, self, ("K_tc11", "K_rc11", "K_ac11"))


def _interchanged(
    place: str, table: TomlTable, names: tuple[str, ...]
) -> tuple[str, ...]:
    """Return which coefficients are larger than the first of them by far."""
    sizes = {n: np.max(np.abs(np.asarray(getattr(table, n)))) for n in names}
    first, *others = names
    return tuple(
        f"{place} {name}: {sizes[name] / sizes[first]:.3g} times {first}; less than "
        "that is usual: are they interchanged?"
        for name in others
        if sizes[name] > _LARGE * sizes[first]
    )


_NAMES = ("K_tc", "K_rc", "K_ac", "K_te", "K_re", "K_ae")
_LAWS = {"linear_edge": LinearEdgeTable, "kienzle": KienzleTable}
_ForceTable = MaterialTable | LinearEdgeTable | KienzleTable


class ForceTables(NamedTuple):
    """`[force]` and `[force.bottom]`, each checked on its own.

    Attributes:
        side: Coefficients of the side of the cutter.
        bottom: Coefficients of the bottom edges, None if they follow from the side.
    """

    side: _ForceTable
    bottom: _ForceTable | None

    def laws(
        self, cutter: "AbstractCutter"
    ) -> "tuple[AbstractForceLaw, AbstractForceLaw | None]":
        """Return the laws of side and bottom.

        Tables of materials print the size of the axial coefficients of the side; their
        sign is that of the hand of the helix.

        Args:
            cutter: The cutter.
        """
        import equinox as eqx

        law = self.side.force_law()
        for name in self._axial_sizes(cutter):
            size = abs(float(getattr(law, name)))
            signed = -size if float(cutter.helix_angle) > 0 else size
            law = eqx.tree_at(lambda x, name=name: getattr(x, name), law, signed)
        return law, None if self.bottom is None else self.bottom.force_law()

    def _axial_sizes(self, cutter: "AbstractCutter") -> tuple[str, ...]:
        """Return the coefficients of which a table prints the size alone."""
        from ...cutting import LinearEdgeLaw

        if not (cutter.has_helix and isinstance(self.side, MaterialTable)):
            return ()
        law = self.side.force_law()
        if not isinstance(law, LinearEdgeLaw) or float(cutter.helix_angle) == 0:
            return ()
        # One with a sign was measured on a cutter whose hand it has.
        names = ("K_ac", "K_ae")
        if min(float(getattr(law, name)) for name in names) < 0:
            return ()
        return tuple(name for name in names if float(getattr(law, name)) > 0)

    def notes(self, cutter: "AbstractCutter") -> tuple[str, ...]:
        """Return what the user should know about the coefficients."""
        bottom = () if self.bottom is None else self.bottom.notes("[force.bottom]")
        found = self.side.notes("[force]") + bottom
        names = self._axial_sizes(cutter)
        if not names:
            return found
        law, _ = self.laws(cutter)
        numbers = [
            f"{name} = {float(getattr(law, name)) / scale:.4g} {unit}"
            for name in names
            for scale, unit in [_UNITS[name[-1]]]
        ]
        is_right = float(cutter.helix_angle) > 0
        hand, way = ("right", "the work") if is_right else ("left", "the shank")
        return (
            *found,
            "[force] material: tables print the size of axial coefficients; a "
            f"{hand}-hand helix pulls the tool toward {way}, so that "
            f"{', '.join(numbers)} are taken; where signs were measured, give the law "
            "itself",
        )

    def check_teeth(self, teeth: int, problems: list[str]) -> None:
        """Note coefficients per tooth that are more or fewer than the teeth."""
        for place, table in (("[force]", self.side), ("[force.bottom]", self.bottom)):
            for key, value in {} if table is None else table:
                if isinstance(value, list) and len(value) != teeth:
                    problems.append(
                        f"{place} {key}: found {len(value)} values, but one value, or "
                        f"one for each of the {teeth} teeth, is required"
                    )


def read_force(raw: object, problems: list[str]) -> ForceTables | None:
    """Check `[force]` and the table `bottom` within it.

    Args:
        raw: What the file holds.
        problems: Receives a line for everything that is wrong.

    Returns:
        The tables, or None if there is a fault.
    """
    count = len(problems)
    inner = raw.get("bottom") if isinstance(raw, dict) else None
    if isinstance(raw, dict):
        raw = {key: value for key, value in raw.items() if key != "bottom"}
    side = _read_one(raw, "[force]", problems, ("material", "bottom"))
    bottom = None
    if inner is not None:
        bottom = _read_one(inner, "[force.bottom]", problems, ("material",))
    if side is None or len(problems) > count:
        return None
    return ForceTables(side, bottom)


def _read_one(
    raw: object, place: str, problems: list[str], also: tuple[str, ...]
) -> _ForceTable | None:
    """Return one checked table; what it holds says which kind it is."""
    found = raw if isinstance(raw, dict) else {}
    if "material" in found:
        others = ", ".join(key for key in found if key != "material")
        if others:
            problems.append(
                f"{place} material: found together with {others}; a material, or a "
                "law with its coefficients, is allowed, but not both"
            )
        alone = {"material": found["material"]}
        return validated(MaterialTable, alone, place, problems)
    law = found.get("law", "linear_edge")
    if law not in [*_LAWS]:
        allowed = " or ".join(repr(name) for name in _LAWS)
        problems.append(f"{place} law: found {law!r}; allowed: {allowed}")
        return None
    return validated(_LAWS[law], raw, place, problems, also)


def _arrays(table: TomlTable) -> dict[str, Any]:
    """Return the coefficients that are given, lists as arrays."""
    return {
        key: np.asarray(value) if isinstance(value, list) else value
        for key, value in table
        if key != "law" and value is not None
    }
