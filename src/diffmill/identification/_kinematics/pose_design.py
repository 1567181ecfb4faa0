"""Poses that would tell most of what measured poses have left open.

D-optimal, one after the other: of random poses within the joints' limits the one with
the largest log det(I + A P A^T), by which it lessens the volume of the unknowns'
covariance P. Pazman, Foundations of Optimum Experimental Design, 1986.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .ambiguity import at_poses, candidate_poses, scaled_slopes
from .fit_kinematics import KinematicFit
from .model import MeasuredPoses


class PoseDesign(eqx.Module):
    """Poses to add to those that were measured.

    Attributes:
        q: Joint positions [rad or m], shape (pose, joint).
        tip_error: Standard deviation of the first coordinates that are measured at
            random poses within the limits, root mean square [m], of the fit.
        tip_error_with: The same with the poses added.
    """

    q: Float[np.ndarray, "pose joint"]
    tip_error: float
    tip_error_with: float


def suggest_poses(
    fit: KinematicFit, poses: MeasuredPoses, *, count: int = 5
) -> PoseDesign:
    """Poses that would help most, measured as the others were.

    No pose is proposed twice. Collisions are not checked, nor what the instrument can
    see.

    Args:
        fit: The fit.
        poses: What it was fitted to.
        count: Number of poses to add.
    """
    q = candidate_poses(fit.model)
    A = scaled_slopes(fit, at_poses(q, poses))
    sizes = fit.model.sizes
    P = fit.covariance / sizes[:, None] / sizes[None]
    before, chosen = _tip_error(A, P, fit), []
    for _ in range(count):
        S = np.eye(A.shape[1])[None] + np.einsum("pci,ij,pdj->pcd", A, P, A)
        gain = np.linalg.slogdet(S)[1]
        gain[chosen] = -np.inf
        best = int(np.argmax(gain))
        chosen.append(best)
        K = np.linalg.solve(S[best], A[best] @ P)
        P = P - (A[best] @ P).T @ K
    return PoseDesign(q[chosen], before, _tip_error(A, P, fit))


def _tip_error(
    A: Float[np.ndarray, "pose component unknown"],
    P: Float[np.ndarray, "unknown unknown"],
    fit: KinematicFit,
) -> float:
    """Root mean square standard deviation of a length at poses [m]."""
    lengths = A[:, :3]
    variance = np.einsum("pci,ij,pcj->pc", lengths, P, lengths)
    return float(fit.spread[0] * np.sqrt(np.mean(variance)))
