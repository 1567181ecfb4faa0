"""Deflection of one record predicted by the others, and what of it repeats."""

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .joint_motion import JointMotion
from .joint_reversal import JointEquations, JointReversal, over_torque_columns
from .repeating_error import RepeatingError

# Lengths of the error that repeats that are tried [rad], and its sizes over what the
# model leaves.
_LENGTHS = tuple(math.radians(x) for x in (2.0, 5.0, 10.0, 20.0, 40.0))
_SIZES = (0.5, 1.5, 5.0)


@dataclasses.dataclass(frozen=True)
class CrossValidatedRecord:
    """A record of a joint as the others predict it, its own offset aside.

    Attributes:
        name: The record.
        positions: Angle of the motor [rad], shape (used,).
        measured: Link less motor without the delay [rad], shape (used,).
        predicted: The same by the drive alone, shape (used,).
        repeated: The same with the error that repeats, shape (used,).
    """

    name: str
    positions: Float[np.ndarray, " used"]
    measured: Float[np.ndarray, " used"]
    predicted: Float[np.ndarray, " used"]
    repeated: Float[np.ndarray, " used"]

    @property
    def rms(self) -> tuple[float, float, float]:
        """Of what was measured, is left by the drive, and is left at last [rad]."""
        parts = (0.0, self.predicted, self.repeated)
        return tuple(float(np.std(self.measured - part)) for part in parts)  # pyright: ignore[reportReturnType]


def choose_repeating(
    motions: Sequence[JointMotion],
) -> tuple[RepeatingError | None, tuple[CrossValidatedRecord, ...]]:
    """Error that repeats with the least error of records that are left out.

    Args:
        motions: The joint in two records at least.

    Returns:
        The prior, None if no record is predicted better by one; and every record as
        the others predict it with that prior.
    """
    folds = []
    for place, one in enumerate(motions):
        others = [*motions[:place], *motions[place + 1 :]]
        folds.append((others, one, JointReversal.of(others, None)))
    plain = []
    for others, one, drive in folds:
        measured = one.deflection(drive.delay.value)
        own = _predicted(others, one, drive, None)
        plain.append(
            CrossValidatedRecord(
                one.record.name, one.angle, measured - measured.mean(), own, own
            )
        )
    left = math.sqrt(np.mean([one.rms[1] ** 2 for one in plain]))
    ends = [end(one.angle) for one in motions for end in (np.min, np.max)]
    best, least = plain, sum(one.rms[2] ** 2 for one in plain)
    chosen = None
    for length, size, by_direction in itertools.product(
        _LENGTHS, _SIZES, (False, True)
    ):
        prior = RepeatingError(
            length, size * left, by_direction, float(min(ends)), float(max(ends))
        )
        tried = [
            dataclasses.replace(one, repeated=_predicted(others, own, drive, prior))
            for one, (others, own, drive) in zip(plain, folds, strict=True)
        ]
        error = sum(one.rms[2] ** 2 for one in tried)
        if error < least:
            chosen, best, least = prior, tried, error
    return chosen, tuple(best)


def _predicted(
    others: Sequence[JointMotion],
    motion: JointMotion,
    drive: JointReversal,
    prior: RepeatingError | None,
) -> Float[np.ndarray, " used"]:
    """Deflection of a record as others predict it, about its mean [rad].

    Args:
        others: The joint in the other records.
        motion: The joint in the one that is left out.
        drive: Fit of the others.
        prior: Error that repeats; None for none.
    """
    z, delay = drive.presliding, drive.delay.value
    x = JointEquations(others, prior).over_torque(z, delay).x
    columns = over_torque_columns([motion], z)[0][:, :-1]
    predicted = columns @ x[: columns.shape[1]]
    if prior is not None:
        bells = prior.columns(motion, z)
        predicted = predicted + bells @ x[-bells.shape[1] :]
    return predicted - predicted.mean()
