"""Workspace of the arm, and its stiffness there."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._kinematics.forward import forward_kinematics
from .._kinematics.inverse import inverse_kinematics
from .._model.robot import JointVector, Robot, joint_vector
from .compliance import principal_stiffness

# Number of random poses that tell the extent of the workspace.
_SAMPLE_COUNT = 4096
# Number of poses that are solved at a time.
_BATCH_SIZE = 512


class StiffnessMap(eqx.Module):
    """Stiffness on a plane through a pose, the tool keeping its direction.

    Attributes:
        across: Coordinates along the plane's first axis [m], shape (across,).
        up: Coordinates along its second axis [m], shape (up,).
        stiffness: Least principal stiffness of the tip [N/m], shape (up, across);
            NaN where the pose was not reached within the joints' limits, infinite
            for a rigid arm.
        plane: The two base axes, across and up, such as "xz".
    """

    across: Float[np.ndarray, " across"]
    up: Float[np.ndarray, " up"]
    stiffness: Float[np.ndarray, "up across"]
    plane: str = eqx.field(static=True)

    @classmethod
    def around(
        cls,
        robot: Robot,
        q: JointVector,
        *,
        plane: str = "xz",
        count: int = 49,
    ) -> "StiffnessMap":
        """Least stiffness of the tip on a plane through a pose.

        The plane is parallel to two base axes; the tool keeps its direction. Inverse
        kinematics starts at the pose, then, where that failed, at the nearest solution:
        another branch of the arm may reach poses that are missing here.

        Args:
            robot: The robot.
            q: Joint positions of the pose [rad or m], shape (joint,).
            plane: The two base axes, across and up.
            count: Points along the longer side.

        Returns:
            The map.

        Raises:
            ValueError: If `plane` is not two different base axes, or the robot does not
                move in it, or `count` is below 2.

        **Differentiability**: none; `principal_stiffness` is differentiable.
        """
        if len(plane) != 2 or len(set(plane)) != 2 or not set(plane) <= set("xyz"):
            raise ValueError(
                "Argument `plane` must be two different ones of x, y, z, such as "
                f'"xz", but is {plane!r}.'
            )
        if count < 2:
            raise ValueError(f"Argument `count` must be at least 2, but is {count}.")
        start = joint_vector(robot, q, "q")
        T = np.asarray(forward_kinematics(robot, start)).astype(float)
        box = StiffnessMap.reach_box(robot)[:, StiffnessMap.axes_of(plane)]
        if not np.max(box[1] - box[0]) > 0:
            raise ValueError(
                "Argument `plane` must be one in which the robot moves, but is "
                f"{plane!r}, in which it does not."
            )
        # A coarse grid first: the tool keeps its direction in a part of its reach only.
        for points in (count // 2 + 1, count):
            spacing = np.max(box[1] - box[0]) / (points - 1)
            axes = [
                _through(T[axis, 3], box[0, i], box[1, i], spacing)
                for i, axis in enumerate(StiffnessMap.axes_of(plane))
            ]
            stiffness = _on_grid(robot, T, start, plane, axes[0], axes[1])
            rows, columns = np.nonzero(~np.isnan(stiffness))
            if not rows.size:
                break
            reached = np.stack([axes[0][columns], axes[1][rows]], axis=-1)
            box = np.stack([reached.min(axis=0), reached.max(axis=0)])
            box = box + spacing * np.array([[-1.0], [1.0]])
        return cls(axes[0], axes[1], stiffness, plane)

    @staticmethod
    def axes_of(plane: str) -> list[int]:
        """Indices of the axes of a plane such as "xz"."""
        return ["xyz".index(axis) for axis in plane]

    @staticmethod
    def reach_box(robot: Robot) -> Float[np.ndarray, "2 3"]:
        """Corners of a box around the tool's reach, by random poses.

        Joints without limits turn half a turn and slide 1 m to either side.

        Args:
            robot: The robot.

        Returns:
            Least and greatest coordinates of the tool in base [m], shape (2, 3).

        **Differentiability**: none; random poses, always the same ones.
        """
        slides = robot.joint_prismatic_mask()
        half = np.where(slides, 1.0, np.pi)
        home = np.asarray(robot.home, float)
        lower, upper = np.asarray(robot.joint_lower), np.asarray(robot.joint_upper)
        lower = np.where(np.isfinite(lower), lower, home - half)
        upper = np.where(np.isfinite(upper), upper, home + half)
        share = np.random.default_rng(0).random((_SAMPLE_COUNT, robot.joint_count))
        # A slide reaches farthest at its ends, a turn anywhere.
        share = np.where(slides, np.round(share), share)
        q = np.where(robot.motor_mask(), lower + share * (upper - lower), 0.0)
        poses = jax.vmap(forward_kinematics, (None, 0))
        tips = np.asarray(poses(robot, jnp.asarray(q, robot.dtype))[:, :3, 3])
        return np.stack([tips.min(axis=0), tips.max(axis=0)]).astype(float)


def _through(
    point: float, lower: float, upper: float, spacing: float
) -> Float[np.ndarray, " point"]:
    """Evenly spaced coordinates from `lower` to `upper`, one on the point [m]."""
    first = np.floor(min(lower - point, 0.0) / spacing)
    last = np.ceil(max(upper - point, 0.0) / spacing)
    return float(point) + spacing * np.arange(first, last + 1)


def _on_grid(
    robot: Robot,
    T: Float[np.ndarray, "4 4"],
    start: Float[Array, " joint"],
    plane: str,
    columns: Float[np.ndarray, " across"],
    rows: Float[np.ndarray, " up"],
) -> Float[np.ndarray, "up across"]:
    """Least stiffness on a grid [N/m], NaN where a pose is not reached."""
    across, up = np.meshgrid(columns, rows)
    Ts = np.broadcast_to(T, (across.size, 4, 4)).copy()
    i, j = StiffnessMap.axes_of(plane)
    Ts[:, i, 3], Ts[:, j, 3] = across.ravel(), up.ravel()
    starts = np.broadcast_to(np.asarray(start), (across.size, start.shape[0]))
    q, stiffness = _solve(robot, Ts, starts)
    is_reached = np.isfinite(q).all(axis=1)
    reached, missed = np.flatnonzero(is_reached), np.flatnonzero(~is_reached)
    if reached.size and missed.size:
        tips = Ts[:, :3, 3]
        apart = np.linalg.norm(tips[missed][:, None] - tips[reached][None], axis=-1)
        near = q[reached[np.argmin(apart, axis=1)]]
        _, stiffness[missed] = _solve(robot, Ts[missed], near)
    return stiffness.reshape(across.shape)


def _solve(
    robot: Robot,
    Ts: Float[np.ndarray, "pose 4 4"],
    starts: Float[np.ndarray, "pose joint"],
) -> tuple[Float[np.ndarray, "pose joint"], Float[np.ndarray, " pose"]]:
    """Joint positions [rad or m] and least stiffness [N/m]; NaN out of reach."""
    count = Ts.shape[0]
    # Batches of one size need one compilation.
    rows = np.arange(-(-count // _BATCH_SIZE) * _BATCH_SIZE) % count
    parts = [
        _solve_batch(
            robot, jnp.asarray(Ts[k], robot.dtype), jnp.asarray(starts[k], robot.dtype)
        )
        for k in np.split(rows, len(rows) // _BATCH_SIZE)
    ]
    joined = lambda rows: np.concatenate([np.asarray(row, float) for row in rows])
    q, stiffness = (joined(rows)[:count] for rows in zip(*parts, strict=True))
    return q, stiffness


@jax.jit
def _solve_batch(
    robot: Robot, Ts: Float[Array, "pose 4 4"], starts: Float[Array, "pose joint"]
) -> tuple[Float[Array, "pose joint"], Float[Array, " pose"]]:
    def one(T, start):
        solution = inverse_kinematics(robot, T, start, attempts=1)
        is_reached = solution.converged & solution.within_limits
        stiffness = principal_stiffness(robot, solution.q)[0]
        return (
            jnp.where(is_reached, solution.q, jnp.nan),
            jnp.where(is_reached, stiffness, jnp.nan),
        )

    return jax.vmap(one)(Ts, starts)
