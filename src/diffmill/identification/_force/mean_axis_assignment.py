"""Assignment of a dynamometer's axes from mean forces over several feeds.

Lines fit any assignment of the axes alike; what tells them apart is the sign pattern
of the coefficients and the ratio of radial to tangential force.
"""

import dataclasses
import itertools
import math

import numpy as np

from .._alignment.axis_assignment import signed_permutations
from .._alignment.axis_proposal import axes_names
from .mean_force import FeedRows, FeedValues, MeanForceFit, fit_mean_forces

# Violations of physics with the penalties that they add to the score of an assignment.
_PENALTIES = {
    "K_tc is not positive": 4.0,
    "K_rc is negative": 3.0,
    "K_rc over K_tc is outside 0.1 to 1": 2.0,
    "the mean tangential force is not positive": 2.0,
    "the mean radial force is not positive": 2.0,
    "K_te is negative": 1.0,
    "K_re is negative": 1.0,
}
# The axial force of straight flutes is taken to push toward the shank, that of a helix
# along its hand; that one decides only where nothing else can.
_AXIAL = {
    0: {"the mean axial force is negative": 0.5, "K_ac is negative": 0.25},
    1: {"the mean axial force is positive, unlike a right-hand helix": 0.1},
    -1: {"the mean axial force is negative, unlike a left-hand helix": 0.1},
}
_LEFT_HANDED = {"the recorded axes are left-handed": 0.15}
# A coefficient may be this many standard errors below zero by chance.
_CHANCE = 2.0


@dataclasses.dataclass(frozen=True)
class MeanAxes:
    """One assignment of the axes, with its violations of physics.

    Attributes:
        axes: For each axis of the feed frame the recorded one, with its sign.
        score: Sum of the penalties; less is better.
        violations: Signs and ratios that physics forbids, in words.
        fit: The fit under this assignment.
    """

    axes: tuple[str, str, str]
    score: float
    violations: tuple[str, ...]
    fit: MeanForceFit


def propose_mean_axes(
    feed_per_tooth: FeedValues,
    mean_force: FeedRows,
    *,
    teeth: int,
    axial_depth: float,
    entry_angle: float = 0.0,
    exit_angle: float = math.pi,
    helix_angle: float = 0.0,
    is_right_handed: bool = False,
) -> tuple[MeanAxes, ...]:
    """Assignments of the axes, the likeliest first.

    Args:
        feed_per_tooth: f_z of each cut [m], shape (feed,).
        mean_force: Mean force as recorded [N], shape (feed, 3).
        teeth: Number of teeth.
        axial_depth: a_p [m].
        entry_angle: [rad]; 0 for a slot.
        exit_angle: [rad]; pi for a slot.
        helix_angle: Of the cutter, positive for a right-hand helix [rad].
        is_right_handed: Whether the recorded force is known to be that on the tool, so
            that left-handed axes are unlikely.

    Returns:
        All 48 signed permutations; nothing is applied. Several may score alike: then
        the means do not tell.

    Raises:
        ValueError: As `fit_mean_forces`.
    """
    mean = np.array(mean_force, np.float64)
    feeds = np.array(feed_per_tooth, np.float64)
    proposals, hand = [], int(np.sign(helix_angle))
    for matrix in signed_permutations():
        fit = fit_mean_forces(
            feeds,
            mean @ matrix.T,
            teeth=teeth,
            axial_depth=axial_depth,
            entry_angle=entry_angle,
            exit_angle=exit_angle,
        )
        violations = _violations(fit, float(feeds.mean()), hand)
        if is_right_handed and np.linalg.det(matrix) < 0:
            violations |= _LEFT_HANDED
        score = float(sum(violations.values()))
        axes = axes_names(matrix)
        proposals.append(MeanAxes(axes, score, tuple(violations), fit))

    def rank(one: MeanAxes) -> tuple[float, bool, int]:
        # Among equals the one that changes least; dynamometers lie flat, z along z.
        changes = sum(name != axis for name, axis in zip(one.axes, "xyz", strict=True))
        return one.score, one.axes[2][-1] != "z", changes

    return tuple(sorted(proposals, key=rank))


def _violations(fit: MeanForceFit, feed: float, hand: int) -> dict[str, float]:
    """Violations of physics by a fit, with their penalties.

    Args:
        fit: The fit.
        feed: Mean feed per tooth [m].
        hand: 1 for a right-hand helix, -1 for a left-hand one, 0 for straight flutes.
    """
    K, error = fit.coefficients, fit.standard_errors

    def below(name: str) -> bool:
        slack = _CHANCE * error[name] if np.isfinite(error[name]) else 0.0
        return K[name] < -slack

    mean = {i: K[f"K_{i}c"] * 0.64 * feed + K[f"K_{i}e"] for i in "tra"}
    ratio = K["K_rc"] / K["K_tc"] if K["K_tc"] > 0 else math.nan
    tests = (
        K["K_tc"] <= 0,
        below("K_rc"),
        not 0.1 <= ratio <= 1.0,
        mean["t"] <= 0,
        mean["r"] <= 0,
        below("K_te"),
        below("K_re"),
        *((mean["a"] * hand > 0,) if hand else (mean["a"] < 0, below("K_ac"))),
    )
    penalties = {**_PENALTIES, **_AXIAL[hand]}
    return dict(itertools.compress(penalties.items(), tests))
