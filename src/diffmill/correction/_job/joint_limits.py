"""Limits of the joints, of the motors' positions that a command asks for.

A row of a tip command asks for motor positions theta(x), whose derivative at the
desired tip is known. To first order an offset B c of the tip keeps

    least <= theta(x) + dtheta/dx (B c) <= most,

which is linear in the coefficients c and concerns only rows from which the largest
offset could reach a limit: of most programs none. The limits are drawn in by what theta
bends over the largest offset, so that the first order is enough.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._arrays import on_device
from ..._job import Job
from ..._types import FloatRows
from ...sim import JobKinematics
from .._spline.command_limits import InfeasibleLimit, LinearLimits
from .._spline.spline_offsets import SplineOffsets, basis_matrix

# Factor of safety on the nonlinearity to second order.
_SAFETY_FACTOR = 1.5

Motors = Float[np.ndarray, "step joint"]


class JointLimits(eqx.Module):
    """Limits that keep the motors of a job within their ranges.

    Attributes:
        job: The job; a machine without joints has no limits of them.
    """

    job: Job

    def rows(
        self, spline: SplineOffsets, nominal: FloatRows, max_offset: float
    ) -> tuple[LinearLimits, ...]:
        """Limits of the coefficients of a command.

        Args:
            spline: Basis of the offset.
            nominal: The uncorrected command: tips [m] or joints, shape (step, axis).
            max_offset: Bound of the coefficients.

        Returns:
            One entry; an empty tuple where no limit is near.

        Raises:
            InfeasibleLimit: The program itself is beyond a limit, or so near to one
                that the curvature of the motion leaves no room.

        **Differentiability**: none, a host function.
        """
        job = self.job.as_known
        robot = job.robot
        if robot is None:
            return ()
        joints, tips = jnp.asarray(nominal), None
        if job.correction.command != "joint":
            tips, joints = joints, JobKinematics(job).joints(joints).positions
        motors = np.asarray(
            JobKinematics(job).motor_positions_from_joints(joints), np.float64
        )
        slope = np.asarray(JobKinematics(job).motor_slopes(joints, tips), np.float64)
        nonlinearity = _nonlinearity_bound(job, joints, tips, slope, max_offset)
        least, most = (
            np.asarray(x, np.float64)[None]
            for x in (robot.joint_lower, robot.joint_upper)
        )
        lower, upper = least + nonlinearity - motors, most - nonlinearity - motors
        cause = ", with what the joint's motion bends over `max_offset`"
        _refuse(job, motors, np.maximum(lower, -upper), float(spline.time_step), cause)
        reach = max_offset * np.sum(np.abs(slope), axis=2)
        rows, joints = np.nonzero((lower > -reach) | (upper < reach))
        if not rows.size:
            return ()
        near = (rows, joints)
        return (_at_rows(spline, rows, slope[near], lower[near], upper[near]),)

    def check(self, command: FloatRows, *, is_joints: bool) -> None:
        """Raise if a command brings a motor beyond its limit.

        Args:
            command: Tip positions [m] or joint positions, shape (step, axis).
            is_joints: Whether they are joint positions.

        Raises:
            InfeasibleLimit: It does; the message says which, when and by how much.

        **Differentiability**: none, a host function.
        """
        job = self.job.as_known
        robot = job.robot
        if robot is None:
            return
        joints = jnp.asarray(command)
        if not is_joints:
            joints = JobKinematics(job).joints(joints).positions
        motors = np.asarray(
            JobKinematics(job).motor_positions_from_joints(joints), np.float64
        )
        least, most = np.asarray(robot.joint_lower), np.asarray(robot.joint_upper)
        excess = np.maximum(least[None] - motors, motors - most[None])
        _refuse(job, motors, excess, float(job.tooth_period), "")


def _nonlinearity_bound(
    job: Job,
    joints: Float[Array, "step joint"],
    tips: Float[Array, "step 3"] | None,
    slope: Float[np.ndarray, "step joint axis"],
    max_offset: float,
) -> Motors:
    """Largest distance of motors from the first order within the offset, (step, joint).

    To second order that is half a quadratic form of the offset. Its matrix is how the
    slope changes, and the sum of its entries' sizes bounds it in the whole box.
    """
    nonlinearity = np.zeros(joints.shape)
    for axis in range(slope.shape[2]):
        # Inverse kinematics would avoid a limit, by another configuration.
        aside = np.asarray(joints) + max_offset * slope[:, :, axis].astype(joints.dtype)
        there = tips
        if tips is not None:
            step = max_offset * np.eye(3, dtype=tips.dtype)[axis]
            there = on_device(np.asarray(tips) + step)
        change = (
            np.asarray(JobKinematics(job).motor_slopes(on_device(aside), there)) - slope
        )
        nonlinearity += np.sum(np.abs(change), axis=2)
    return _SAFETY_FACTOR * max_offset / 2 * nonlinearity


def _refuse(
    job: Job, motors: Motors, excess: Motors, time_step: float, cause: str
) -> None:
    """Raise if a motor is beyond its limit, or nearer than its motion bends."""
    row, joint = np.unravel_index(np.argmax(excess), excess.shape)
    worst = float(excess[row, joint])
    if worst <= 0:
        return
    robot = job.robot
    assert robot is not None
    name = robot.joint_names[joint]
    least, most = float(robot.joint_lower[joint]), float(robot.joint_upper[joint])
    raise InfeasibleLimit(
        f"`joint limits` of {name!r} must hold {float(motors[row, joint]):.6g} rad (or "
        f"m) at {row * time_step:.4g} s, but are {least:.6g} to {most:.6g}: "
        f"{worst:.3g} too narrow{cause}."
    )


def _at_rows(
    spline: SplineOffsets,
    rows: Int[np.ndarray, " limit"],
    slope: Float[np.ndarray, "limit axis"],
    lower: Float[np.ndarray, " limit"],
    upper: Float[np.ndarray, " limit"],
) -> LinearLimits:
    """Limits of motors at some rows of a path, linear in the coefficients."""
    from scipy import sparse

    basis = sparse.coo_array(basis_matrix(spline)[rows])
    axis_count = slope.shape[1]
    axes = np.arange(axis_count)[None]
    values = basis.data[:, None] * slope[basis.row]
    at_rows = np.repeat(basis.row, axis_count)
    at_columns = (basis.col[:, None] * axis_count + axes).reshape(-1)
    matrix = sparse.csr_array(
        (values.reshape(-1), (at_rows, at_columns)),
        shape=(len(rows), spline.coefficient_count * axis_count),
    )
    return LinearLimits(
        matrix=matrix,
        lower=lower,
        upper=upper,
        name="joint limits",
    )
