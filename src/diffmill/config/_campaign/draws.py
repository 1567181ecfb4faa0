"""Values of keys that scatter, drawn from seeded distributions."""

import math

import numpy as np

from ...units import base_quantity, scaled_quantity
from .._changes import Tables, value_at
from .schema import CampaignTable, DrawTable

# Tables that hold a force law.
_LAWS = ("force", "force.bottom")


def drawn_values(
    entry: DrawTable, table: CampaignTable, tables: Tables
) -> list[object]:
    """Values of a key, one for every draw.

    Every key has a stream of its own: more draws, or one key more, leave those that
    were drawn before as they are.

    Args:
        entry: How the key scatters.
        table: The campaign, with its number of draws and their seed.
        tables: What the job file holds.

    Raises:
        LookupError: The scatter is relative, but the job holds no value.
        ValueError: Numbers are missing, or those of another distribution are there.
    """
    stream = np.random.default_rng([table.seed, *entry.key.encode()])
    if entry.relative is not None:
        _allow_only(entry, ("relative",))
        value = value_at(tables, entry.key)
        return [_scattered(value, entry, stream) for _ in range(table.draws)]
    names = {"normal": ("mean", "deviation"), "uniform": ("lower", "upper")}
    if entry.kind not in names:
        raise ValueError(f'found kind "{entry.kind}", which `relative` is required for')
    _allow_only(entry, names[entry.kind])
    (first, unit), (second, other) = (
        base_quantity(getattr(entry, name)) for name in names[entry.kind]
    )
    if unit != other:
        raise ValueError(f"found quantities in {unit or '1'} and {other or '1'}")
    units = [_unit_draw(entry.kind, stream) for _ in range(table.draws)]
    if entry.kind == "uniform":
        first, second = (first + second) / 2, (second - first) / 2
    values = [first + second * unit_draw for unit_draw in units]
    return [f"{value!r} {unit}" if unit else value for value in values]


def _allow_only(entry: DrawTable, names: tuple[str, ...]) -> None:
    """Raise if the numbers of a distribution are missing, or others are there."""
    given = entry.model_dump(exclude={"key", "kind"}, exclude_none=True)
    if set(given) != set(names):
        raise ValueError(
            f"found {', '.join(given) or 'nothing'}, but {' and '.join(names)} is "
            'required here; allowed: relative, or with kind = "normal" mean and '
            'deviation, or with kind = "uniform" lower and upper'
        )


def _unit_draw(kind: str, stream: np.random.Generator) -> float:
    """Draw about 0 with a standard deviation, or a half-width, of 1."""
    draw = stream.uniform(-1.0, 1.0) if kind == "uniform" else stream.normal()
    return float(draw)


def scaled(value: object, factor: float, key: str = "") -> object:
    """Value of a job times a factor; of a list, each entry.

    Of a table each entry that has a unit; of a force law its coefficients alone, since
    the thicknesses that Kienzle's law refers to are no forces.

    Args:
        value: What the job holds.
        factor: A number.
        key: Where it does; of anything but tables it does not matter.

    Raises:
        ValueError: It is no number and no quantity.
    """
    if isinstance(value, dict):
        is_law = key in _LAWS
        found = {
            name: _scaled_if_unit(one, factor, f"{key}.{name}")
            if not is_law or name.startswith("K_") or isinstance(one, dict)
            else one
            for name, one in value.items()
        }
        if found == value and factor != 1:
            cure = ""
            if "material" in value:
                cure = "; state the coefficients that `diffmill check` prints"
            raise ValueError(
                f"found {value!r}, which has no quantity with a unit{cure}"
            )
        return found
    if isinstance(value, list):
        return [scaled(one, factor) for one in value]
    return scaled_quantity(value, factor)


def _scaled_if_unit(value: object, factor: float, key: str) -> object:
    """Entry of a table times a factor, if it has a unit."""
    if isinstance(value, dict | list):
        return scaled(value, factor, key)
    try:
        has_unit = bool(base_quantity(value).unit)
    except ValueError:
        return value
    return scaled(value, factor) if has_unit else value


def _scattered(value: object, entry: DrawTable, stream: np.random.Generator) -> object:
    """Value of the job with a relative scatter; of a list, of each entry."""
    if isinstance(value, list):
        return [_scattered(one, entry, stream) for one in value]
    assert entry.relative is not None
    step = entry.relative * _unit_draw(entry.kind, stream)
    factor = math.exp(step) if entry.kind == "lognormal" else 1 + step
    return scaled(value, factor, entry.key)
