"""`[force]` of a job: a material, or a law with its coefficients."""

import re
import tomllib
from collections.abc import Iterable
from importlib import resources
from typing import TYPE_CHECKING, NamedTuple

from pydantic import Field, StrictStr, field_validator

from ...settings.force import ForceLawSettings, LinearEdgeSettings
from ...settings.tables import TomlTable, read_settings, validated

if TYPE_CHECKING:
    from ...cutter import AbstractCutter
    from ...cutting import AbstractForceLaw


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

    def build(self) -> "AbstractForceLaw":
        """Law of the material."""
        from ...cutting import material

        return material(self.material).law

    def unusual(self) -> Iterable[str]:
        """Coefficients of the material, with their source."""
        from ...cutting import material

        row = material(self.material)
        numbers = ", ".join(
            f"{name} {getattr(row.law, name) / scale:g} {unit}"
            for name in row.law.NAMES
            for scale, unit in [_UNITS[name[-1]]]
        )
        # Where a table was read is of interest to who looks into the library's file.
        source = re.sub(r"; read at \S+( \([^)]*\))?", "", row.source)
        yield f"material {self.material}: {numbers}. {source}"


_ForceTable = MaterialTable | ForceLawSettings


def _law(table: _ForceTable) -> "AbstractForceLaw":
    """Force law of a table."""
    from ...cutting import AbstractForceLaw

    law = table.build()
    assert isinstance(law, AbstractForceLaw)
    return law


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
        """Force laws of side and bottom.

        Tables of materials print the size of the axial coefficients of the side; their
        sign is that of the hand of the helix.

        Args:
            cutter: The cutter.
        """
        import equinox as eqx

        law = _law(self.side)
        for name in self._axial_sizes(cutter):
            size = abs(float(getattr(law, name)))
            signed = -size if float(cutter.helix_angle) > 0 else size
            law = eqx.tree_at(lambda x, name=name: getattr(x, name), law, signed)
        return law, None if self.bottom is None else _law(self.bottom)

    def _axial_sizes(self, cutter: "AbstractCutter") -> tuple[str, ...]:
        """Coefficients of which a material's table prints the size alone."""
        from ...cutting import LinearEdgeLaw

        if not (cutter.has_helix and isinstance(self.side, MaterialTable)):
            return ()
        law = _law(self.side)
        if not isinstance(law, LinearEdgeLaw) or float(cutter.helix_angle) == 0:
            return ()
        # One with a sign was measured on a cutter whose hand it has.
        names = ("K_ac", "K_ae")
        if min(float(getattr(law, name)) for name in names) < 0:
            return ()
        return tuple(name for name in names if float(getattr(law, name)) > 0)

    def notes(self, cutter: "AbstractCutter") -> tuple[str, ...]:
        """Notes on unusual coefficients, and on signs that follow the helix."""
        found = [f"[force] {note}" for note in self.side.unusual()]
        if self.bottom is not None:
            found += [f"[force.bottom] {note}" for note in self.bottom.unusual()]
        names = self._axial_sizes(cutter)
        if not names:
            return tuple(found)
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
        """Faults of coefficients per tooth that are more or fewer than the teeth."""
        for place, table in (("[force]", self.side), ("[force.bottom]", self.bottom)):
            for key, value in {} if table is None else vars(table).items():
                if isinstance(value, list) and len(value) != teeth:
                    problems.append(
                        f"{place} {key}: found {len(value)} values, but one value, or "
                        f"one for each of the {teeth} teeth, is required"
                    )


def read_force(raw: object, problems: list[str]) -> ForceTables | None:
    """Checked table `[force]`, and the table `bottom` within it.

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
    """Checked table of a material, or of the law that it names."""
    found = raw if isinstance(raw, dict) else {}
    if raw == {}:
        problems.append(
            f'{place}: found nothing, but material = "NAME" (a wrong name lists all) '
            'or coefficients are required, such as K_tc = "989.8 N/mm^2", K_rc and K_ac'
        )
        return None
    if "material" in found:
        others = ", ".join(key for key in found if key != "material")
        if others:
            problems.append(
                f"{place} material: found together with {others}; a material, or a "
                "law with its coefficients, is allowed, but not both"
            )
        alone = {"material": found["material"]}
        return validated(MaterialTable, alone, place, problems)
    try:
        law = ForceLawSettings.named(found.get("law", LinearEdgeSettings.name))
    except ValueError as error:
        problems.append(f"{place} law: {error}")
        return None
    stated = raw
    if isinstance(raw, dict):
        stated = {key: value for key, value in raw.items() if key != "law"}
    return read_settings(law, stated, problems, place, ("law", *also))
