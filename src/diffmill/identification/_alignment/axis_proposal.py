"""Evidence for an assignment of a dynamometer's axes, in numbers and in words."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

# Scores that differ by less are no evidence.
_CLEAR = 0.05
# What left-handed axes add to a score where they must be right-handed: more than the
# sign of the axial force, less than what is evidence.
_LEFT_HANDED = 0.04
# Scores that differ by rounding alone are the same.
_DIGITS = 9
_AXES = "xyz"


def axes_names(matrix: Float[np.ndarray, "3 3"]) -> tuple[str, str, str]:
    """Names of the axes of a signed permutation, such as ("-y", "x", "z").

    Args:
        matrix: Turns recorded into simulated forces, shape (3, 3).

    Returns:
        For each axis of the simulation the recorded one, with its sign.
    """
    names = []
    for row in np.asarray(matrix):
        channel = int(np.argmax(np.abs(row)))
        names.append(f"{'-' if row[channel] < 0 else ''}{'xyz'[channel]}")
    return (names[0], names[1], names[2])


def in_work_axes(
    force: Float[np.ndarray, "row 3"], axes: Sequence[str]
) -> Float[np.ndarray, "row 3"]:
    """Recorded forces in the axes of the work [N], shape (row, 3).

    Args:
        force: As recorded [N], shape (row, 3); NaN where not measured.
        axes: For each axis of the work the recorded one, such as "-y".
    """
    signs = np.array([-1.0 if name.startswith("-") else 1.0 for name in axes])
    return force[:, ["xyz".index(name[-1]) for name in axes]] * signs[None]


@dataclasses.dataclass(frozen=True)
class AxesCandidate:
    """One assignment of recorded to simulated axes, with its evidence.

    Attributes:
        matrix: Turns recorded into simulated forces: F = matrix @ F_recorded, one
            1 or -1 in each row and column, shape (3, 3).
        label: The same in words, such as `x = -Fy, y = +Fx, z = +Fz`.
        is_mirrored: Whether the recorded axes are left-handed in the simulation's.
        score: Relative residual plus penalties of violations; less is better.
        residual: Root of the share of the force's square that the fit leaves, 0 to 1.
        coefficients: K_tc, K_rc, K_ac [Pa], K_te, K_re, K_ae [N/m] of this fit.
        radial_ratio: Radial over tangential force, edge forces included.
        violations: Signs and ratios that physics forbids, in words.
        time_shift: By how much the record lags behind the simulation [s].
        phase_error: Phase of the record less that of the fit at the tooth-passing
            frequency [rad], shape (3,); NaN without that frequency, or where not
            measured.
        mean_recorded: Mean of the assigned record [N], shape (3,); NaN where not
            measured.
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

    @property
    def axes(self) -> tuple[str, str, str]:
        """For each axis of the simulation the recorded one, such as "-y"."""
        return axes_names(self.matrix)


@dataclasses.dataclass(frozen=True)
class AxesProposal:
    """Assignments of the axes, the likeliest first; nothing has been applied.

    Attributes:
        proposals: The best signs of each of the six permutations, best first.
        candidates: All 48 signed permutations, best first.
        is_clear: Whether the best is better than every other by more than 0.05 in
            score, those apart that differ only in the sign of z or of a channel that
            was not measured.
        evidence: Evidence for the best, one sentence each.
    """

    proposals: tuple[AxesCandidate, ...]
    candidates: tuple[AxesCandidate, ...]
    is_clear: bool
    evidence: tuple[str, ...]

    def candidate(self, axes: Sequence[str]) -> AxesCandidate:
        """The candidate with some axes."""
        return next(one for one in self.candidates if one.axes == tuple(axes))

    def for_right_handed_axes(self) -> "AxesProposal":
        """Proposal where the record is known to be the force on the tool.

        Axes that are left-handed in those of the simulation are then unlikely.
        """
        return proposal_of(
            tuple(
                dataclasses.replace(
                    one, score=one.score + _LEFT_HANDED * one.is_mirrored
                )
                for one in self.candidates
            )
        )


def combine_axes_proposals(proposals: Sequence[AxesProposal]) -> AxesProposal:
    """Proposal of the axes by several records of one dynamometer.

    Scores and residuals are averaged; the other evidence of each assignment is that
    of the first record.

    Args:
        proposals: One per record.

    Returns:
        The proposal.

    Raises:
        ValueError: There are none.
    """
    if not proposals:
        raise ValueError("Argument `proposals` must have at least one, but is empty.")
    by_label = [{c.label: c for c in one.candidates} for one in proposals]
    merged = []
    for label, first in by_label[0].items():
        alike = [candidates[label] for candidates in by_label]
        merged.append(
            dataclasses.replace(
                first,
                score=float(np.mean([c.score for c in alike])),
                residual=float(np.mean([c.residual for c in alike])),
            )
        )
    return proposal_of(tuple(merged))


def axes_rank(score: float, matrix: Float[np.ndarray, "3 3"]) -> tuple[float, bool]:
    """Sorting key of an assignment: its score; z as recorded before z reversed.

    Args:
        score: Of an assignment.
        matrix: Turns recorded into simulated forces, shape (3, 3).
    """
    return round(score, _DIGITS), bool(matrix[2].sum() < 0)


def axes_label(matrix: Float[np.ndarray, "3 3"]) -> str:
    """Assignment in words, such as `x = -Fy, y = +Fx, z = +Fz`.

    Args:
        matrix: Turns recorded into simulated forces, shape (3, 3).
    """
    parts = []
    for axis, row in zip(_AXES, matrix, strict=True):
        channel = int(np.argmax(np.abs(row)))
        parts.append(f"{axis} = {'+' if row[channel] > 0 else '-'}F{_AXES[channel]}")
    return ", ".join(parts)


def proposal_of(candidates: tuple[AxesCandidate, ...]) -> AxesProposal:
    """Candidates in order, the six proposals, and the evidence.

    Args:
        candidates: All 48, in any order.
    """
    ranked = tuple(sorted(candidates, key=lambda x: axes_rank(x.score, x.matrix)))
    best = ranked[0]
    of_order: dict[tuple[int, ...], AxesCandidate] = {}
    for candidate in ranked:
        order = tuple(np.argmax(np.abs(candidate.matrix), axis=1).tolist())
        of_order.setdefault(order, candidate)
    # No record shows the sign of what it has not measured.
    is_shown = np.isfinite(best.mean_recorded) & (np.arange(3) < 2)
    rivals = [
        other
        for other in ranked[1:]
        if not np.array_equal(np.abs(other.matrix), np.abs(best.matrix))
        or not np.array_equal(other.matrix[is_shown], best.matrix[is_shown])
    ]
    margin = rivals[0].score - best.score
    return AxesProposal(
        tuple(of_order.values()),
        ranked,
        margin > _CLEAR,
        (*_evidence(best, rivals[0]), *_sign_of_z(ranked)),
    )


def _sign_of_z(ranked: Sequence[AxesCandidate]) -> tuple[str, ...]:
    """Reason for the sign of z of the likeliest axes."""
    best = ranked[0]
    if not np.isfinite(best.mean_recorded[2]):
        return ("There is no channel for z.",)
    reverse = np.diag([1.0, 1.0, -1.0])
    twin = next(c for c in ranked if np.array_equal(c.matrix, reverse @ best.matrix))
    against = [text for text in twin.violations if text not in best.violations]
    if round(twin.score - best.score, _DIGITS) == 0:
        reason = "it is as recorded"
    elif against:
        reason = f"with the other one {'; '.join(against)}"
    else:
        reason = "the other one makes the axes left-handed"
    return (f"No fit shows the sign of z: {reason}.",)


def _evidence(best: AxesCandidate, rival: AxesCandidate) -> tuple[str, ...]:
    seen = np.isfinite(best.mean_recorded)
    signs, fitted = (
        [
            "+-"[int(mean < 0)] if known else "?"
            for mean, known in zip(means, seen, strict=True)
        ]
        for means in (best.mean_recorded, best.mean_fitted)
    )
    lines = [
        f"{best.label}: the fit leaves {best.residual:.3f} of the force; the next, "
        f"{rival.label}, leaves {rival.residual:.3f} (scores {best.score:.3f} and "
        f"{rival.score:.3f}).",
        f"Radial over tangential force is {best.radial_ratio:.3f}.",
        f"The means have the signs {' '.join(signs)}, the fit's {' '.join(fitted)}.",
    ]
    if best.is_mirrored:
        lines.append("The recorded axes are left-handed in those of the simulation.")
    phases = np.rad2deg(best.phase_error[seen])
    if np.all(np.isfinite(phases)):
        degrees = ", ".join(f"{value:.1f}" for value in phases)
        lines.append(
            f"At the tooth-passing frequency the record leads the fit by {degrees} deg."
        )
    lines += [f"Against it: {violation}." for violation in best.violations]
    return tuple(lines)
