"""Gaussian process on what link errors leave, as a function of the joints.

    r(q) ~ GP(0, s^2 exp(-|f(q) - f(q')|^2 / 2 l^2) + noise),

f(q) sine and cosine of the turning joints, and slides over their range; all components
share it. Length scale and share of the noise are those of the least error of each pose
predicted by the others, in closed form: Rasmussen and Williams, Gaussian Processes for
Machine Learning, 2006, eq. (5.12).
"""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...robot import Robot

# Length scales of the features, and variances of the noise over that of the process.
_LENGTHS = (0.3, 0.6, 1.0, 2.0)
_NOISES = (0.02, 0.1, 0.5, 2.0)


class ResidualProcess(eqx.Module):
    """Residual as a function of the joints.

    Attributes:
        features: Of the poses that it knows, shape (pose, feature).
        weights: Of these, shape (pose, component).
        length: Its length scale [-].
        noise: Variance of the noise over that of the process [-].
    """

    features: Float[np.ndarray, "pose feature"]
    weights: Float[np.ndarray, "pose component"]
    length: float
    noise: float

    @classmethod
    def fit(
        cls,
        features: Float[np.ndarray, "pose feature"],
        residual: Float[np.ndarray, "pose component"],
    ) -> "ResidualProcess":
        """Process with the least error of poses predicted by the others.

        Args:
            features: Of the poses, see `joint_features`.
            residual: [m], shape (pose, component).
        """
        square = _squares(features, features)
        best = None
        for length in _LENGTHS:
            values, V = np.linalg.eigh(np.exp(-square / (2 * length**2)))
            turned = V.T @ residual
            for noise in _NOISES:
                inverse = 1.0 / (np.maximum(values, 0.0) + noise)
                weights = V @ (inverse[:, None] * turned)
                left = weights / (V**2 @ inverse)[:, None]
                error = float(np.mean(np.linalg.norm(left, axis=1)))
                if best is None or error < best[0]:
                    best = error, cls(features, weights, length, noise)
        assert best is not None
        return best[1]

    def predict(
        self, features: Float[np.ndarray, "other feature"]
    ) -> Float[np.ndarray, "other component"]:
        """Residual at other poses [m], shape (other, component)."""
        square = _squares(features, self.features)
        return np.exp(-square / (2 * self.length**2)) @ self.weights


def joint_features(
    robot: Robot, q: Float[np.ndarray, "pose joint"]
) -> Float[np.ndarray, "pose feature"]:
    """Features of joint positions: sine and cosine of turns, slides over their spread.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (pose, joint).
    """
    slides = robot.joint_prismatic_mask()
    span = np.maximum(np.ptp(q[:, slides], axis=0), 1e-9)
    turns = q[:, ~slides]
    return np.hstack([np.sin(turns), np.cos(turns), q[:, slides] / span[None]])


def _squares(
    one: Float[np.ndarray, "a feature"], other: Float[np.ndarray, "b feature"]
) -> Float[np.ndarray, "a b"]:
    """Squared distances between features."""
    return np.sum((one[:, None] - other[None]) ** 2, axis=-1)
