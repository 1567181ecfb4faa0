"""Springs, reversals and delays of the joints of a robot."""

import dataclasses

import numpy as np

from ...robot import Robot
from .._reversal.cross_validated import CrossValidatedRecord, choose_repeating
from .._reversal.joint_motion import JointMotion, JointRecord
from .._reversal.joint_reversal import JointReversal
from .._reversal.repeating_error import RepeatingError
from .study import OnProgress, StudyError, silent

# Rows below the cut-off frequency that a record of a joint needs.
_LEAST_ROWS = 100


@dataclasses.dataclass(frozen=True)
class FittedDrive:
    """Drive of a joint, with its checks.

    Attributes:
        joint: Index of the joint.
        drive: The fit to all records.
        repeating: Prior of the error that repeats; None if nothing does.
        cross_validated: Every record, or half of the only one, predicted by the others.
    """

    joint: int
    drive: JointReversal
    repeating: RepeatingError | None
    cross_validated: tuple[CrossValidatedRecord, ...]

    @property
    def repeating_share(self) -> float:
        """Share that repeats of the square of what the drive leaves, left out."""
        left = sum(one.rms[1] ** 2 for one in self.cross_validated)
        return 1.0 - sum(one.rms[2] ** 2 for one in self.cross_validated) / left


@dataclasses.dataclass(frozen=True)
class ReversalStudyFit:
    """Drives of the joints that the records show.

    Attributes:
        drives: Of the joints with both encoders and a torque.
        notes: Joints that are left out.
    """

    drives: tuple[FittedDrive, ...]
    notes: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class ReversalStudy:
    """Records of joints with two encoders.

    Attributes:
        name: The file.
        joint_names: Names of the joints.
        records: The records.
        robot: The robot whose springs stand in for unknown ones; None for none.
        lowpass: Cut-off frequency of all signals [Hz].
        longest_presliding: Longest travel over which friction may build up [rad].
        notes: What was assumed.
        kind: Kind of the measurements.
        Fit: Result of `run`.
        Drive: A joint of it.
    """

    name: str
    joint_names: tuple[str, ...]
    records: tuple[JointRecord, ...]
    robot: Robot | None = None
    lowpass: float = 10.0
    longest_presliding: float = 2e-3
    notes: tuple[str, ...] = ()
    kind = "reversal"
    Fit = ReversalStudyFit
    Drive = FittedDrive

    def run(self, on_progress: OnProgress = silent) -> ReversalStudyFit:
        """Fit every joint that has both encoders and a torque.

        Args:
            on_progress: Receives a line about each step.

        Raises:
            StudyError: No joint has enough of them.
        """
        drives, notes = [], []
        for joint, name in enumerate(self.joint_names):
            motions = [
                JointMotion(one, joint, self.lowpass, self.longest_presliding)
                for one in self.records
                if np.isfinite([one.link[0, joint], one.torque[0, joint]]).all()
            ]
            if not motions:
                continue
            motions = [one for one in motions if one.is_used.sum() >= _LEAST_ROWS]
            if not motions:
                notes.append(
                    f"{name} is left out: no record has {_LEAST_ROWS} rows at "
                    f"{4 * self.lowpass:g} Hz after it has moved by "
                    f"{2e3 * self.longest_presliding:g} mrad."
                )
                continue
            if len({np.sign(x) for m in motions for x in m.bristle(1e-6)}) < 2:
                notes.append(f"{name} is left out: it never turns back.")
                continue
            on_progress(f"{name}: records left out")
            parts = motions if len(motions) > 1 else _halves(motions[0])
            repeating, cross_validated = choose_repeating(parts)
            on_progress(f"{name}: all records")
            drive = JointReversal.of(motions, repeating)
            drives.append(FittedDrive(joint, drive, repeating, cross_validated))
        if not drives:
            raise StudyError(
                " ".join(
                    [
                        f"{self.name}: found no joint whose motor, link and torque "
                        "show a reversal, but one is required.",
                        *notes,
                    ]
                )
            )
        return ReversalStudyFit(tuple(drives), tuple(notes))


def _halves(motion: JointMotion) -> list[JointMotion]:
    """Joint in both halves of its only record."""
    record, middle = motion.record, len(motion.positions) // 2
    halves = [
        dataclasses.replace(
            record,
            name=f"{which} half of {record.name}",
            motor=record.motor[rows],
            link=record.link[rows],
            torque=record.torque[rows],
        )
        for which, rows in (
            ("first", slice(None, middle)),
            ("second", slice(middle, None)),
        )
    ]
    return [dataclasses.replace(motion, record=half) for half in halves]
