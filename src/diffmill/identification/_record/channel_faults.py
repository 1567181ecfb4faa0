"""Faults of a record's channels, by what would explain the rest of it.

Each hypothesis adds unknowns to the fit of one record: a constant or a line of each
channel, or the gain of one channel against the others. One is told if it explains half
of what the coefficients leave of the squared force.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...cutting import materials
from .._statistics.robust_regression import Rows, solve_normal
from .diagnosis import Diagnosis

# A fit that leaves a smaller share of the squared force has no need of a hypothesis;
# one is told if what it leaves is a smaller part of that; others beside it if they
# leave no more than so many times as much.
_ENOUGH, _EXPLAINS, _AS_WELL = 0.003, 0.5, 1.5
# A drift in place of an offset must leave a smaller part than that.
_DRIFTS = 0.7
# Gains that are tried, and the least that is told.
_GAINS = np.geomspace(1e-4, 1e4, 641)
_GAIN = 1.15
# Coefficients of metals and plastics lie within so many times those of the materials.
_ROOM = 3.0
# The same for a class of materials: cutters and conditions differ by as much.
_CLASS_ROOM = 1.25
# Wrong units: kN, mN, lbf, kgf for N.
_UNITS = (1e3, 1e-3, 4.4482216, 1 / 4.4482216, 9.80665, 1 / 9.80665)
# Radial and axial over tangential coefficient of any cutter.
_RADIAL, _AXIAL = (0.05, 1.5), 1.5


def check_channels(
    rows: Rows, time: Float[np.ndarray, " row"], record: int
) -> tuple[Diagnosis, ...]:
    """Return offset, drift or a gain that would explain what a fit leaves.

    Args:
        rows: Equations of one record; force not a number where it does not count.
        time: Instants of the rows [s], shape (row,).
        record: Index of the record.

    Returns:
        Diagnoses, the one that explains most first.
    """
    known = np.isfinite(rows.force)
    F = np.where(known, rows.force, 0.0)
    A = np.where(known[:, :, None], rows.columns, 0.0)
    square = float(np.sum(F**2))
    one = np.where(known[:, :, None], np.eye(3)[None], 0.0)
    middle = time - 0.5 * (time[0] + time[-1])
    before = _fit(A, F).squared_residual
    if not before > _ENOUGH * square:
        return ()
    offset = _fit(np.concatenate([A, one], axis=2), F)
    slope = one * middle[:, None, None]
    drift = _fit(np.concatenate([A, one, slope], axis=2), F)
    values = dict(zip("xyz", offset.x[-3:], strict=True))
    found = [_Fault(offset.squared_residual, "offset", values)]
    if drift.squared_residual < _DRIFTS * offset.squared_residual:
        values = dict(zip("xyz", drift.x[-3:], strict=True))
        found = [_Fault(drift.squared_residual, "drift", values)]
    gain = _gain(A, F)
    if max(gain.ratio, 1 / gain.ratio) > _GAIN:
        values = {"axis": float(gain.axis), "ratio": gain.ratio}
        found.append(_Fault(gain.squared_residual, "channel_gain", values))
    least = min(one.squared_residual for one in found)
    told = sorted(
        (one for one in found if one.squared_residual <= _AS_WELL * least),
        key=lambda one: one.squared_residual,
    )
    return tuple(
        Diagnosis(
            one.code,
            record,
            {
                **{k: float(v) for k, v in one.values.items()},
                "before": before / square,
                "left": one.squared_residual / square,
            },
        )
        for one in told
        if one.squared_residual < _EXPLAINS * before
    )


class _Fault(NamedTuple):
    """A fault of the channels with its numbers, and the squared force that it leaves.

    Attributes:
        squared_residual: [N^2].
        code: Of a `Diagnosis`.
        values: Of a `Diagnosis`.
    """

    squared_residual: float
    code: str
    values: dict[str, float]


class _Fit(NamedTuple):
    """Squared force that a fit leaves [N^2], and its unknowns, shape (unknown,)."""

    squared_residual: float
    x: Float[np.ndarray, " unknown"]


def _fit(A: Float[np.ndarray, "row 3 unknown"], F: Float[np.ndarray, "row 3"]) -> _Fit:
    flat, right = A.reshape(-1, A.shape[2]), F.reshape(-1)
    x = solve_normal(flat.T @ flat, flat.T @ right)
    return _Fit(float(np.sum((right - flat @ x) ** 2)), x)


class _Gain(NamedTuple):
    """Gain of one channel [-], and the squared force that it leaves [N^2]."""

    squared_residual: float
    axis: int
    ratio: float


def _gain(
    A: Float[np.ndarray, "row 3 unknown"], F: Float[np.ndarray, "row 3"]
) -> _Gain:
    """Return the gain of one channel that leaves least."""
    G = np.einsum("tcu,tcv->cuv", A, A)
    g = np.einsum("tcu,tc->cu", A, F)
    square = float(np.sum(F**2))

    def squared_residual(axis: int, gain: float) -> float:
        own = np.ones(3)
        own[axis] = gain
        right = own @ g
        x = solve_normal(np.einsum("c,cuv->uv", own**2, G), right)
        return square - float(right @ x)

    seen = np.flatnonzero(np.any(F != 0, axis=0))
    tried = [
        _Gain(squared_residual(axis, float(gain)), axis, float(gain))
        for axis in seen.tolist()
        for gain in _GAINS
    ]
    return min(tried, default=_Gain(math.inf, 0, 1.0))


def similar_classes(K_tc: float) -> tuple[str, ...]:
    """Return the classes of materials that such a pressure is known of [Pa]."""
    known: dict[str, list[float]] = {}
    for one in materials().values():
        known.setdefault(one.kind, []).append(float(one.law.K_tc))
    return tuple(
        kind
        for kind, values in known.items()
        if min(values) / _CLASS_ROOM <= K_tc <= max(values) * _CLASS_ROOM
    )


def check_coefficients(K: Float[np.ndarray, " 6"]) -> tuple[Diagnosis, ...]:
    """Return whether no known material has such coefficients.

    Args:
        K: Coefficients [Pa, N/m]; NaN where not known, shape (6,).

    Returns:
        Diagnoses.
    """
    if not K[0] > 0:
        return ()
    known = [float(one.law.K_tc) for one in materials().values()]
    least, most = min(known) / _ROOM, max(known) * _ROOM
    if not least <= K[0] <= most:
        fits = [u for u in _UNITS if min(known) <= K[0] / u <= max(known)]
        values = {"value": float(K[0]), "least": least, "most": most}
        values["factor"] = fits[0] if fits else math.nan
        return (Diagnosis("implausible_pressure", 0, values),)
    radial, axial = (float(k / K[0]) for k in K[1:3])
    if radial < _RADIAL[0] or radial > _RADIAL[1] or abs(axial) > _AXIAL:
        values = {"radial": radial, "axial": axial}
        return (Diagnosis("implausible_ratio", 0, values),)
    return ()
