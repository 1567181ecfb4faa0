"""Faults of a record's channels, by hypotheses that would explain its residual.

Each hypothesis adds unknowns to the fit of one record: a constant or a line of each
channel, or the gain of one channel against the others. One is told if it explains half
of what the coefficients leave of the squared force.
"""

import math

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
    """Offset, drift or a gain that would explain the residual of a fit.

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
    before, _ = _fit(A, F)
    if not before > _ENOUGH * square:
        return ()
    offset, x = _fit(np.concatenate([A, one], axis=2), F)
    # Code, squared residual [N^2] and values of each hypothesis.
    faults = [("offset", offset, dict(zip("xyz", x[-3:], strict=True)))]
    slope = one * middle[:, None, None]
    drift, x = _fit(np.concatenate([A, one, slope], axis=2), F)
    if drift < _DRIFTS * offset:
        faults = [("drift", drift, dict(zip("xyz", x[-3:], strict=True)))]
    left, axis, ratio = _gain(A, F)
    if max(ratio, 1 / ratio) > _GAIN:
        values = {"axis": float(axis), "ratio": ratio}
        faults.append(("channel_gain", left, values))
    faults.sort(key=lambda fault: fault[1])
    return tuple(
        Diagnosis(
            code,
            record,
            {
                **{k: float(v) for k, v in values.items()},
                "before": before / square,
                "left": left / square,
            },
        )
        for code, left, values in faults
        if left <= _AS_WELL * faults[0][1] and left < _EXPLAINS * before
    )


def _fit(
    A: Float[np.ndarray, "row 3 unknown"], F: Float[np.ndarray, "row 3"]
) -> tuple[float, Float[np.ndarray, " unknown"]]:
    """Squared residual [N^2] of the best unknowns, and these, shape (unknown,)."""
    flat, right = A.reshape(-1, A.shape[2]), F.reshape(-1)
    x = solve_normal(flat.T @ flat, flat.T @ right)
    return float(np.sum((right - flat @ x) ** 2)), x


def _gain(
    A: Float[np.ndarray, "row 3 unknown"], F: Float[np.ndarray, "row 3"]
) -> tuple[float, int, float]:
    """Least squared residual [N^2] with another gain of one channel, and that.

    Returns:
        The residual, the axis of the channel and its gain [-].
    """
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
        (squared_residual(axis, float(gain)), axis, float(gain))
        for axis in seen.tolist()
        for gain in _GAINS
    ]
    return min(tried, default=(math.inf, 0, 1.0))


def similar_classes(K_tc: float) -> tuple[str, ...]:
    """Classes of materials with such a pressure K_tc [Pa]."""
    known: dict[str, list[float]] = {}
    for one in materials().values():
        known.setdefault(one.kind, []).append(float(one.law.K_tc))
    return tuple(
        kind
        for kind, values in known.items()
        if min(values) / _CLASS_ROOM <= K_tc <= max(values) * _CLASS_ROOM
    )


def check_coefficients(K: Float[np.ndarray, " 6"]) -> tuple[Diagnosis, ...]:
    """Diagnosis of coefficients that no known material has.

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
