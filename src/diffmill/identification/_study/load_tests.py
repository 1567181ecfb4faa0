"""Joint stiffness from load tests."""

import dataclasses

import numpy as np
from jaxtyping import Float

from ...robot import Robot
from .._record.record import MeasuredChannel
from .._stiffness.axis_check import Turns
from .._stiffness.cross_validation import LoadCheck, check_load_tests
from .._stiffness.experiment_design import LoadTests, suggest_load_tests
from .._stiffness.joint_stiffness import JointStiffnessFit, fit_joint_stiffness
from .study import OnProgress, StudyError, silent

# All springs this many times stiffer or softer than the model's: a unit is wrong.
_UNIT_FACTOR = 30.0


@dataclasses.dataclass(frozen=True)
class LoadTestStudyFit:
    """Joint stiffness, with its checks.

    Attributes:
        fit: The springs.
        check: Each test predicted by the others.
        advice: Tests that would show what these do not; None if nothing is rough, the
            table does not suit the robot, or the model has no start for them.
        lacks_model: Whether a joint that is sought has no stiffness in the model, so
            that there is no advice.
        unit_ratio: How many times the model's the stiffness is if a unit may be wrong,
            else 1.
        relative_uncertainty: An equal error of all joints that makes the displacement
            as uncertain; NaN if no joint is known.
    """

    fit: JointStiffnessFit
    check: LoadCheck
    advice: LoadTests | None
    lacks_model: bool
    unit_ratio: float
    relative_uncertainty: float


@dataclasses.dataclass(frozen=True)
class LoadTestStudy:
    """Static load tests.

    Attributes:
        name: The file.
        robot: The robot with its tool.
        q: Joint positions [rad or m], shape (pose, joint).
        wrench: In base axes at the tool [N, N m], shape (pose, 6).
        displacement: As recorded [m, rad], shape (pose, 3) or (pose, 6); NaN for a
            component that was not measured.
        load_frame: Rotations into base of the frame in which the load was recorded,
            shape (pose, 3, 3), or None for base.
        displacement_frame: Rotations into base of the axes of `displacement`, likewise.
        rows: Number of each row in the table, from 1.
        has_offset: Whether a constant displacement is fitted too.
        noise: "absolute", "relative" or None.
        notes: What was assumed.
        channels: The columns that were read; none where a script gives the numbers.
        kind: Kind of the measurements.
        Fit: Result of `run`.
    """

    name: str
    robot: Robot
    q: Float[np.ndarray, "pose joint"]
    wrench: Float[np.ndarray, "pose 6"]
    displacement: Float[np.ndarray, "pose component"]
    load_frame: Turns | None
    displacement_frame: Turns | None
    rows: tuple[int, ...]
    has_offset: bool
    noise: str | None
    notes: tuple[str, ...]
    channels: tuple[MeasuredChannel, ...] = ()
    kind = "load_tests"
    Fit = LoadTestStudyFit

    def run(self, on_progress: OnProgress = silent) -> LoadTestStudyFit:
        """Fit the springs and predict each test by the others.

        Args:
            on_progress: Receives a line about each step.

        Raises:
            StudyError: The tests cannot be fitted.
        """
        on_progress("joint stiffness")
        try:
            fit = fit_joint_stiffness(
                self.robot,
                self.q,
                self.wrench,
                self.displacement,
                has_offset=self.has_offset,
                noise=self.noise,
                load_frame=self.load_frame,
                displacement_frame=self.displacement_frame,
            )
        except ValueError as error:
            raise StudyError(f"{self.name}: {error}") from error
        known = fit.identifiable
        model = np.asarray(self.robot.joint_stiffness, np.float64)
        advice, lacks_model = None, False
        if fit.is_rough.any() and fit.is_consistent:
            lacks_model = bool(np.isinf(model[~known]).any())
            if not lacks_model:
                advice = suggest_load_tests(self.robot, fit, self.q, self.wrench)
        part, off = fit.share[known], fit.standard_errors[known] / fit.stiffness[known]
        share = float("nan")
        if known.any():
            share = float(np.linalg.norm(part * off) / np.linalg.norm(part))
        return LoadTestStudyFit(
            fit,
            check_load_tests(
                self.robot,
                fit,
                self.q,
                self.wrench,
                self.displacement,
                displacement_frame=self.displacement_frame,
            ),
            advice,
            lacks_model,
            _unit_ratio(fit, model),
            share,
        )


def _unit_ratio(fit: JointStiffnessFit, model: Float[np.ndarray, " joint"]) -> float:
    """Mean stiffness over that of the model, if a unit may be wrong; else 1."""
    known = fit.identifiable & np.isfinite(model) & (model > 0)
    if not known.any():
        return 1.0
    times = fit.stiffness[known] / model[known]
    if times.min() <= _UNIT_FACTOR and times.max() >= 1 / _UNIT_FACTOR:
        return 1.0
    return float(np.exp(np.mean(np.log(times))))
