"""Workspace of the arm, and its stiffness there."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._kinematics.forward import forward_kinematics
from .._kinematics.inverse import inverse_kinematics
from .._model.robot import JointVector, Robot, joint_vector
from .compliance import principal_stiffness

# Random poses that tell the extent of the workspace.
_SAMPLES = 4096
# Poses that are solved at a time.
_BATCH = 512


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
        """Return the least stiffness of the tip on a plane through a pose.

        The plane is parallel to two base axes; the tool keeps its direction. Inverse
        kinematics starts at the pose, then, where that failed, at what was found
        nearest: another branch of the arm may reach what is not found here.

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
        # A coarse look first: where the tool keeps its direction is less than all it
        # reaches.
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
        """Return the indices of the axes of a plane such as "xz"."""
        return ["xyz".index(axis) for axis in plane]

    @staticmethod
    def reach_box(robot: Robot) -> Float[np.ndarray, "2 3"]:
        """Return the corners of a box around what the tool reaches, by random poses.

        Joints without limits turn half a turn and slide 1 m either way.

        Args:
            robot: The robot.

        Returns:
            Least and greatest coordinates of the tool in base [m], shape (2, 3).

        **Differentiability**: none; random poses, always the same ones.
        """
        slides = np.array([kind == "prismatic" for kind in robot.joint_kinds])
        half = np.where(slides, 1.0, np.pi)
        home = np.asarray(robot.home, float)
        lower, upper = np.asarray(robot.joint_lower), np.asarray(robot.joint_upper)
        lower = np.where(np.isfinite(lower), lower, home - half)
        upper = np.where(np.isfinite(upper), upper, home + half)
        share = np.random.default_rng(0).random((_SAMPLES, robot.joint_count))
        # A slide reaches farthest at its ends, a turn anywhere.
        share = np.where(slides, np.round(share), share)
        q = np.where(robot.motor_mask(), lower + share * (upper - lower), 0.0)
        tips = np.asarray(_tips(robot, jnp.asarray(q, robot.dtype)))
        return np.stack([tips.min(axis=0), tips.max(axis=0)]).astype(float)


def _through(
    point: float, lower: float, upper: float, spacing: float
) -> Float[np.ndarray, " point"]:
    """Return evenly spaced coordinates from `lower` to `upper`, one on the point."""
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
    """Return the least stiffness on a grid, NaN where a pose is not reached."""
    across, up = np.meshgrid(columns, rows)
    Ts = np.broadcast_to(T, (across.size, 4, 4)).copy()
    i, j = StiffnessMap.axes_of(plane)
    Ts[:, i, 3], Ts[:, j, 3] = across.ravel(), up.ravel()
    starts = np.broadcast_to(np.asarray(start), (across.size, start.shape[0]))
    found = _solve(robot, Ts, starts)
    q, stiffness = np.asarray(found.q), np.asarray(found.stiffness)
    is_reached = np.isfinite(q).all(axis=1)
    good, left = np.flatnonzero(is_reached), np.flatnonzero(~is_reached)
    if good.size and left.size:
        tips = Ts[:, :3, 3]
        apart = np.linalg.norm(tips[left][:, None] - tips[good][None], axis=-1)
        near = q[good[np.argmin(apart, axis=1)]]
        stiffness[left] = _solve(robot, Ts[left], near).stiffness
    return stiffness.reshape(across.shape)


class _Poses(NamedTuple):
    """Joint positions [rad or m] and least stiffness [N/m]; NaN out of reach."""

    q: Float[Array, "pose joint"] | Float[np.ndarray, "pose joint"]
    stiffness: Float[Array, " pose"] | Float[np.ndarray, " pose"]


def _solve(
    robot: Robot,
    Ts: Float[np.ndarray, "pose 4 4"],
    starts: Float[np.ndarray, "pose joint"],
) -> _Poses:
    """Return the solved poses, on the host."""
    count = Ts.shape[0]
    # Batches of one size need one compilation.
    rows = np.arange(-(-count // _BATCH) * _BATCH) % count
    parts = [
        _poses(
            robot, jnp.asarray(Ts[k], robot.dtype), jnp.asarray(starts[k], robot.dtype)
        )
        for k in np.split(rows, len(rows) // _BATCH)
    ]
    joined = lambda rows: np.concatenate([np.asarray(row, float) for row in rows])
    return _Poses(
        joined([part.q for part in parts])[:count],
        joined([part.stiffness for part in parts])[:count],
    )


@jax.jit
def _tips(robot: Robot, q: Float[Array, "pose joint"]) -> Float[Array, "pose 3"]:
    return jax.vmap(lambda row: forward_kinematics(robot, row)[:3, 3])(q)


@jax.jit
def _poses(
    robot: Robot, Ts: Float[Array, "pose 4 4"], starts: Float[Array, "pose joint"]
) -> _Poses:
    def one(T, start):
        found = inverse_kinematics(robot, T, start, attempts=1)
        is_reached = found.converged & found.within_limits
        stiffness = principal_stiffness(robot, found.q)[0]
        return _Poses(
            jnp.where(is_reached, found.q, jnp.nan),
            jnp.where(is_reached, stiffness, jnp.nan),
        )

    return jax.vmap(one)(Ts, starts)
