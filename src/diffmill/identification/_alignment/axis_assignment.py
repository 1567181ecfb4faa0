"""Assignment of a dynamometer's axes: proposals with their evidence.

A dynamometer measures along its own axes, which are turned, mirrored or exchanged
against those of the simulation, and with the sign of the force on the workpiece or of
that on the tool. That makes 48 signed permutations. The six coefficients of the force
law are fitted to the record under each of them, which is cheap: the sums over samples
are shared. For each of the six permutations, physics decides which signs make sense.
"""

import dataclasses
import itertools

import numpy as np
from jaxtyping import Bool, Float

from .axis_proposal import (
    AxesCandidate,
    AxesProposal,
    axes_label,
    axes_rank,
    proposal_of,
)

# Penalties of violations of physics, beside a relative residual between 0 and 1. A
# negative tangential or radial force weighs most. The axial force of straight flutes is
# taken to push toward the shank, that of a helix along its hand. Both weigh little:
# they decide where nothing else can, and say nothing against axes that someone chose.
_PENALTIES = {
    "the tangential force is negative": 0.5,
    "the radial force is negative": 0.5,
    "radial over tangential force is outside 0.1 to 1": 0.25,
}
_AXIAL = {
    0: ("the axial force is negative", 0.02),
    1: (
        "the axial force is positive, but a right-hand helix pulls toward the work",
        0.02,
    ),
    -1: (
        "the axial force is negative, but a left-hand helix pushes to the shank",
        0.02,
    ),
}
_RATIOS = (0.1, 1.0)


def propose_axes(
    force: Float[np.ndarray, "sample 3"],
    columns: Float[np.ndarray, "instant 3 6"],
    rate: float,
    *,
    max_shift: float = 0.0,
    tooth_frequency: float | None = None,
    helix_angle: float = 0.0,
) -> AxesProposal:
    """Assignments of the recorded axes to the simulation's, with the evidence.

    For each signed permutation the six coefficients follow from linear least squares,
    at the time shift with the least score. The score is the relative residual plus a
    penalty for what physics forbids: tangential and radial force are positive (edge
    included, at the mean chip), radial over tangential force lies within 0.1 to 1, the
    axial force of straight flutes is positive, that of a helix has the sign of its
    hand. The residual tells the axes apart as long as the forces vary within a turn; it
    does not show all signs at once reversed, nor the sign of z alone, for which only
    the penalties speak.

    Args:
        force: Record less its offset, at equal steps [N], shape (sample, 3); a channel
            that was not measured is NaN throughout.
        columns: Simulated force per unit of each coefficient at the same instants, in
            the order K_tc, K_rc, K_ac, K_te, K_re, K_ae, shape (sample, 3, 6).
        rate: Sampling rate of both [Hz].
        max_shift: How far the record may be shifted in time either way [s]; 0 if the
            spindle's angle is known. For a steady cut half a turn is enough.
        tooth_frequency: Tooth-passing frequency [Hz], for the phases in the evidence.
        helix_angle: Of the cutter, positive for a right-hand helix [rad].

    Returns:
        The six proposals and the evidence for the first.

    Raises:
        ValueError: If shapes disagree, the force is zero, or the record is not longer
            than four times `max_shift`.
    """
    force, columns = np.asarray(force, np.float64), np.asarray(columns, np.float64)
    lags = int(np.ceil(max_shift * rate))
    is_measured = np.asarray(~np.isnan(force).all(axis=0))
    # What was not measured adds nothing to the sums.
    force = np.where(is_measured[None], force, 0.0)
    if columns.shape != (force.shape[0], 3, 6):
        raise ValueError(
            f"Argument `columns` must have the shape {(force.shape[0], 3, 6)}, but has "
            f"{columns.shape}."
        )
    if force.shape[0] <= 4 * lags or not np.any(force):
        raise ValueError(
            f"The record must not rest at zero and have more than {4 * lags} samples "
            f"for this `max_shift`, but has {force.shape[0]}."
        )
    scale = np.sqrt(np.einsum("tac,tac->c", columns, columns))
    # A coefficient without effect keeps a column of zeros and the value zero.
    unit = columns / np.where(scale > 0, scale, 1.0)[None, None]
    products = _products(force, unit, lags)
    inside = slice(lags, force.shape[0] - lags)
    grams = np.einsum("tac,tad->acd", unit[inside], unit[inside])
    hand = int(np.sign(helix_angle))
    power = np.sum(force[inside] ** 2)
    ranked = []
    for matrix in signed_permutations():
        seen = np.abs(matrix) @ is_measured > 0
        inverse = np.linalg.pinv(grams[seen].sum(axis=0), rcond=1e-9, hermitian=True)
        assigned = np.einsum("ai,iacl->lc", matrix, products)
        solutions = assigned @ inverse
        residual = 1.0 - np.einsum("lc,lc->l", assigned, solutions) / power
        score = np.sqrt(np.clip(residual, 0.0, None))
        score += _penalties(hand) @ _violated(solutions, hand)
        best = int(np.argmin(score))
        ranked.append((axes_rank(float(score[best]), matrix), best - lags, matrix))
    ranked.sort(key=lambda one: one[0])
    turn = None if tooth_frequency is None else 2 * np.pi * tooth_frequency / rate
    candidates = []
    for _, lag, matrix in ranked:
        # Channels that were not measured stay NaN, and their columns zero.
        seen = np.abs(matrix) @ is_measured > 0
        recorded = np.where(seen, force[inside] @ matrix.T, np.nan)
        basis = unit[inside.start - lag : inside.stop - lag] * seen[:, None]
        one = _candidate(matrix, recorded, basis, turn, hand)
        coefficients = one.coefficients / np.where(scale > 0, scale, np.inf)
        one = dataclasses.replace(one, coefficients=coefficients, time_shift=lag / rate)
        candidates.append(one)
    return proposal_of(tuple(candidates))


def signed_permutations() -> list[Float[np.ndarray, "3 3"]]:
    """The 48 matrices that exchange and reverse axes."""
    return [
        np.array(signs)[:, None] * np.eye(3)[list(order)]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]


def _products(
    force: Float[np.ndarray, "sample 3"],
    unit: Float[np.ndarray, "sample 3 6"],
    lags: int,
) -> Float[np.ndarray, "channel axis coefficient lag"]:
    """Sums of channel times shifted column, for lags from -lags to lags."""
    count = force.shape[0]
    inner = np.zeros_like(force)
    inner[lags : count - lags] = force[lags : count - lags]
    if lags == 0:
        return np.einsum("ti,tac->iac", inner, unit)[..., None]
    # The inner part never meets what wraps around within these lags.
    size = 1 << (count - 1).bit_length()
    spectrum = np.conj(np.fft.rfft(unit, size, axis=0))
    wanted = np.arange(-lags, lags + 1)
    out = np.empty((3, 3, 6, wanted.size))
    for channel in range(3):
        product = np.fft.rfft(inner[:, channel], size)[:, None, None] * spectrum
        sums = np.fft.irfft(product, size, axis=0)[wanted]
        out[channel] = np.moveaxis(sums, 0, -1)
    return out


def _penalties(hand: int) -> Float[np.ndarray, " violation"]:
    """Penalties of the violations, in the order of `_violated`."""
    return np.array([*_PENALTIES.values(), _AXIAL[hand][1]])


def _violated(
    solutions: Float[np.ndarray, "lag coefficient"], hand: int
) -> Bool[np.ndarray, "violation lag"]:
    """True where a solution violates physics.

    With columns of unit size, cutting and edge part of a solution add to the force.

    Args:
        solutions: Coefficients in these units, shape (lag, 6).
        hand: 1 for a right-hand helix, -1 for a left-hand one, 0 for straight flutes.
    """
    tangential, radial, axial = (solutions[:, :3] + solutions[:, 3:]).T
    # Edge forces may exceed the bound at thin chips; noise splits the two badly.
    is_odd = _is_odd(tangential, radial) & _is_odd(solutions[:, 0], solutions[:, 1])
    both = (tangential > 0) & (radial > 0)
    wrong = axial < 0 if hand == 0 else axial * hand > 0
    return np.array([tangential <= 0, radial <= 0, both & is_odd, wrong])


def _is_odd(
    tangential: Float[np.ndarray, " lag"], radial: Float[np.ndarray, " lag"]
) -> np.ndarray:
    low, high = _RATIOS
    return (radial < low * tangential) | (radial > high * tangential)


def _candidate(
    matrix: Float[np.ndarray, "3 3"],
    recorded: Float[np.ndarray, "sample 3"],
    basis: Float[np.ndarray, "sample 3 6"],
    turn: float | None,
    hand: int,
) -> AxesCandidate:
    """Assignment with its evidence, fitted anew at its time shift.

    Its coefficients are those of the basis and its time shift is 0.

    Args:
        matrix: The assignment.
        recorded: Record in its axes [N], shape (sample, 3); NaN where not measured.
        basis: Columns at the time shift; 0 where not measured.
        turn: Angle of the tooth passing per sample [rad], or None.
        hand: As of `_violated`.
    """
    seen = np.isfinite(recorded[0])
    recorded = np.where(seen, recorded, 0.0)
    flat = basis.reshape(-1, basis.shape[2])
    right = recorded.reshape(-1) @ flat
    solution = np.linalg.pinv(flat.T @ flat, rcond=1e-9, hermitian=True) @ right
    fitted = basis @ solution
    residual = float(np.linalg.norm(recorded - fitted) / np.linalg.norm(recorded))
    phase = np.full(3, np.nan)
    if turn is not None:
        turns = np.exp(-1j * turn * np.arange(len(fitted)))
        phase = np.angle((turns @ recorded) * np.conj(turns @ fitted))
        phase = np.where(seen, phase, np.nan)
    total = solution[:3] + solution[3:]
    violated = _violated(solution[None], hand)[:, 0]
    texts = (*_PENALTIES, _AXIAL[hand][0])
    return AxesCandidate(
        matrix=matrix,
        label=axes_label(matrix),
        is_mirrored=bool(np.linalg.det(matrix) < 0),
        score=residual + float(_penalties(hand) @ violated),
        residual=residual,
        coefficients=solution,
        radial_ratio=float(total[1] / total[0]) if total[0] else float("nan"),
        violations=tuple(itertools.compress(texts, violated)),
        time_shift=0.0,
        phase_error=phase,
        mean_recorded=np.where(seen, recorded.mean(axis=0), np.nan),
        mean_fitted=fitted.mean(axis=0),
    )
