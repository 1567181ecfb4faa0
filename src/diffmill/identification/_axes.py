"""How a dynamometer may have been mounted: proposals with their evidence.

A dynamometer measures along its own axes, which are turned, mirrored or exchanged
against those of the simulation, and with the sign of the force on the workpiece or of
that on the tool. That makes 48 signed permutations. The six coefficients of the force
law are fitted to the record under each of them, which is cheap: the sums over samples
are shared. For each of the six permutations, physics decides which signs make sense.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ._record import Record

# What a violation of physics adds to a relative residual between 0 and 1. A negative
# tangential or radial force weighs most; that K_ac is positive holds less surely.
_PENALTIES = {
    "the tangential force is negative": 0.5,
    "the radial force is negative": 0.5,
    "radial over tangential force is outside 0.1 to 1": 0.25,
    "the axial force is negative": 0.02,
}
_RATIOS = (0.1, 1.0)
# Scores that differ by less are no evidence.
_CLEAR = 0.05
_AXES = "xyz"


class AxesCandidate(NamedTuple):
    """One assignment of recorded to simulated axes, and what speaks for it.

    Attributes:
        matrix: Turns recorded into simulated forces: F = matrix @ F_recorded, one
            1 or -1 in each row and column, shape (3, 3).
        label: The same in words, such as `x = -Fy, y = +Fx, z = +Fz`.
        is_mirrored: Whether the recorded axes are left-handed in the simulation's.
        score: Relative residual plus what violations of physics add; less is better.
        residual: Root of the share of the force's square that the fit leaves, 0 to 1.
        coefficients: K_tc, K_rc, K_ac [Pa], K_te, K_re, K_ae [N/m] of this fit.
        radial_ratio: Radial over tangential force, edge forces included.
        violations: What makes no physical sense, in words.
        time_shift: By how much the record lags behind the simulation [s].
        phase_error: Phase of the record less that of the fit at the tooth-passing
            frequency [rad], shape (3,); NaN without that frequency.
        mean_recorded: Mean of the assigned record [N], shape (3,).
        mean_fitted: Mean of the fit [N], shape (3,).
    """

    matrix: Float[np.ndarray, "3 3"]
    label: str
    is_mirrored: bool
    score: float
    residual: float
    coefficients: Float[np.ndarray, " coefficient"]
    radial_ratio: float
    violations: tuple[str, ...]
    time_shift: float
    phase_error: Float[np.ndarray, " axis"]
    mean_recorded: Float[np.ndarray, " axis"]
    mean_fitted: Float[np.ndarray, " axis"]


class AxesProposal(NamedTuple):
    """Assignments of the axes, the likeliest first; nothing has been applied.

    Attributes:
        proposals: The best signs of each of the six permutations, best first.
        candidates: All 48 signed permutations, best first.
        is_clear: Whether the best is better than every other by more than 0.05 in
            score, those apart that differ in the sign of z only.
        evidence: What speaks for the best, one sentence each.
    """

    proposals: tuple[AxesCandidate, ...]
    candidates: tuple[AxesCandidate, ...]
    is_clear: bool
    evidence: tuple[str, ...]


def apply_axes(record: Record, matrix: Float[np.ndarray, "3 3"]) -> Record:
    """Return a record in the simulation's axes, and note it there.

    Args:
        record: The record.
        matrix: A signed permutation, such as that of an `AxesCandidate`.

    Raises:
        ValueError: If `matrix` is no signed permutation.

    Differentiability: linear in the force; on the host.
    """
    size = np.abs(np.asarray(matrix))
    if not np.array_equal(np.sort(size, axis=1), [[0, 0, 1]] * 3) or not np.array_equal(
        size.sum(axis=0), [1, 1, 1]
    ):
        raise ValueError(
            "Argument `matrix` must have one 1 or -1 in each row and column, but is "
            f"{np.asarray(matrix).tolist()}."
        )
    return dataclasses.replace(
        record,
        force=record.force @ np.asarray(matrix, dtype=np.float64).T,
        names=("Fx", "Fy", "Fz"),
        notes=(*record.notes, f"The axes were assigned: {_label(matrix)}."),
    )


def propose_axes(
    force: Float[np.ndarray, "sample 3"],
    columns: Float[np.ndarray, "instant 3 6"],
    rate: float,
    *,
    max_shift: float = 0.0,
    tooth_frequency: float | None = None,
) -> AxesProposal:
    """Return how the recorded axes may lie in the simulation's, with the evidence.

    For each signed permutation the six coefficients follow from linear least squares,
    at the time shift with the least score. The score is the relative residual plus a
    penalty for what physics forbids: tangential and radial force are positive (edge
    included, at the mean chip), radial over tangential force lies within 0.1 to 1, the
    axial force is positive. The residual tells the axes apart as long as the forces
    vary within a turn; it cannot tell all signs at once reversed, nor the sign of z
    alone, for which only the penalties speak.

    Args:
        force: Record less its offset, at equal steps [N], shape (sample, 3).
        columns: Simulated force per unit of each coefficient at the same instants, in
            the order K_tc, K_rc, K_ac, K_te, K_re, K_ae, shape (sample, 3, 6).
        rate: Sampling rate of both [Hz].
        max_shift: How far the record may be shifted in time either way [s]; 0 if the
            spindle's angle is known. For a steady cut half a turn is enough.
        tooth_frequency: Tooth-passing frequency [Hz], for the phases in the evidence.

    Returns:
        The six proposals and what speaks for the first.

    Raises:
        ValueError: If shapes disagree, the force is zero, or the record is not longer
            than four times `max_shift`.

    Differentiability: none.
    """
    force, columns = np.asarray(force, np.float64), np.asarray(columns, np.float64)
    lags = int(np.ceil(max_shift * rate))
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
    gram = np.einsum("tac,tad->cd", unit[inside], unit[inside])
    inverse = np.linalg.pinv(gram, rcond=1e-9, hermitian=True)
    found = []
    for matrix in signed_permutations():
        assigned = np.einsum("ai,iacl->lc", matrix, products)
        solutions = assigned @ inverse
        power = np.sum(force[inside] ** 2)
        rest = 1.0 - np.einsum("lc,lc->l", assigned, solutions) / power
        residual = np.sqrt(np.clip(rest, 0.0, None))
        score = residual + _penalty(solutions)
        best = int(np.argmin(score))
        found.append((float(score[best]), best - lags, matrix))
    found.sort(key=lambda item: item[0])
    candidates = tuple(
        _candidate(force, unit, scale, matrix, lag, lags, rate, tooth_frequency)
        for _, lag, matrix in found
    )
    return _proposal(candidates)


def combine_axes_proposals(proposals: Sequence[AxesProposal]) -> AxesProposal:
    """Return what several records of one dynamometer say together.

    Scores and residuals are averaged; the other evidence of each assignment is that
    of the first record.

    Args:
        proposals: One per record.

    Returns:
        The proposal.

    Raises:
        ValueError: There are none.

    **Differentiability**: runs on the host.
    """
    if not proposals:
        raise ValueError("Argument `proposals` must hold at least one, but is empty.")
    by_label = [{c.label: c for c in one.candidates} for one in proposals]
    merged = []
    for label, first in by_label[0].items():
        alike = [found[label] for found in by_label]
        merged.append(
            first._replace(
                score=float(np.mean([c.score for c in alike])),
                residual=float(np.mean([c.residual for c in alike])),
            )
        )
    return _proposal(tuple(merged))


def signed_permutations() -> list[Float[np.ndarray, "3 3"]]:
    """Return the 48 matrices that exchange and reverse axes."""
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
    """Return sums of channel times shifted column, for lags from -lags to lags."""
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


def _penalty(
    solutions: Float[np.ndarray, "lag coefficient"],
) -> Float[np.ndarray, " lag"]:
    return sum(
        np.where(is_violated, weight, 0.0)
        for is_violated, weight in zip(
            _violated(solutions), _PENALTIES.values(), strict=True
        )
    ) + np.zeros(len(solutions))


def _violated(solutions: Float[np.ndarray, "lag coefficient"]) -> list[np.ndarray]:
    """Return for each penalty where it applies.

    With columns of unit size, cutting and edge part of a solution add to the force.
    """
    tangential, radial, axial = (solutions[:, :3] + solutions[:, 3:]).T
    # Edge forces may exceed the bound at thin chips; noise splits the two parts badly.
    is_odd = _is_odd(tangential, radial) & _is_odd(solutions[:, 0], solutions[:, 1])
    both = (tangential > 0) & (radial > 0)
    return [tangential <= 0, radial <= 0, both & is_odd, axial < 0]


def _is_odd(
    tangential: Float[np.ndarray, " lag"], radial: Float[np.ndarray, " lag"]
) -> np.ndarray:
    low, high = _RATIOS
    return (radial < low * tangential) | (radial > high * tangential)


def _candidate(
    force: Float[np.ndarray, "sample 3"],
    unit: Float[np.ndarray, "sample 3 6"],
    scale: Float[np.ndarray, " coefficient"],
    matrix: Float[np.ndarray, "3 3"],
    lag: int,
    lags: int,
    rate: float,
    tooth_frequency: float | None,
) -> AxesCandidate:
    """Return one assignment with its evidence, fitted anew at its time shift."""
    count = force.shape[0]
    recorded = force[lags : count - lags] @ matrix.T
    basis = unit[lags - lag : count - lags - lag]
    gram = np.einsum("tac,tad->cd", basis, basis)
    right = np.einsum("ta,tac->c", recorded, basis)
    solution = np.linalg.pinv(gram, rcond=1e-9, hermitian=True) @ right
    fitted = basis @ solution
    residual = float(np.linalg.norm(recorded - fitted) / np.linalg.norm(recorded))
    phase = np.full(3, np.nan)
    if tooth_frequency is not None:
        turns = np.exp(-2j * np.pi * tooth_frequency / rate * np.arange(len(fitted)))
        phase = np.angle((turns @ recorded) * np.conj(turns @ fitted))
    tests = [bool(test[0]) for test in _violated(solution[None])]
    total = solution[:3] + solution[3:]
    return AxesCandidate(
        matrix=matrix,
        label=_label(matrix),
        is_mirrored=bool(np.linalg.det(matrix) < 0),
        score=residual + float(_penalty(solution[None])[0]),
        residual=residual,
        coefficients=solution / np.where(scale > 0, scale, np.inf),
        radial_ratio=float(total[1] / total[0]) if total[0] else float("nan"),
        violations=tuple(
            t for t, is_so in zip(_PENALTIES, tests, strict=True) if is_so
        ),
        time_shift=lag / rate,
        phase_error=phase,
        mean_recorded=recorded.mean(axis=0),
        mean_fitted=fitted.mean(axis=0),
    )


def _label(matrix: Float[np.ndarray, "3 3"]) -> str:
    parts = []
    for axis, row in zip(_AXES, matrix, strict=True):
        channel = int(np.argmax(np.abs(row)))
        parts.append(f"{axis} = {'+' if row[channel] > 0 else '-'}F{_AXES[channel]}")
    return ", ".join(parts)


def _proposal(candidates: tuple[AxesCandidate, ...]) -> AxesProposal:
    """Return the candidates in order, the six proposals, and the evidence."""
    ranked = tuple(sorted(candidates, key=lambda candidate: candidate.score))
    best = ranked[0]
    of_order: dict[tuple[int, ...], AxesCandidate] = {}
    for candidate in ranked:
        order = tuple(np.argmax(np.abs(candidate.matrix), axis=1).tolist())
        of_order.setdefault(order, candidate)
    rivals = [
        other
        for other in ranked[1:]
        if not np.array_equal(other.matrix[:2], best.matrix[:2])
    ]
    margin = rivals[0].score - best.score
    return AxesProposal(
        tuple(of_order.values()), ranked, margin > _CLEAR, _evidence(best, rivals[0])
    )


def _evidence(best: AxesCandidate, rival: AxesCandidate) -> tuple[str, ...]:
    signs = ["+-"[int(mean < 0)] for mean in best.mean_recorded]
    fitted = ["+-"[int(mean < 0)] for mean in best.mean_fitted]
    lines = [
        f"{best.label}: the fit leaves {best.residual:.3f} of the force; the next, "
        f"{rival.label}, leaves {rival.residual:.3f} (scores {best.score:.3f} and "
        f"{rival.score:.3f}).",
        f"Radial over tangential force is {best.radial_ratio:.3f}.",
        f"The means have the signs {' '.join(signs)}, the fit's {' '.join(fitted)}.",
        "The sign of z rests on a positive axial force alone.",
    ]
    if best.is_mirrored:
        lines.append("The recorded axes are left-handed in those of the simulation.")
    if np.all(np.isfinite(best.phase_error)):
        degrees = ", ".join(f"{value:.1f}" for value in np.rad2deg(best.phase_error))
        lines.append(
            f"At the tooth-passing frequency the record leads the fit by {degrees} deg."
        )
    lines += [f"Against it: {violation}." for violation in best.violations]
    return tuple(lines)
