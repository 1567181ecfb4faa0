"""Directions of the unknowns that poses leave where the prior has them.

With A the slopes of all that is measured over its scatter, in units of the prior, the
covariance is P = (A^T A + I)^-1: an eigenvalue near 1 is a direction in which the poses
say nothing. Some of these no pose can tell; others more poses would.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .fit_kinematics import KinematicFit
from .model import KinematicModel, MeasuredPoses, residual_slopes
from .parameters import ErrorParameter

# Share of the prior's variance that is left in a direction that counts as open.
_OPEN = 0.5
# Parts of a direction that count in its name, over the largest one.
_NAMED = 0.2
# A column of which so much is left beside the others is one of its own.
_INDEPENDENT = 1e-6
# Half the range of joints without limits [rad or m].
_RANGE = np.pi
# Poses that stand for all that the robot can take.
_POSES = 200


class Ambiguity(eqx.Module):
    """Unknowns of which only a combination is known.

    Attributes:
        names: Of the unknowns, the largest part first.
        shares: How far each goes when the first goes by 1 [m or rad per m or rad].
    """

    names: tuple[str, ...] = eqx.field(static=True)
    shares: tuple[float, ...] = eqx.field(static=True)


class Ambiguities(eqx.Module):
    """Combinations of errors that the poses leave open.

    Attributes:
        structural: What no pose of this robot can tell under this instrument.
        of_poses: What these poses do not tell, but others would.
    """

    structural: tuple[Ambiguity, ...]
    of_poses: tuple[Ambiguity, ...]


def candidate_poses(
    model: KinematicModel, count: int = _POSES, seed: int = 0
) -> Float[np.ndarray, "pose joint"]:
    """Random joint positions within the limits [rad or m], shape (pose, joint)."""
    lower, upper = (
        np.clip(np.asarray(limit, np.float64), -_RANGE, _RANGE)
        for limit in (model.robot.joint_lower, model.robot.joint_upper)
    )
    draw = np.random.default_rng(seed)
    return draw.uniform(lower, upper, (count, len(lower)))


def at_poses(q: Float[np.ndarray, "pose joint"], poses: MeasuredPoses) -> MeasuredPoses:
    """Measurements of an instrument of the same kind elsewhere, numbers left open.

    Args:
        q: Joint positions [rad or m], shape (pose, joint).
        poses: Measured poses, which say what is measured.
    """
    n = len(q)
    return MeasuredPoses(
        q,
        None if poses.position is None else np.zeros((n, 3)),
        None if poses.rotation is None else np.tile(np.eye(3), (n, 1, 1)),
        None if poses.distance is None else np.zeros(n),
    )


def scaled_slopes(
    fit: KinematicFit, poses: MeasuredPoses
) -> Float[np.ndarray, "pose component unknown"]:
    """Slopes over the scatter, in units of the prior, shape (pose, component, unknown).

    Args:
        fit: The fit, which has unknowns, scatter and prior.
        poses: Where; of their numbers only frames count, which are the predicted ones.
    """
    model = fit.model
    x = jnp.asarray(fit.x)
    if poses.rotation is not None:
        # The vector of a rotation is the whole of it for small angles alone.
        Ts = np.asarray(model.tool_poses(x, poses))
        poses = MeasuredPoses(poses.q, Ts[:, :3, 3], Ts[:, :3, :3], sag=poses.sag)
    J = np.asarray(residual_slopes(model, x, poses))
    widths = [part.stop - part.start for part in poses.groups]
    scatter = np.repeat(fit.spread, widths)
    return J / scatter[None, :, None] * model.sizes[None, None]


def ambiguities(fit: KinematicFit, poses: MeasuredPoses) -> Ambiguities:
    """Combinations of errors that measured poses leave open.

    Args:
        fit: The fit to them.
        poses: The poses.
    """
    everywhere = at_poses(candidate_poses(fit.model), poses)
    A = scaled_slopes(fit, everywhere).reshape(-1, len(fit.x))
    open_anywhere = _open_directions(A)
    own = scaled_slopes(fit, poses).reshape(-1, len(fit.x))
    here = _open_directions(own)
    # Parts of the open directions that other poses would close.
    apart = here - open_anywhere @ (open_anywhere.T @ here)
    U, size, _ = np.linalg.svd(apart, full_matrices=False)
    effect = np.linalg.norm(A, axis=0)
    return Ambiguities(
        _named(fit, open_anywhere, effect), _named(fit, U[:, size > 0.5], effect)
    )


def independent_parameters(
    model: KinematicModel, poses: MeasuredPoses
) -> tuple[ErrorParameter, ...]:
    """Unknowns that poses all over the workspace can tell apart, the first ones first.

    As many as the modified parameters of Denavit and Hartenberg (Hayati 1983) with base
    and tool: 4 for each turning joint, 2 for each slide and 6 for frames (Everett,
    Driels and Mooring 1987), 3 less for points.

    Args:
        model: The robot with all unknowns.
        poses: What is measured of a pose.
    """
    x = jnp.zeros(len(model.parameters))
    everywhere = at_poses(candidate_poses(model), poses)
    if poses.rotation is not None:
        Ts = np.asarray(model.tool_poses(x, everywhere))
        everywhere = MeasuredPoses(everywhere.q, Ts[:, :3, 3], Ts[:, :3, :3])
    J = np.asarray(residual_slopes(model, x, everywhere)) * model.sizes[None, None]
    J = J.reshape(-1, len(x))
    taken: list[int] = []
    Q = np.zeros((len(J), 0))
    for i, column in enumerate(J.T):
        # Twice, against rounding (Giraud and Langou 2005).
        left = column - Q @ (Q.T @ column)
        left = left - Q @ (Q.T @ left)
        size = np.linalg.norm(left)
        if size > _INDEPENDENT * np.linalg.norm(column):
            taken.append(i)
            Q = np.hstack([Q, left[:, None] / size])
    return tuple(model.parameters[i] for i in taken)


def _open_directions(A: Float[np.ndarray, "number unknown"]) -> np.ndarray:
    """Orthonormal directions that are left at the prior, shape (unknown, direction)."""
    values, V = np.linalg.eigh(A.T @ A)
    return V[:, 1.0 / (1.0 + np.maximum(values, 0.0)) > _OPEN]


def _named(
    fit: KinematicFit,
    directions: Float[np.ndarray, "unknown direction"],
    effect: Float[np.ndarray, " unknown"],
) -> tuple[Ambiguity, ...]:
    """Directions in words: a basis of as few unknowns each as elimination gives.

    Args:
        fit: The fit.
        directions: They span what is open, in units of the prior.
        effect: What each unknown does to what is measured, in units of the prior.
    """
    # Moved by what they do: an unknown of a wide prior goes a small part of it.
    seen = np.where(effect > 0, effect, 1.0)
    rows = (directions * seen[:, None]).T
    # Pivots by the size of what is left of a column: they do not depend on the basis,
    # nor on rounding.
    left, pivots = rows, []
    for _ in rows:
        size = np.linalg.norm(left, axis=0)
        pivots.append(int(np.argmax(np.round(size / size.max(), 6))))
        axis = left[:, pivots[-1]] / size[pivots[-1]]
        left = left - axis[:, None] * (axis @ left)[None]
    rows = np.linalg.solve(rows[:, pivots], rows) if pivots else rows
    names = [one.name for one in fit.model.parameters]
    found = []
    for row in rows:
        order = np.argsort(-np.abs(row))
        order = order[np.abs(row[order]) > _NAMED * np.abs(row).max()]
        # Below the noise by itself it is open by itself.
        order = order[:1] if effect[order[0]] < 1.0 else order
        moves = row[order] / seen[order] * fit.model.sizes[order]
        shares = tuple((moves / moves[0]).tolist())
        found.append(Ambiguity(tuple(names[j] for j in order), shares))
    return tuple(sorted(found, key=lambda one: one.names))
