"""A table of a robot file being read: values checked, faults noted with their place.

Every value that comes from a file passes here once; quantities leave in SI.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TypeGuard

from ...units import QuantityKind, quantity

_COMMON_KEYS = {"kind", "source"}


@dataclasses.dataclass
class ElementReader:
    """A table being read: gives checked values and notes the faults."""

    table: Mapping[str, object]
    place: str
    faults: list[str]
    known: set[str] = dataclasses.field(default_factory=lambda: set(_COMMON_KEYS))

    def fault(self, key: str, allowed: str, found: object) -> None:
        """Note that a key's value is not what is allowed."""
        self.faults.append(f"{self.place}.{key}: must be {allowed}, but is {found!r}")

    def take(
        self, key: str, default: object = None, *, required: bool = False
    ) -> object:
        """Return the raw value of a key and mark it as known."""
        self.known.add(key)
        if key in self.table:
            return self.table[key]
        if required:
            self.faults.append(f"{self.place}.{key}: is missing")
        return default

    def text(
        self,
        key: str,
        default: str | None = None,
        *,
        allowed: str = "a string",
        may_be_empty: bool = True,
    ) -> str:
        """Text, required without a default; an empty one after a fault."""
        raw = self.take(key, default, required=default is None)
        is_good = isinstance(raw, str) and (raw != "" or may_be_empty)
        if key in self.table and not is_good:
            self.fault(key, allowed, raw)
        return raw if isinstance(raw, str) else ""

    def inner(self, key: str, allowed: str) -> "ElementReader | None":
        """Reader of a table within; None without one, or after a fault."""
        raw = self.take(key)
        if isinstance(raw, Mapping):
            return ElementReader(raw, f"{self.place}.{key}", self.faults)
        if raw is not None:
            self.fault(key, allowed, raw)
        return None

    def quantity(
        self,
        key: str,
        kind: QuantityKind,
        default: float = math.nan,
        *,
        required: bool = False,
        is_allowed: Callable[[float], bool] = math.isfinite,
        allowed: str = "finite",
    ) -> float:
        """Quantity in SI, the default where the key is absent."""
        raw = self.take(key, required=required)
        value = None if raw is None else self._convert(key, raw, kind)
        if value is None:
            return default
        if not is_allowed(value):
            self.fault(key, allowed, raw)
            return default
        return value

    def quantities(
        self,
        key: str,
        kind: QuantityKind,
        counts: Sequence[int],
        default: Sequence[float] = (),
    ) -> list[float] | None:
        """List of quantities in SI; None if faulty or missing."""
        raw = self.take(key, required=not default)
        if raw is None:
            return list(default) or None
        if not is_list(raw) or len(raw) not in counts:
            count = " or ".join(map(str, counts))
            allowed = f'a list of {count} quantities such as "{kind.example}"'
            self.fault(key, allowed, raw)
            return None
        values = [self._convert(f"{key}[{i}]", v, kind) for i, v in enumerate(raw)]
        good = [value for value in values if value is not None]
        return good if len(good) == len(raw) else None

    def _convert(self, key: str, raw: object, kind: QuantityKind) -> float | None:
        """Quantity in SI, None after a fault."""
        try:
            return quantity(raw, kind)
        except ValueError as error:
            self.faults.append(f"{self.place}.{key}: {error}")
            return None

    def finish(self) -> None:
        """Note keys that nothing asked for."""
        for key in sorted(set(self.table) - self.known):
            allowed = ", ".join(sorted(self.known))
            self.faults.append(
                f"{self.place}.{key}: is not a known key; allowed are {allowed}"
            )


def is_list(raw: object) -> TypeGuard[Sequence[object]]:
    """True if a value of a file is a list."""
    return isinstance(raw, Sequence) and not isinstance(raw, str)


def are_numbers(values: Sequence[object]) -> TypeGuard[Sequence[float]]:
    """True if all values are finite numbers."""
    return all(
        isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v)
        for v in values
    )
