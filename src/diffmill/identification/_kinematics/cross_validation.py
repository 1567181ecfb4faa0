"""Error that a calibration leaves on poses that were left out of its fit."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from .fit_kinematics import InstrumentNoise, KinematicFit, fit_kinematics
from .model import KinematicModel, MeasuredPoses
from .residual_process import ResidualProcess, joint_features


@dataclasses.dataclass(frozen=True)
class CrossValidatedPoses:
    """Poses predicted by the others, once each.

    Attributes:
        before: Measured less predicted by the robot as stated, with tool and instrument
            placed by the other poses [m, rad], shape (pose, component).
        after: Measured less predicted by link errors [m, rad], likewise.
        with_process: The same less a Gaussian process on what they leave, or None.
        is_counted: Poses that contradict no others, shape (pose,).
    """

    before: Float[np.ndarray, "pose component"]
    after: Float[np.ndarray, "pose component"]
    with_process: Float[np.ndarray, "pose component"] | None
    is_counted: Bool[np.ndarray, " pose"]

    def lengths(
        self, residual: Float[np.ndarray, "pose component"]
    ) -> Float[np.ndarray, " pose"]:
        """Distances of a residual of the poses that count [m], shape (pose,)."""
        return np.linalg.norm(residual[self.is_counted, :3], axis=1)

    def angles(
        self, residual: Float[np.ndarray, "pose component"]
    ) -> Float[np.ndarray, " pose"]:
        """Angles of a residual of frames [rad], shape (pose,); 0 if none was measured.

        Args:
            residual: Of these poses.
        """
        return np.linalg.norm(residual[self.is_counted, 3:], axis=1)


def leave_poses_out(
    fit: KinematicFit,
    poses: MeasuredPoses,
    noise: InstrumentNoise,
    *,
    folds: int = 5,
    has_process: bool = False,
    seed: int = 0,
) -> CrossValidatedPoses:
    """Predict poses by fits to the others.

    The poses are dealt to the folds at random.

    Args:
        fit: The fit to all of them, from which the others begin.
        poses: What was measured.
        noise: Of the instrument.
        folds: Number of parts, each predicted by the others.
        has_process: Whether a Gaussian process predicts what link errors leave.
        seed: Of the deal.
    """
    model, n = fit.model, len(poses.q)
    placed = KinematicModel(
        model.robot,
        model.T_base,
        model.fixed_point,
        tuple(one for one in model.parameters if one.is_placement),
        model.waves_per_turn,
    )
    fold = np.random.default_rng(seed).permutation(n) % folds
    is_counted = np.ones(n, bool)
    is_counted[list(fit.outliers)] = False
    before, after = np.zeros_like(fit.residual), np.zeros_like(fit.residual)
    with_process = np.zeros_like(fit.residual) if has_process else None
    features = joint_features(model.robot, poses.q)
    for part in range(folds):
        out = fold == part
        used = ~out & is_counted
        nominal = fit_kinematics(placed, poses, noise, is_used=used)
        others = fit_kinematics(model, poses, noise, is_used=used, start=fit.x)
        before[out], after[out] = nominal.residual[out], others.residual[out]
        if with_process is not None:
            process = ResidualProcess.fit(features[used], others.residual[used])
            with_process[out] = after[out] - process.predict(features[out])
    return CrossValidatedPoses(before, after, with_process, is_counted)
