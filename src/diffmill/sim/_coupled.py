"""The coupled simulation: an elastic robot moves the tool, the cut pushes it back.

One `lax.scan` over tooth periods. At the start of a period the robot's terms (mass
matrix, bias forces, Jacobian, tip) are computed once: within a period a joint turns
by some 1e-4 rad, so they are constant to the same accuracy. The sub-steps then solve
a linear, implicit midpoint step each,

    (M + h D / 2 + h^2 K / 4) dv
        = h (K (theta - q - h v / 2) + D (thetad - v) - bias + J^T F),

with the motor angle theta at the middle of the sub-step and the force F of the teeth
that pass in it. The midpoint form neither damps nor excites an oscillation.
"""

from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._result import RESULTS
from .._types import RealScalarLike, Transform
from ..cutter import AbstractCutter
from ..cutting import AbstractForceLaw
from ..robot import Robot, arm_terms
from ..workpiece import Pose, Stock
from ._adjoint import AbstractAdjoint
from ._bottom import BottomEngagement
from ._history import ProcessState, Removed, end_period, flush, initial_state
from ._period import Engagement, begin_period, substep_force, substep_middles
from ._plan import ProcessPlan
from ._process_alone import outcome, volumes_by_pose

# Angles, teeth and occupancy of one sub-step, and its bottom edges.
_Samples: TypeAlias = tuple[Array, Array, Array, BottomEngagement | None]


class CoupledSolution(eqx.Module):
    """What a robot that cuts does.

    Attributes:
        actual: Tool tip in `work` at the tooth instants [m], shape (step, 3).
        force: Mean force on the tool over the period before each instant, in `work`
            [N], shape (step, 3); zero in row 0.
        joint_positions: [rad or m], shape (step, joint).
        removed_volume: Volume that each pose removes [m^3], shape (step,).
        shank_volume: What of it the shank takes [m^3], shape (step,).
        initial_overlap_volume: Stock inside the tool at the first pose [m^3].
        stock: The stock after the last pose.
        has_failed: Whether a flag was up after each step, shape (step,).
        result: Outcome of the run.
    """

    actual: Float[Array, "step 3"]
    force: Float[Array, "step 3"]
    joint_positions: Float[Array, "step joint"]
    removed_volume: Float[Array, " step"]
    shank_volume: Float[Array, " step"]
    initial_overlap_volume: Float[Array, ""]
    stock: Stock
    has_failed: Bool[Array, " step"]
    result: RESULTS


class _Arm(eqx.Module):
    """The robot's terms of one period, in `work`, ready for its sub-steps."""

    pose: Pose
    jacobian: Float[Array, "3 joint"]
    bias: Float[Array, " joint"]
    inverse: Float[Array, "joint joint"]


class _Period(eqx.Module):
    """What one tooth period leaves behind."""

    tip: Float[Array, " 3"]
    force: Float[Array, " 3"]
    joint_positions: Float[Array, " joint"]
    removed: Removed
    has_failed: Bool[Array, ""]


def simulate_coupled(
    motor_positions: Float[Array, "step joint"],
    robot: Robot,
    T_base_work: Transform,
    stock: Stock,
    cutter: AbstractCutter,
    law: AbstractForceLaw,
    tooth_period: RealScalarLike,
    plan: ProcessPlan,
    adjoint: AbstractAdjoint,
    bottom_law: AbstractForceLaw | None = None,
) -> CoupledSolution:
    """Move the motors, let the arm follow and cut.

    The run starts in equilibrium with gravity, moving with the motors.

    Args:
        motor_positions: Motor angles theta at the tooth instants, behind the gear on
            the joint's side [rad or m], shape (step, joint); 0 for virtual joints.
        robot: The robot with its tool.
        T_base_work: Pose of the workpiece in the robot's base, shape (4, 4).
        stock: The raw workpiece.
        cutter: The cutter. Where the plan says that it stands upright, its axis
            stays along +z of `work`; else it tilts with the robot.
        law: The force law.
        tooth_period: T [s], shape ().
        plan: Sizes of the process.
        adjoint: How to differentiate through the removal.
        bottom_law: The law of the bottom edge; derived from `law` if not given.

    Returns:
        The motion, the forces and the final stock.

    Differentiability: as `simulate_process`; also in the robot's leaves.
    """
    theta = motor_positions
    dtype, step_count = theta.dtype, theta.shape[0]
    T = jnp.asarray(tooth_period, dtype)
    frame = jnp.asarray(T_base_work, dtype)
    v = (theta[1] - theta[0]) / T
    q = _start(robot, theta[0], v)
    first = _arm(plan, robot, frame, q, v, T / plan.substeps).pose
    process, overlap = initial_state(plan, stock, cutter, first, step_count, adjoint)
    middles = substep_middles(plan, dtype)

    def step(
        carry: tuple[ProcessState, Array, Array], x: tuple[Array, Array, Array]
    ) -> tuple[tuple[ProcessState, Array, Array], _Period]:
        process, q, v = carry
        index, start, stop = x
        arm = _arm(plan, robot, frame, q, v, T / plan.substeps)
        motion = T * middles[:, None] * (arm.jacobian @ v)[None]
        predicted = _along(arm.pose, arm.pose.tip[None] + motion)
        process, cut, removed = begin_period(
            plan, cutter, process, index, arm.pose, predicted, adjoint
        )
        rate = (stop - start) / T
        targets = start[None] + T * middles[:, None] * rate[None]
        end, (tips, forces) = _run_substeps(
            plan,
            cutter,
            (law, bottom_law),
            robot,
            arm,
            process,
            cut,
            (q, v),
            targets,
            rate,
            T,
        )
        process = end_period(process, _along(arm.pose, tips))
        has_failed = process.has_overflow | process.is_beyond
        row = _Period(arm.pose.tip, jnp.mean(forces, axis=0), q, removed, has_failed)
        return (process, *end), row

    index = jnp.arange(1, step_count, dtype=jnp.int32)
    carry = (process, q, v)
    carry, rows = jax.lax.scan(step, carry, (index, theta[:-1], theta[1:]))
    process, q, v = carry
    final = _arm(plan, robot, frame, q, v, T / plan.substeps).pose
    last: Int[Array, ""] = jnp.asarray(step_count - 1, jnp.int32)
    process, rest = flush(plan, cutter, process, last, final, adjoint)
    actual = jnp.concatenate([rows.tip, final.tip[None]])
    volume, by_shank = volumes_by_pose(step_count, rows.removed, rest)
    return CoupledSolution(
        actual=actual,
        force=jnp.concatenate([jnp.zeros((1, 3), dtype), rows.force]),
        joint_positions=jnp.concatenate([rows.joint_positions, q[None]]),
        removed_volume=volume,
        shank_volume=by_shank,
        initial_overlap_volume=overlap,
        stock=process.stock,
        has_failed=jnp.concatenate([jnp.zeros(1, bool), rows.has_failed]),
        result=outcome(process, jnp.all(jnp.isfinite(actual))),
    )


def _start(
    robot: Robot, theta: Float[Array, " joint"], v: Float[Array, " joint"]
) -> Float[Array, " joint"]:
    """Return the joints in equilibrium with gravity and the motion: two Newton steps.

    The springs are much stiffer than gravity, so the second step is at rounding.
    """
    q = theta
    for _ in range(3):
        bias = arm_terms(robot, q, v).bias_forces
        q = theta - bias / robot.joint_stiffness
    return q


def _along(pose: Pose, tips: Float[Array, "substep 3"]) -> Pose:
    """Return poses at other tips: within a period the tool does not tilt."""
    if pose.axis is None:
        return Pose(tips)
    return Pose(tips, jnp.broadcast_to(pose.axis[None], tips.shape))


def _arm(
    plan: ProcessPlan,
    robot: Robot,
    T_base_work: Float[Array, "4 4"],
    q: Float[Array, " joint"],
    v: Float[Array, " joint"],
    h: Float[Array, ""],
) -> _Arm:
    terms = arm_terms(robot, q, v)
    to_work = T_base_work[:3, :3].T
    # symbols: M mass matrix, K stiffness, D damping, h sub-step
    M, K, D = terms.mass_matrix, robot.joint_stiffness, robot.joint_damping
    A = M + jnp.diag(h / 2 * D + h**2 / 4 * K)
    # A sub-step costs one product with the inverse; the matrix is small and definite.
    factor = jnp.linalg.cholesky(A)
    eye = jnp.eye(A.shape[0], dtype=A.dtype)
    inverse = jax.scipy.linalg.cho_solve((factor, True), eye)
    return _Arm(
        pose=Pose(
            to_work @ (terms.T_base_tool[:3, 3] - T_base_work[:3, 3]),
            None if plan.is_upright else to_work @ terms.T_base_tool[:3, 2],
        ),
        jacobian=to_work @ terms.jacobian[:3],
        bias=terms.bias_forces,
        inverse=inverse,
    )


def _run_substeps(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    laws: tuple[AbstractForceLaw, AbstractForceLaw | None],
    robot: Robot,
    arm: _Arm,
    process: ProcessState,
    cut: Engagement,
    start: tuple[Float[Array, " joint"], Float[Array, " joint"]],
    targets: Float[Array, "substep joint"],
    rate: Float[Array, " joint"],
    tooth_period: Float[Array, ""],
) -> tuple[
    tuple[Float[Array, " joint"], Float[Array, " joint"]],
    tuple[Float[Array, "substep 3"], Float[Array, "substep 3"]],
]:
    """Return the state at the end of a period, the tips and the forces within it."""
    h = tooth_period / plan.substeps
    K, D = robot.joint_stiffness, robot.joint_damping
    q0 = start[0]

    @jax.checkpoint
    def substep(
        state: tuple[Array, Array],
        x: tuple[Array, Pose, _Samples],
    ) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        q, v = state
        theta, earlier, samples = x
        tip = arm.pose.tip + arm.jacobian @ (q + h / 2 * v - q0)
        pose = Pose(tip, arm.pose.axis)
        forces = substep_force(
            plan, cutter, *laws, pose, earlier, cut.thinned, *samples
        )
        F = jnp.mean(forces, axis=0)
        tau = K * (theta - q - h / 2 * v) + D * (rate - v) - arm.bias
        dv = arm.inverse @ (h * (tau + arm.jacobian.T @ F))
        return (q + h * (v + dv / 2), v + dv), (tip, F)

    earlier = jax.tree.map(lambda x: jnp.moveaxis(x, 0, 1), process.recent)
    xs = (targets, earlier, (cut.angle, cut.tooth, cut.occupancy, cut.bottom))
    return jax.lax.scan(substep, start, xs)
