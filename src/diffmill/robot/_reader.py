"""A table of a robot file being read: values checked, faults noted with their place.

Every value that comes from a file passes here once; quantities leave in SI.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

_COMMON_KEYS = {"kind", "source"}


@dataclasses.dataclass
class TableReader:
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
        values = [_convert(item, unit) for item in raw] if is_list(raw) else []
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


def is_list(raw: object) -> bool:
    """Return whether a value of a file is a list."""
    return isinstance(raw, Sequence) and not isinstance(raw, str)


def are_numbers(values: Sequence[object]) -> bool:
    """Return whether all values are finite numbers."""
    return all(
        isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v)
        for v in values
    )


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
