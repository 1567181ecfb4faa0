"""What a robot file may contain, from parsed tables to elements.

All faults of a file are collected and reported together.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ._elements import (
    AbstractElement,
    FixedRotation,
    FixedTranslation,
    Fork,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    Tool,
    inertia_fault,
)
from ._rotations import rpy_matrix

_JOINT_UNITS = {
    "revolute": ("rad", "N*m/rad", "N*m*s/rad"),
    "prismatic": ("m", "N/m", "N*s/m"),
}
_COMMON_KEYS = {"kind", "source"}


class RobotFileError(ValueError):
    """Raise when a robot file is faulty; the message lists every fault."""


@dataclasses.dataclass
class _Reader:
    """A table being read: gives checked values and notes the faults."""

    table: Mapping[str, object]
    place: str
    faults: list[str]
    known: set[str] = dataclasses.field(default_factory=lambda: set(_COMMON_KEYS))

    def fault(self, key: str, allowed: str, found: object) -> None:
        """Note that a key's value is not what is allowed."""
        self.faults.append(f"{self.place}.{key}: must be {allowed}, but is {found!r}")

    def take(self, key: str, default: object = None, *, required: bool = False) -> Any:
        """Return the raw value of a key and mark it as known."""
        self.known.add(key)
        if key in self.table:
            return self.table[key]
        if required:
            self.faults.append(f"{self.place}.{key}: is missing")
        return default

    def quantity(
        self,
        key: str,
        unit: str,
        default: float = math.nan,
        *,
        required: bool = False,
        is_allowed: Callable[[float], bool] = math.isfinite,
        allowed: str = "finite",
    ) -> float:
        """Return a quantity in SI, the default where the key is absent."""
        raw = self.take(key, required=required)
        if raw is None:
            return default
        value = _convert(raw, unit)
        if value is None or not (math.isfinite(value) and is_allowed(value)):
            self.fault(key, f"a quantity in {unit}, {allowed}", raw)
            return default
        return value

    def quantities(
        self, key: str, unit: str, counts: Sequence[int], default: Sequence[float] = ()
    ) -> list[float] | None:
        """Return a list of quantities in SI; None if faulty or missing."""
        raw = self.take(key, required=not default)
        if raw is None:
            return list(default) or None
        values = [_convert(item, unit) for item in raw] if _is_list(raw) else []
        finite = [v for v in values if v is not None and math.isfinite(v)]
        if len(values) not in counts or len(finite) != len(values):
            count = " or ".join(map(str, counts))
            self.fault(key, f"a list of {count} quantities in {unit}", raw)
            return None
        return finite

    def finish(self) -> None:
        """Note keys that nothing asked for."""
        for key in sorted(set(self.table) - self.known):
            allowed = ", ".join(sorted(self.known))
            self.faults.append(
                f"{self.place}.{key}: is not a known key; allowed are {allowed}"
            )


def read_elements(
    document: Mapping[str, object], file: str
) -> tuple[str, list[AbstractElement]]:
    """Return the name and the elements of a parsed robot file.

    Args:
        document: The parsed file.
        file: Name of the file, for messages.

    Returns:
        The model's name, its elements.

    Raises:
        RobotFileError: If anything is wrong.
    """
    faults: list[str] = []
    top = _Reader(document, "top level", faults)
    name = top.take("name", required=True)
    if not isinstance(name, str) and "name" in document:
        top.fault("name", "a string", name)
    if not isinstance(top.take("description", ""), str):
        top.fault("description", "a string", document["description"])
    elements = _read_list(top.take("elements", required=True), "elements", faults)
    top.finish()
    joints = [
        e.name
        for e in _flatten(elements)
        if isinstance(e, RevoluteJoint | PrismaticJoint)
    ]
    for twice in sorted({n for n in joints if joints.count(n) > 1}):
        faults.append(f"elements: the joint name {twice!r} occurs more than once")
    if not joints and not faults:
        faults.append("elements: must contain at least one joint")
    if faults:
        count = f"{len(faults)} fault" + ("s" if len(faults) > 1 else "")
        raise RobotFileError(
            f"{file}: {count} in the robot description:\n"
            + "\n".join(f"  - {fault}" for fault in faults)
        )
    return str(name), elements


def _read_list(raw: Any, place: str, faults: list[str]) -> list[AbstractElement]:
    """Return the elements of a list of tables."""
    if raw is None:
        return []
    if not _is_list(raw):
        faults.append(f"{place}: must be a list of tables, but is {raw!r}")
        return []
    elements = []
    for index, table in enumerate(raw):
        where = f"{place}[{index}]"
        if not isinstance(table, Mapping):
            faults.append(f"{where}: must be a table, but is {table!r}")
            continue
        kind = table.get("kind")
        if not isinstance(kind, str) or kind not in _READERS:
            faults.append(
                f"{where}.kind: must be one of {', '.join(_READERS)}, but is {kind!r}"
            )
            continue
        reader = _Reader(table, f"{where} ({kind})", faults)
        before = len(faults)
        make = _READERS[kind](reader)
        reader.finish()
        if len(faults) == before:
            elements.append(make())
    return elements


def _read_translation(reader: _Reader) -> Callable[[], AbstractElement]:
    position = reader.quantities("position", "m", (3,))
    return lambda: FixedTranslation(tuple(position or ()))


def _read_rotation(reader: _Reader) -> Callable[[], AbstractElement]:
    rpy = reader.quantities("rpy", "rad", (3,))
    return lambda: FixedRotation(rpy_matrix(*(rpy or ())))


def _read_joint(reader: _Reader) -> Callable[[], AbstractElement]:
    kind = str(reader.table["kind"])
    position, stiffness, damping = _JOINT_UNITS[kind]
    name = reader.take("name", required=True)
    if "name" in reader.table and not (isinstance(name, str) and name):
        reader.fault("name", "a non-empty string", name)
    axis = reader.take("axis", (0.0, 0.0, 1.0))
    if not (_is_list(axis) and len(axis) == 3 and _are_numbers(axis) and any(axis)):
        reader.fault("axis", "a list of 3 numbers that are not all 0", axis)
    is_virtual = reader.take("virtual", False)
    if not isinstance(is_virtual, bool):
        reader.fault("virtual", "true or false", is_virtual)
    lower = reader.quantity("lower", position, -math.inf)
    upper = reader.quantity("upper", position, math.inf)
    home = reader.quantity("home", position, 0.0)
    if not lower <= home <= upper:
        reader.fault("home", f"between lower {lower:g} and upper {upper:g}", home)
    K = reader.quantity(
        "stiffness", stiffness, math.inf, is_allowed=lambda x: x > 0, allowed="positive"
    )
    D = reader.quantity(
        "damping", damping, 0.0, is_allowed=lambda x: x >= 0, allowed="not negative"
    )
    joint = RevoluteJoint if kind == "revolute" else PrismaticJoint
    return lambda: joint(
        name=name,
        axis=tuple(map(float, axis)),
        stiffness=K,
        damping=D,
        lower=lower,
        upper=upper,
        home=home,
        is_virtual=is_virtual,
    )


def _read_body(reader: _Reader) -> Callable[[], AbstractElement]:
    mass = reader.quantity(
        "mass", "kg", required=True, is_allowed=lambda x: x > 0, allowed="positive"
    )
    center = reader.quantities("center_of_mass", "m", (3,), (0.0, 0.0, 0.0))
    moments = reader.quantities("inertia", "kg*m^2", (3, 6))
    inertia = np.eye(3)
    if moments is not None:
        xx, yy, zz, xy, xz, yz = [*moments, 0.0, 0.0, 0.0][:6]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        wrong = inertia_fault(inertia) or _triangle_fault(inertia)
        if wrong:
            reader.faults.append(
                f"{reader.place}.inertia: (xx, yy, zz, xy, xz, yz) must be {wrong}"
            )
    return lambda: RigidBody(mass, tuple(center or ()), inertia)


def _triangle_fault(inertia: np.ndarray) -> str:
    """Return what is wrong with an inertia that no distribution of mass has."""
    principal = np.linalg.eigvalsh(inertia)
    # Equality is a flat body; the tolerance lets rounded data pass.
    if principal[2] <= (principal[0] + principal[1]) * (1.0 + 1e-6):
        return ""
    return (
        "that of a body (no principal value above the sum of the other two), but its "
        f"principal values are {principal.tolist()}."
    )


def _read_fork(reader: _Reader) -> Callable[[], AbstractElement]:
    raw = reader.take("branches", required=True)
    branches = []
    if raw is not None and not _is_list(raw):
        reader.fault("branches", "a list of lists of elements", raw)
    elif raw is not None:
        for index, branch in enumerate(raw):
            place = f"{reader.place}.branches[{index}]"
            branches.append(_read_list(branch, place, reader.faults))
    return lambda: Fork(branches)


def _read_tool(reader: _Reader) -> Callable[[], AbstractElement]:
    name = reader.take("name", "tool")
    if not (isinstance(name, str) and name):
        reader.fault("name", "a non-empty string", name)
    position = reader.quantities("position", "m", (3,), (0.0, 0.0, 0.0))
    rpy = reader.quantities("rpy", "rad", (3,), (0.0, 0.0, 0.0))
    return lambda: Tool(name, tuple(position or ()), rpy_matrix(*(rpy or ())))


_READERS: dict[str, Callable[[_Reader], Callable[[], AbstractElement]]] = {
    "translation": _read_translation,
    "rotation": _read_rotation,
    "revolute": _read_joint,
    "prismatic": _read_joint,
    "body": _read_body,
    "fork": _read_fork,
    "tool": _read_tool,
}


def _is_list(raw: object) -> bool:
    return isinstance(raw, Sequence) and not isinstance(raw, str)


def _are_numbers(values: Sequence[object]) -> bool:
    return all(
        isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v)
        for v in values
    )


def _flatten(elements: Sequence[AbstractElement]) -> list[AbstractElement]:
    """Return all elements, those of branches too."""
    flat: list[AbstractElement] = []
    for element in elements:
        flat.append(element)
        if isinstance(element, Fork):
            for branch in element.branches:
                flat.extend(_flatten(branch))
    return flat


@functools.cache
def _units():
    """Return pint's registry; its import takes a moment, so only when needed."""
    import pint

    return pint.UnitRegistry()


def _convert(raw: object, unit: str) -> float | None:
    """Return a quantity such as "650 mm" in an SI unit, None if it is not one."""
    if not isinstance(raw, str):
        return None
    try:
        quantity = _units().Quantity(raw)
        if quantity.unitless:
            return None
        return float(quantity.to(unit).magnitude)
    # pint raises errors of many kinds for text that is not a quantity.
    except Exception:
        return None
