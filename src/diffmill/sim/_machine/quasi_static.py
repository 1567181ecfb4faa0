"""The robot without inertia: in every tooth period springs balance the mean force.

    K (theta - q) = G(q) - J^T F,    F = mean force of the period on the tip path,

where the tip moves evenly from the balance at the start to the balance at the end.
The force depends on the tip by the chip, so F solves F = f(F); with f' = A C (A slope
of the mean force over the tip, C compliance of the tip) the Newton step

    (I - A C) dF = f(F) - F

is taken twice from the force of the period before: the second is at rounding unless a
chip begins or ends. A plain iteration F <- f(F) would diverge for |A C| > 1, a deep cut
with a soft arm. A cut resists its tool, so -A C has eigenvalues with positive real part
and the step exists; from period to period a disturbance then dies out. Where the
coupling of the directions brings an eigenvalue of A C to 1, the arm is dragged into the
cut without bound and no balance exists: the result is not meaningful there.

What a real arm adds is left out: swinging at corners, forced vibration and chatter.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..._types import IntScalar, RealScalarLike, Transform
from ...cutter import AbstractCutter
from ...cutting import AbstractForceLaw
from ...process import (
    AbstractAdjoint,
    Engagement,
    ProcessPlan,
    ProcessState,
    Removed,
    advance_process,
    end_period,
    failed_rows,
    initial_state,
    last_row,
    live_rows,
    outcome,
    remove_all,
    substep_ends,
    substep_middles,
    substep_wrench,
    volumes_by_pose,
    when_live,
)
from ...robot import Robot, arm_terms, drive_deflection, loaded_equilibrium
from ...workpiece import Pose, Stock
from .elastic import CoupledSolution, all_ends, along, in_work

_NEWTON_STEPS = 2


class _Balance(eqx.Module):
    """The arm at one instant: joints, pose in `work`, and load on the tool."""

    q: Float[Array, " joint"]
    pose: Pose
    load: Float[Array, " load"]


class _Row(eqx.Module):
    """Outputs of one tooth period."""

    balance: _Balance
    ends: Float[Array, "substep 3"]
    removed: Removed
    has_failed: Bool[Array, ""]


class _Machine(eqx.Module):
    """Constants of a run."""

    robot: Robot
    T_base_work: Float[Array, "4 4"]
    cutter: AbstractCutter
    laws: tuple[AbstractForceLaw, AbstractForceLaw | None]
    plan: ProcessPlan
    adjoint: AbstractAdjoint


def simulate_quasistatic(
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
    row_count: IntScalar | None = None,
) -> CoupledSolution:
    """Move the motors, let the arm bend under its weight and the cut, and cut.

    Args:
        motor_positions: Motor angles theta at the tooth instants, behind the gear on
            the joint's side [rad or m], shape (step, joint); 0 for virtual joints.
        robot: The robot with its tool; its damping is not used.
        T_base_work: Pose of the workpiece in the robot's base, shape (4, 4).
        stock: The raw workpiece.
        cutter: The cutter, as for `simulate_coupled`.
        law: The force law.
        tooth_period: T [s], shape (); nothing depends on it, time does not matter.
        plan: Sizes of the process.
        adjoint: How to differentiate through the removal.
        bottom_law: The law of the bottom edge; derived from `law` if not given.
        row_count: As for `simulate_coupled`.

    Returns:
        The motion, the forces and the final stock, as `simulate_coupled`.

    Differentiability: as `simulate_process`; also in the robot's leaves.
    """
    del tooth_period
    theta = motor_positions
    dtype, step_count = theta.dtype, theta.shape[0]
    frame = jnp.asarray(T_base_work, dtype)
    machine = _Machine(robot, frame, cutter, (law, bottom_law), plan, adjoint)
    q = loaded_equilibrium(robot, theta[0])
    pose, J, _ = _linear(machine, q)
    first = _Balance(q, pose, jnp.zeros(J.shape[0], dtype))
    process, overlap = initial_state(
        plan, stock, cutter, first.pose, step_count, adjoint
    )

    def step(
        carry: tuple[ProcessState, _Balance],
        x: tuple[Array, Array, Array, Array | None],
    ) -> tuple[tuple[ProcessState, _Balance], _Row]:
        return _run_period(machine, *carry, *x)

    index = jnp.arange(1, step_count, dtype=jnp.int32)
    xs = (index, theta[:-1], theta[1:], live_rows(index, row_count))
    (process, last), rows = jax.lax.scan(step, (process, first), xs)
    end = last_row(step_count, row_count)
    process, rest = remove_all(
        plan, cutter, process, end, last.pose, step_count, adjoint
    )
    volume, by_shank = volumes_by_pose(step_count, rows.removed, rest)
    chain = jax.tree.map(
        lambda a, b: jnp.concatenate([a[None], b]), first, rows.balance
    )
    return CoupledSolution(
        actual=chain.pose.tip,
        ends=all_ends(chain.pose.tip[0], rows.ends),
        force=chain.load[:, :3],
        joint_positions=chain.q,
        removed_volume=volume,
        shank_volume=by_shank,
        initial_overlap_volume=overlap,
        stock=process.stock,
        has_failed=failed_rows(rows.has_failed, process, end),
        result=outcome(process, jnp.all(jnp.isfinite(chain.pose.tip))),
    )


def _run_period(
    machine: _Machine,
    process: ProcessState,
    start: _Balance,
    index: Int[Array, ""],
    begin: Float[Array, " joint"],
    stop: Float[Array, " joint"],
    is_live: Bool[Array, ""] | None,
) -> tuple[tuple[ProcessState, _Balance], _Row]:
    """Return the state after one tooth period, and its row."""
    # The end is near to the start moved along with the motors: linear from there.
    near = start.q + stop - begin
    pose, jacobian, gravity = _linear(machine, near)
    stretch = lambda tau: drive_deflection(machine.robot, tau)
    joints = lambda F: stop - stretch(gravity - jacobian.T @ F)
    tip = lambda F: pose.tip + jacobian[:3] @ (joints(F) - near)

    def tips(F: Array, places: Callable[..., Array] = substep_middles) -> Array:
        shares = places(machine.plan, stop.dtype)[:, None]
        return start.pose.tip[None] * (1 - shares) + tip(F)[None] * shares

    process, cut, removed = advance_process(
        machine.plan,
        machine.cutter,
        process,
        index,
        start.pose,
        along(pose, tips(start.load)),
        machine.adjoint,
        is_live,
    )
    size = start.load.size
    mean = lambda F: _mean_load(machine, process, cut, along(pose, tips(F)))[:size]
    eye = jnp.eye(size, dtype=stop.dtype)

    def newton(F: Array, _: None) -> tuple[Array, None]:
        # One pass gives value and slope: the force beside each column is the same.
        found, columns = jax.vmap(lambda direction: jax.jvp(mean, (F,), (direction,)))(
            eye
        )
        return F + jnp.linalg.solve(eye - columns.T, found[0] - F), None

    def balance() -> _Balance:
        load, _ = jax.lax.scan(newton, start.load, length=_NEWTON_STEPS)
        return _Balance(joints(load), Pose(tip(load), pose.axis), load)

    end = when_live(is_live, balance, start)
    ends = tips(end.load, substep_ends)
    process = end_period(process, along(pose, tips(end.load)), along(pose, ends))
    has_failed = process.has_overflow | process.is_beyond
    return (process, end), _Row(end, ends, removed, has_failed)


def _linear(
    machine: _Machine, q: Float[Array, " joint"]
) -> tuple[Pose, Float[Array, "load joint"], Float[Array, " joint"]]:
    """Return pose and Jacobian of the tip in `work`, and the torques of gravity."""
    terms = arm_terms(machine.robot, q, jnp.zeros_like(q))
    to_work = machine.T_base_work[:3, :3].T
    J = in_work(machine.T_base_work, terms.jacobian)
    pose = Pose(
        to_work @ (terms.T_base_tool[:3, 3] - machine.T_base_work[:3, 3]),
        None if machine.plan.is_upright else to_work @ terms.T_base_tool[:3, 2],
    )
    # Only on a bending tool the height at which a force acts counts for anything.
    return pose, J if machine.robot.fast_joints else J[:3], terms.bias_forces


def _mean_load(
    machine: _Machine, process: ProcessState, cut: Engagement, middles: Pose
) -> Float[Array, " 6"]:
    """Return mean force and moment of a period whose poses are known."""
    force = jax.vmap(
        lambda pose, earlier, samples, bottom: substep_wrench(
            machine.plan,
            machine.cutter,
            *machine.laws,
            pose,
            earlier,
            cut.thinned,
            samples,
            bottom,
        ),
        in_axes=(0, 1, 0, 0),
    )
    found = force(middles, process.recent, cut.samples, cut.bottom)
    return jnp.mean(found.reshape(-1, 6), axis=0)
