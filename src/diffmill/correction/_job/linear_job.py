"""The linear system of a job, of its whole path or of some rows."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from ..._arrays import first_rows, is_traced, on_device
from ..._job import Job
from ..._padding import pad_rows
from ...numerics import CachedJit
from ...process import FrozenStock, wall_deviation, wall_shares
from ...robot import Controller
from ...sim import (
    LinearRun,
    MachiningProblem,
    RunState,
    linearise,
)
from .._core.linear_motion import LinearMotion
from .._core.problem import Motion

# A number per step.
Steps = Float[Array, " step"] | Float[np.ndarray, " step"]


class JobState(eqx.Module):
    """State of a job's plant between two rows.

    Attributes:
        coupled: The simulation's.
        joints: Where inverse kinematics begins: the joints that were commanded at
            the row [rad or m], shape (joint,).
        controller: The controller's, of `Controller.begin` or `follow`; None if it is
            ideal.
    """

    coupled: RunState
    joints: Float[Array, " joint"]
    controller: PyTree = None


def wall_motion(
    job: Job,
    ends: Float[Array, "step substep 3"],
    force: Float[Array, "step 3"],
    shares: Steps | None,
) -> Motion:
    """Motion of a job at the instants at which its walls are made.

    Args:
        job: The job, with the rows that were run.
        ends: Tips at the ends of the sub-steps before each row [m].
        force: Mean forces before each row [N].
        shares: When in each period its wall is made; by the path alone if None.

    **Differentiability**: linear in the tips.
    """
    desired = jnp.asarray(job.path.positions)
    if shares is None:
        shares = wall_shares(desired, job.tool_axes, job.cutter)
    deviation = wall_deviation(ends, desired, jnp.asarray(shares, desired.dtype))
    return Motion(desired + job.path.disturbed(deviation), force)


class LinearJob(LinearMotion):
    """The motion of a job and the linear system around it.

    Attributes:
        motion: The motion.
        run: The system, in the motors.
        motors: Slopes of the commanded motors in the command, row by row, shape (row,
            joint, axis); of a piece also in rows behind it that the controller needs.
        wall_share: When in each period its wall is made, shape (step,).
        time_step: Time between two rows [s], shape ().
        controller: What the motors do of their command; None if they follow it.
        state: The controller's at row 0, which does not move; None for a whole path.
    """

    motion: Motion
    run: LinearRun
    motors: Float[Array, "row joint axis"]
    wall_share: Float[Array, " step"]
    time_step: Float[Array, ""]
    controller: Controller | None
    state: PyTree = None

    def move(self, changes: Float[Array, "row axis direction"]) -> Motion:
        """Changes of the motion, each direction a row of the first axis."""
        motors = jnp.einsum("kja,kad->kjd", self.motors, changes)
        if self.controller is not None:
            state = self.state
            if state is not None:
                state = state.of_changes(changes.shape[-1])
            motors = _controlled(self.controller, motors, self.time_step, state)
        moved = self.run.move_walls(motors, self.wall_share)
        return Motion(*(jnp.moveaxis(x, -1, 0) for x in (moved.tips, moved.force)))


def _controlled(
    controller: Controller,
    motors: Float[Array, "row joint ..."],
    time_step: Float[Array, ""],
    state: PyTree,
) -> Float[Array, "step joint ..."]:
    """Motor positions behind the controller, from a state or from the start."""
    if state is None:
        return controller.motors(motors, time_step)
    return controller.follow(motors, time_step, state).motors


def linear_job(
    job: Job,
    motors: Float[Array, "row joint"],
    slopes: Float[Array, "row joint axis"],
    wall_share: Steps | None,
    state: JobState | None = None,
) -> LinearJob:
    """Linear system of a job around a run.

    Args:
        job: The job; its machine must not be rigid.
        motors: Its commanded motors [rad or m], shape (row, joint); from a state also
            those behind its path that the controller needs.
        slopes: Slopes of them in the command, shape (row, joint, axis).
        wall_share: When in each period its wall is made; by the path alone if None.
        state: State at row 0, which does not move; None to begin with the motors.
    """
    count = job.path.step_count
    if state is not None or wall_share is None or is_traced((job, motors)):
        return _linear_job(
            MachiningProblem.of(job, FrozenStock()), motors, slopes, wall_share, state
        )
    # A whole path runs at one of few lengths, for which it is compiled.
    problem = MachiningProblem.padded(job, FrozenStock())
    rows = problem.path.step_count
    long = lambda x: on_device(pad_rows(x, rows))
    given = long(motors), long(slopes), long(wall_share)
    system = _linear_job(problem, *given, None)
    if rows == count:
        return system
    by_row = lambda x: (x.motion, x.motors, x.wall_share, x.run.ends, x.run.force)
    by_period = lambda x: (x.run.loads, x.run.arm, x.run.pose, x.run.circles)
    system = eqx.tree_at(by_row, system, first_rows(by_row(system), count))
    return eqx.tree_at(by_period, system, first_rows(by_period(system), count - 1))


def prepare_linear_job(job: Job) -> None:
    """Compile in the background what `linear_job` runs of a whole path.

    Args:
        job: The job, in its precision; its machine must not be rigid.
    """
    problem = MachiningProblem.padded(job, FrozenStock())
    rows, dtype = problem.path.step_count, np.dtype(job.simulation.precision)
    joints = 3 if job.robot is None else len(job.robot.joint_names)
    axes = joints if job.correction.command == "joint" else 3
    shapes = (rows, joints), (rows, joints, axes), (rows,)
    motors, slopes, shares = (on_device(np.zeros(x, dtype)) for x in shapes)
    _linear_job.prepare(problem, motors, slopes, shares, None)


@CachedJit
def _linear_job(
    problem: MachiningProblem,
    motors: Float[Array, "row joint"],
    slopes: Float[Array, "row joint axis"],
    wall_share: Steps | None,
    state: JobState | None,
) -> LinearJob:
    machine, process, path = problem.machine, problem.process, problem.path
    assert machine is not None
    time_step = jnp.asarray(process.tooth_period, motors.dtype)
    coupled = memory = None
    if state is not None:
        coupled, memory = state.coupled, state.controller
    if problem.controller is not None:
        motors = _controlled(problem.controller, motors, time_step, memory)
    run = linearise(machine, process, motors, coupled, row_count=path.row_count)
    desired = jnp.asarray(path.positions)
    if wall_share is None:
        wall_share = wall_shares(desired, problem.axes, process.cutter)
    shares = jnp.asarray(wall_share, desired.dtype)
    deviation = path.disturbed(wall_deviation(run.ends, desired, shares))
    motion = Motion(desired + deviation, run.force)
    return LinearJob(motion, run, slopes, shares, time_step, problem.controller, memory)
