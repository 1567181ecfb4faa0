"""The coupled simulation in segments: a run that starts from where another ended.

A segment numbers its poses afresh: its track holds the newest of the segments before,
as far as removal looks back, then its own. Ends of rays that earlier segments cut
become raw stock to it: they stay where they are and have no derivative. So what is
carried from segment to segment does not grow with the path, but for the stock itself.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..._job import Job
from ...process import HISTORY, AbstractAdjoint, ProcessState
from ...workpiece import PoseTrack, Rays, Stock
from .._job.simulate import job_plan
from ._integrator.base import ArmState
from ._integrator.rk4 import make_integrator
from .elastic import Machine, all_ends, begin, coupled_machine, pose_at, run_periods


class CoupledCarry(eqx.Module):
    """All that a coupled run needs to go on.

    Attributes:
        process: The stock, less the poses that wait for removal, and these.
        arm: The robot's state.
        period_count: Tooth periods run so far, which tell the tooth that is next.
    """

    process: ProcessState
    arm: ArmState
    period_count: Int[Array, ""]


class CoupledSegment(eqx.Module):
    """Solution of one segment.

    Attributes:
        actual: Tool tip in `work` at the tooth instants [m], shape (step, 3).
        ends: Tool tip at the ends of the sub-steps of the period before each instant
            [m], shape (step, substep, 3); row 0 is at rest.
        force: Mean force on the tool over the period before each instant [N], shape
            (step, 3); zero in row 0, which belongs to the segment before.
        joint_positions: [rad or m], shape (step, joint).
    """

    actual: Float[Array, "step 3"]
    ends: Float[Array, "step substep 3"]
    force: Float[Array, "step 3"]
    joint_positions: Float[Array, "step joint"]


def begin_segments(
    machine: Machine, stock: Stock, motor_positions: Float[Array, "step joint"]
) -> CoupledCarry:
    """Return the state from which the first segment starts.

    It is that of `simulate_coupled`: equilibrium with gravity, moving with the motors.

    Args:
        machine: The machine and the sizes of the process.
        stock: The raw workpiece.
        motor_positions: Motors at the first instants [rad or m], shape (step, joint),
            of which the first three count.

    Returns:
        The state at the first instant.

    Differentiability: as `simulate_coupled`.
    """
    rows = _history_rows(machine)
    (process, arm), _ = begin(machine, stock, motor_positions, rows + 1)
    process = _moved(process, process.track, rows)
    return CoupledCarry(process, arm, jnp.zeros((), jnp.int32))


def run_segment(
    machine: Machine, carry: CoupledCarry, motor_positions: Float[Array, "step joint"]
) -> tuple[CoupledSegment, CoupledCarry]:
    """Run some periods from where an earlier run ended.

    Args:
        machine: The machine and the sizes of the process.
        carry: State at row 0 of the segment.
        motor_positions: Motors at the rows [rad or m], shape (step, joint); row 0 is
            the last row of the segment before.

    Returns:
        The rows, and the state at the last of them. What still waits for removal is
        in the state; nothing is flushed.

    Differentiability: as `simulate_coupled`; the state is differentiable but for the
    ends of rays, and under `ThroughPoses` the segment depends on earlier ones by the
    arm and the poses that wait for removal only.
    """
    theta = motor_positions
    flutes = machine.cutter.flute_count
    # The tooth that is next follows from the index of the period.
    ahead = jnp.mod(carry.period_count, flutes)
    history = _history_rows(machine)
    process = _with_rows(carry.process, ahead, theta.shape[0] + flutes)
    first = history + ahead + 1
    ended, rows = run_periods(machine, (process, carry.arm), theta, first)
    process, state = ended
    final = pose_at(machine, state).tip
    segment = CoupledSegment(
        actual=jnp.concatenate([rows.tip, final[None]]),
        ends=all_ends(rows.tip[0], rows.ends),
        force=jnp.concatenate([jnp.zeros((1, 3), theta.dtype), rows.force]),
        joint_positions=jnp.concatenate([rows.joint_positions, state.q[None]]),
    )
    count = carry.period_count + (theta.shape[0] - 1)
    process = _renumbered(process, ahead + theta.shape[0] - 1, history)
    return segment, CoupledCarry(process, state, count)


def _history_rows(machine: Machine) -> int:
    """Return the row in the track at which a segment starts, in whole turns."""
    flutes = machine.cutter.flute_count
    return (-(-HISTORY // flutes) + 2) * flutes


def _with_rows(
    process: ProcessState, ahead: Int[Array, ""], count: int
) -> ProcessState:
    """Return the state with its track moved ahead, and more rows behind it."""
    track = process.track
    more = count * track.substeps
    longer = jax.tree.map(
        lambda x: jnp.concatenate([x, jnp.broadcast_to(x[-1:], (more, 3))]),
        track.poses,
    )
    poses = longer.with_rows(ahead * track.substeps, track.poses)
    return _moved(process, PoseTrack(poses, track.substeps), ahead)


def _renumbered(process: ProcessState, back: Int[Array, ""], last: int) -> ProcessState:
    """Return the state with row `back + last` of its track as row `last`, its end."""
    S = process.track.substeps
    poses = jax.tree.map(
        lambda x: jax.lax.dynamic_slice_in_dim(x, back * S, last * S + 1),
        process.track.poses,
    )
    families = tuple(
        Rays(rays.ends, jnp.full_like(rays.poses, -1))
        for rays in process.stock.families
    )
    process = eqx.tree_at(lambda s: s.stock.families, process, families)
    return _moved(process, PoseTrack(poses, S), -back)


def _moved(
    process: ProcessState, track: PoseTrack, rows: Int[Array, ""] | int
) -> ProcessState:
    """Return the state with another track, in which its rows stand further on."""
    return eqx.tree_at(
        lambda s: (s.track, s.queue.row),
        process,
        (track, process.queue.row + rows),
    )


def job_machine(job: Job, adjoint: AbstractAdjoint) -> Machine:
    """Return the machine of a job with the sizes of its process.

    Args:
        job: The job, in its precision.
        adjoint: How to differentiate through the removal.

    Raises:
        ValueError: The job has no robot, or its robot is quasi-static: segments carry
            a state that such a robot does not have.
    """
    settings = job.simulation
    if job.robot is None or settings.mode != "dynamic":
        found = "rigid" if job.robot is None else settings.mode
        raise ValueError(
            f"Argument `job` must have a dynamic robot for a run in segments, but its "
            f"machine is {found}."
        )
    return coupled_machine(
        job.robot,
        job.T_base_work,
        job.cutter,
        job.law,
        job.tooth_period,
        job_plan(job),
        adjoint,
        job.bottom_law,
        make_integrator(settings.integrator, settings.dynamics),
        job.stock.origin.dtype,
    )
