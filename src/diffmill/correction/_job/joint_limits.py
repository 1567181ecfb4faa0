"""Limits of the joints, of the motors' positions that a command asks for.

A row of a tip command asks for motor positions theta(x), whose derivative at the
desired tip is known. To first order an offset B c of the tip keeps

    least <= theta(x) + dtheta/dx (B c) <= most,

which is linear in the coefficients c and concerns only rows from which the largest
offset could reach a limit: of most programs none. The limits are drawn in by what theta
bends over the largest offset, so that the first order is enough.
"""

import itertools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._job import Job
from ..._types import FloatRows
from ...sim import JobKinematics
from .._spline.command_limits import InfeasibleLimit, LinearLimits
from .._spline.spline_offsets import SplineOffsets, basis_matrix

# The bend within a box is taken as that at its corners and so many times more.
_SAFE = 1.5

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
        """Return the limits of the coefficients of a command.

        Args:
            spline: Basis of the offset.
            nominal: The uncorrected command: tips [m] or joints, shape (step, axis).
            max_offset: Bound of the coefficients.

        Returns:
            One entry, or none where no limit is near.

        Raises:
            InfeasibleLimit: The program itself is beyond a limit, or so near to one
                that the curvature of the motion leaves no room.

        **Differentiability**: none, a host function.
        """
        job = self.job
        robot = job.robot
        if robot is None:
            return ()
        tips = jnp.asarray(nominal)
        are_joints = job.correction.command == "joint"
        joints = tips if are_joints else JobKinematics(job).joints(tips).positions
        motors = np.asarray(JobKinematics(job).motors_of(joints), np.float64)
        slope = JobKinematics(job).motor_slopes(joints, None if are_joints else tips)
        slope = np.asarray(slope, np.float64)
        bend = _bend(job, tips, motors, slope, max_offset)
        least, most = (
            np.asarray(x, np.float64)[None]
            for x in (robot.joint_lower, robot.joint_upper)
        )
        lower, upper = least + bend - motors, most - bend - motors
        why = ", with what the joint's motion bends over `max_offset`"
        _refuse(job, motors, np.maximum(lower, -upper), float(spline.time_step), why)
        reach = max_offset * np.sum(np.abs(slope), axis=2)
        rows, joints = np.nonzero((lower > -reach) | (upper < reach))
        if not rows.size:
            return ()
        near = (rows, joints)
        return (_mixed(spline, rows, slope[near], lower[near], upper[near]),)

    def check(self, command: FloatRows, *, is_joints: bool) -> None:
        """Raise if a command brings a motor beyond its limit.

        Args:
            command: Tip positions [m] or joint positions, shape (step, axis).
            is_joints: Whether they are joint positions.

        Raises:
            InfeasibleLimit: It does; the message says which, when and by how much.

        **Differentiability**: none, a host function.
        """
        job = self.job
        robot = job.robot
        if robot is None:
            return
        motors = np.asarray(_motors(job, jnp.asarray(command), is_joints), np.float64)
        least, most = np.asarray(robot.joint_lower), np.asarray(robot.joint_upper)
        excess = np.maximum(least[None] - motors, motors - most[None])
        _refuse(job, motors, excess, float(job.tooth_period), "")


def _bend(
    job: Job,
    command: Float[Array, "step axis"],
    motors: Motors,
    slope: Float[np.ndarray, "step joint axis"],
    max_offset: float,
) -> Motors:
    """Return how far motors come from the first order, at most, within the offset."""
    axis_count = command.shape[1]
    # To second order opposite corners are alike.
    signs = itertools.product((1.0, -1.0), repeat=axis_count - 1)
    bend, is_joints = np.zeros_like(motors), job.correction.command == "joint"
    assert job.robot is not None
    turns = np.array([kind == "revolute" for kind in job.robot.joint_kinds])
    for sign in signs:
        shift = max_offset * np.array([1.0, *sign])
        moved = command + jnp.asarray(shift[None], command.dtype)
        change = np.asarray(_motors(job, moved, is_joints), np.float64) - motors
        # Half a turn from where the arm starts, either way round is as near.
        change -= 2 * np.pi * np.round(change / (2 * np.pi)) * turns
        bend = np.maximum(bend, np.abs(change - slope @ shift))
    return _SAFE * bend


def _motors(
    job: Job, command: Float[Array, "step axis"], is_joints: bool
) -> Float[Array, "step joint"]:
    """Return the motor positions of tips, or of joints."""
    if is_joints:
        return JobKinematics(job).motors_of(command)
    return JobKinematics(job).motors(command).positions


def _refuse(
    job: Job, motors: Motors, excess: Motors, time_step: float, why: str
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
        f"{worst:.3g} too narrow{why}."
    )


def _mixed(
    spline: SplineOffsets,
    rows: Int[np.ndarray, " limit"],
    slope: Float[np.ndarray, "limit axis"],
    lower: Float[np.ndarray, " limit"],
    upper: Float[np.ndarray, " limit"],
) -> LinearLimits:
    """Return limits at some rows of a path as rows of a sparse matrix."""
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
