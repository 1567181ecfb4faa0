"""Deviation over the place of the workpiece, and the bounds of the place.

The force of the rigid cut does not depend on the place. Turned into the base, it
stretches the drives' springs at the joint positions that the place asks for,

    d = J s(J^T F),    s(tau) = K^-1 tau,

and what of d is across the path is the error. The joints follow the place by the
implicit function of the inverse kinematics, so that the derivative is exact.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..._job import Job
from ...robot import (
    Robot,
    ToolRotation,
    gravity_forces,
    inverse_kinematics,
    jacobian,
    singularity,
)
from ...sim import JobKinematics

# Shift along x, y and z of the base, turn of the work, turn of the tool.
UNKNOWNS = ("x", "y", "z", "angle", "rotation")


class PlacementTask(eqx.Module):
    """Everything that the residual of a place needs.

    Attributes:
        robot: The robot with its tool.
        T_base_work: The job's own place, shape (4, 4).
        Ts_work_tool: Tool poses that count, the path's first one first, shape
            (row, 4, 4).
        q_start: Where the search of the first pose begins [rad or m], (joint,).
        force: Mean force on the tool in `work` [N], shape (row, 3).
        along: Unit tangents of the path in `work`, shape (row, 3); 0 where it dwells.
        weights: Factor of each row in the residual [1/m], shape (row,); rows of weight
            0 only have to be reached.
        center: Point of the base about which the work turns [m], shape (3,).
        widths: Unit of each unknown [m, rad], shape (5,).
        least_singular: Smallest singular value that a pose may have [-], shape ().
        limited: Indices of the motor joints that have limits.
        tool_rotation: Whether the inverse kinematics chooses the tool's rotation.
    """

    robot: Robot
    T_base_work: Float[Array, "4 4"]
    Ts_work_tool: Float[Array, "row 4 4"]
    q_start: Float[Array, " joint"]
    force: Float[Array, "row 3"]
    along: Float[Array, "row 3"]
    weights: Float[Array, " row"]
    center: Float[Array, " 3"]
    widths: Float[Array, " 5"]
    least_singular: Float[Array, ""]
    limited: tuple[int, ...] = eqx.field(static=True)
    tool_rotation: ToolRotation = eqx.field(static=True)


def placement_residual(
    unit: Float[Array, " 5"], task: PlacementTask
) -> Float[Array, " entry"]:
    """Weighted errors across the path, then the joints in their ranges.

    The latter are -1 at the lower and 1 at the upper limit. Infinite where a pose is
    not reached, or is nearly singular.
    """
    values = unit * task.widths
    T = moved_work(task.T_base_work, task.center, values)
    robot = task.robot.with_tool(turned_tool(task.robot.T_flange_tool, values[4]))
    Ts = T[None] @ task.Ts_work_tool
    solve = lambda T, q: inverse_kinematics(
        robot, T, q, tool_rotation=task.tool_rotation, attempts=1
    )
    first = solve(Ts[0], task.q_start)
    found = jax.vmap(solve, (0, None))(Ts, jax.lax.stop_gradient(first.q))
    moved = jax.vmap(lambda q, F: tip_deflection(robot, q, F))(
        found.q, task.force @ T[:3, :3].T
    )
    error = across(moved @ T[:3, :3], task.along) * task.weights[:, None]
    limited = np.array(task.limited, np.int32)
    lower, upper = robot.joint_lower[limited], robot.joint_upper[limited]
    ranges = (2 * found.q[:, limited] - (lower + upper)[None]) / (upper - lower)[None]
    entries = jnp.concatenate([error.ravel(), ranges.ravel()])
    is_allowed = jnp.all(found.converged) & jnp.all(
        _smallest(robot, jax.lax.stop_gradient(found.q), task.tool_rotation)
        >= task.least_singular
    )
    return jnp.where(is_allowed, entries, jnp.inf)


def moved_work(
    T_base_work: Float[Array, "4 4"],
    center: Float[Array, " 3"],
    values: Float[Array, " 5"],
) -> Float[Array, "4 4"]:
    """Place turned about z of the base through a point, then shifted."""
    turn = _about_z(values[3])
    position = center + turn[:3, :3] @ (T_base_work[:3, 3] - center) + values[:3]
    return (turn @ T_base_work).at[:3, 3].set(position)


def turned_tool(
    T_flange_tool: Float[Array, "4 4"], rotation: Float[Array, ""]
) -> Float[Array, "4 4"]:
    """Tool in the flange with which the flange turns about the tool axis.

    The tool's pose is the path's, so the flange turns the other way round.
    """
    return T_flange_tool @ _about_z(-rotation)


def tip_deflection(
    robot: Robot, q: Float[Array, " joint"], force: Float[Array, " 3"]
) -> Float[Array, " 3"]:
    """Deflection of the tip under a force, both in the base.

    To first order in the stretch of the drives; servos and virtual joints deflect
    too, gaps from where gravity holds them.
    """
    J = jacobian(robot, q)[:3]
    load = J.T @ force
    if robot.backlash is None:
        return J @ robot.drive_deflection(load)
    weight = gravity_forces(robot, q)
    return J @ (robot.drive_deflection(weight) - robot.drive_deflection(weight - load))


def across(
    vector: Float[Array, "row 3"], along: Float[Array, "row 3"]
) -> Float[Array, "row 3"]:
    """Component of vectors at right angles to directions; the vectors for 0."""
    return vector - jnp.sum(vector * along, axis=1, keepdims=True) * along


def path_tangents(
    positions: Float[np.ndarray, "step 3"],
) -> Float[np.ndarray, "step 3"]:
    """Unit tangents of a path, 0 where it dwells."""
    slope = np.gradient(positions, axis=0)
    length = np.linalg.norm(slope, axis=1, keepdims=True)
    return slope / np.where(length > 0, length, 1.0)


class LoadedPath(eqx.Module):
    """A whole path under the force of the cut.

    Attributes:
        deflection: Deflection of the tip in `work` [m], shape (step, 3).
        joints: Joint positions [rad or m], shape (step, joint).
        is_reached: Whether the arm reaches every row, shape ().
    """

    deflection: Float[Array, "step 3"]
    joints: Float[Array, "step joint"]
    is_reached: Bool[Array, ""]


@eqx.filter_jit
def whole_path(job: Job, force: Float[Array, "step 3"]) -> LoadedPath:
    """Joints of an arm on a job's path, and its deflection by the force [N] there."""
    robot = job.robot
    if robot is None:
        raise ValueError("Argument `job` must have a robot, but its machine is rigid.")
    q, is_reached = JobKinematics(job).joints(jnp.asarray(job.path.positions))
    R = jnp.asarray(job.T_base_work, robot.dtype)[:3, :3]
    moved = jax.vmap(lambda q, F: tip_deflection(robot, q, F))(q, force @ R.T)
    return LoadedPath(moved @ R, q, jnp.all(is_reached))


def least_singular_of(
    robot: Robot, qs: Float[Array, "row joint"], tool_rotation: ToolRotation
) -> float:
    """Smallest singular value over poses, lengths in the arm's unit."""
    return float(jnp.min(_smallest(robot, qs, tool_rotation)))


def _smallest(
    robot: Robot, qs: Float[Array, "row joint"], tool_rotation: ToolRotation
) -> Float[Array, " row"]:
    measure = lambda q: singularity(robot, q, tool_rotation=tool_rotation).smallest
    return jax.vmap(measure)(qs)


def _about_z(angle: Float[Array, ""]) -> Float[Array, "4 4"]:
    """Rotation about z as a homogeneous matrix."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    turn = jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])
    return jnp.eye(4, dtype=turn.dtype).at[:2, :2].set(turn)
