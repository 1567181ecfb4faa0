"""Link errors of a robot from poses measured under a tracker."""

import dataclasses

import numpy as np
from jaxtyping import Float

from ...robot import Robot
from .._kinematics.ambiguity import Ambiguities, ambiguities, independent_parameters
from .._kinematics.cross_validation import CrossValidatedPoses, leave_poses_out
from .._kinematics.fit_kinematics import InstrumentNoise, KinematicFit, fit_kinematics
from .._kinematics.model import (
    KinematicModel,
    MeasuredPoses,
    placed_instrument,
    weight_sag,
)
from .._kinematics.parameters import ErrorSizes, all_parameters
from .._kinematics.pose_design import PoseDesign, suggest_poses
from .._record.record import MeasuredChannel
from .study import OnProgress, StudyError, silent

# Poses without which nothing is fitted.
_LEAST_POSES = 10


@dataclasses.dataclass(frozen=True)
class KinematicStudyFit:
    """Link errors with their checks.

    Attributes:
        fit: The errors.
        cross_validated: Each pose predicted by the others, before and after.
        ambiguities: What the poses do not tell.
        advice: Poses that would help most.
    """

    fit: KinematicFit
    cross_validated: CrossValidatedPoses
    ambiguities: Ambiguities
    advice: PoseDesign

    @property
    def is_better(self) -> bool:
        """True if the errors predict poses that were left out better than none do."""
        before, after = (
            np.median(self.cross_validated.lengths(residual))
            for residual in (self.cross_validated.before, self.cross_validated.after)
        )
        return bool(after < before)


@dataclasses.dataclass(frozen=True)
class KinematicStudy:
    """Poses of a robot, measured under a tracker, by a ball bar or a wire.

    Attributes:
        name: The file.
        robot: The robot as stated, its tool where it was measured.
        poses: What was measured.
        noise: Of the instrument, the robot's repeatability in it.
        sizes: Of the errors beforehand.
        fixed_point: In `base`, roughly, from which distances count [m], shape (3,);
            None for positions and frames.
        has_waves: Whether gears may turn unevenly.
        waves_per_turn: Waves of a gear in a turn of its joint.
        has_all_parameters: Whether each joint has six errors; else those alone that
            poses can separate.
        is_gravity_compensated: Whether the controller takes the arm's sag away.
        has_process: Whether a Gaussian process on what is left is tried.
        folds: Parts of the poses, each of which is predicted by the others.
        rows: Number of each pose in the table, from 1.
        notes: What was assumed.
        channels: The columns that were read; none where a script gives the numbers.
        kind: Kind of the measurements.
        Fit: Result of `run`.
        Poses: Class of `poses`.
        Noise: Class of `noise`.
        Sizes: Class of `sizes`.
    """

    name: str
    robot: Robot
    poses: MeasuredPoses
    noise: InstrumentNoise
    sizes: ErrorSizes = dataclasses.field(default_factory=ErrorSizes)
    fixed_point: Float[np.ndarray, " 3"] | None = None
    has_waves: bool = False
    waves_per_turn: float = 1.0
    has_all_parameters: bool = True
    is_gravity_compensated: bool = True
    has_process: bool = False
    folds: int = 5
    rows: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()
    channels: tuple[MeasuredChannel, ...] = ()
    kind = "kinematics"
    Fit = KinematicStudyFit
    Poses = MeasuredPoses
    Noise = InstrumentNoise
    Sizes = ErrorSizes

    def loaded_poses(self) -> MeasuredPoses:
        """Poses with the sag of the arm under its own weight."""
        if self.is_gravity_compensated:
            return self.poses
        sag = weight_sag(self.robot, self.poses.q)
        return dataclasses.replace(self.poses, sag=sag)

    def model(self, poses: MeasuredPoses) -> KinematicModel:
        """Robot under the instrument, with the unknowns.

        Args:
            poses: The poses, with their sag.
        """
        placed = placed_instrument(self.robot, poses)
        point = np.zeros(3) if self.fixed_point is None else self.fixed_point
        parameters = all_parameters(
            self.robot, self.sizes, poses.observed, has_waves=self.has_waves
        )
        model = KinematicModel(
            placed.robot, placed.T_base, point, parameters, self.waves_per_turn
        )
        if self.has_all_parameters:
            return model
        parameters = independent_parameters(model, poses)
        return dataclasses.replace(model, parameters=parameters)

    def fit(self) -> KinematicFit:
        """Fit of the errors without its checks.

        Raises:
            StudyError: There are too few poses.
        """
        count = len(self.poses.q)
        least = max(_LEAST_POSES, self.folds)
        if count < least:
            raise StudyError(
                f"{self.name}: found {count} poses, but at least {least} are required."
            )
        poses = self.loaded_poses()
        return fit_kinematics(self.model(poses), poses, self.noise)

    def run(self, on_progress: OnProgress = silent) -> KinematicStudyFit:
        """Fit the errors, predict poses that are left out, and look for further ones.

        Args:
            on_progress: Receives a line about each step.

        Raises:
            StudyError: There are too few poses.
        """
        on_progress("link errors")
        fit, poses = self.fit(), self.loaded_poses()
        on_progress("poses that are left out")
        cross_validated = leave_poses_out(
            fit, poses, self.noise, folds=self.folds, has_process=self.has_process
        )
        on_progress("what the poses leave open")
        unknown = ambiguities(fit, poses)
        return KinematicStudyFit(
            fit, cross_validated, unknown, suggest_poses(fit, poses)
        )
