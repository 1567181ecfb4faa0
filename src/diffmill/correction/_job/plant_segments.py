"""A job as a plant that is run piece by piece."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from ..._job import Job
from ..._types import FloatRows
from ...process import AbstractAdjoint
from ...sim import JobKinematics, MachiningProblem
from .._core.problem import Motion
from .._segments.plant_segment import AbstractPiece, AbstractPieces
from .linear_job import (
    JobState,
    LinearJob,
    Steps,
    linear_job,
    wall_motion,
)


class JobPiece(AbstractPiece):
    """Some rows of a job.

    Attributes:
        job: The job with the rows of its path and those ahead, and the state's stock.
        state: State at the first row.
        adjoint: How to differentiate through the removal.
        wall_share: When in each period its wall is made; see `TipPlant`.
        has_joint_commands: Whether the command is joint positions, not tips.
        preview_rows: Last of the rows, of which only the command counts.
    """

    job: Job
    state: JobState
    adjoint: AbstractAdjoint
    wall_share: Steps | None
    has_joint_commands: bool = eqx.field(static=True)
    preview_rows: int = eqx.field(static=True)

    @property
    def _own(self) -> Job:
        """The job without the rows ahead."""
        if self.preview_rows == 0:
            return self.job
        path = jax.tree.map(lambda x: x[: -self.preview_rows], self.job.path)
        return eqx.tree_at(lambda j: j.path, self.job, path)

    def run(self, command: Float[Array, "row axis"]) -> tuple[Motion, JobState]:
        """Motion, and the state at the last row but for those ahead."""
        first, job = self.state, self.job
        joints = _joints(job, command, first.joints, self.has_joint_commands)
        motors, memory = JobKinematics(job).motor_positions_from_joints(joints), None
        if job.controller is not None:
            motors, memory = job.controller.follow(
                motors, job.tooth_period, first.controller
            )
        own = self._own
        model = MachiningProblem.of(own, self.adjoint)
        assert model.machine is not None
        rows = model.machine.run_segment(model.process, motors, first.coupled)
        motion = wall_motion(own, rows.ends, rows.force, self.wall_share)
        return motion, JobState(rows.state, joints[motors.shape[0] - 1], memory)

    def linearised(self, command: FloatRows) -> LinearJob:
        """Linear system around a command, from the fixed first state."""
        job, start = self.job, self.state.joints
        command, are_joints = jnp.asarray(command), self.has_joint_commands
        joints = _joints(job, command, start, are_joints)
        slopes = JobKinematics(job).motor_slopes(
            joints, None if are_joints else command
        )
        motors = JobKinematics(job).motor_positions_from_joints(joints)
        return linear_job(self._own, motors, slopes, self.wall_share, self.state)


class JobPieces(AbstractPieces):
    """A job, piece by piece.

    Attributes:
        job: The job, in its precision.
        adjoint: How to differentiate through the removal.
        wall_share: When in each period its wall is made; see `TipPlant`.
        has_joint_commands: Whether the command is joint positions, not tips.
    """

    job: Job
    adjoint: AbstractAdjoint
    wall_share: Steps | None = None
    has_joint_commands: bool = eqx.field(static=True, default=False)

    @property
    def preview_rows(self) -> int:
        """Rows by which the controller, on a clock late by its delay, looks ahead."""
        return preview_rows(self.job)

    def begin(self, command: Float[Array, "row axis"]) -> JobState:
        """State in equilibrium with the motion of the first period."""
        last = self.job.path.step_count - 1
        job = with_rows(self.job, np.minimum(np.arange(command.shape[0]), last))
        before, ahead = 0, 0
        if job.controller is not None:
            before, ahead = job.controller.span(job.tooth_period)
        return _begin(
            job, self.adjoint, command, self.has_joint_commands, before, ahead
        )

    def piece(self, state: PyTree, rows: Int[np.ndarray, " row"]) -> JobPiece:
        """Piece that starts from a state."""
        # The stock is the state's: the raw one would only be carried along.
        job = eqx.tree_at(
            lambda j: j.stock, with_rows(self.job, rows), state.coupled.process.stock
        )
        ahead, shares = self.preview_rows, self.wall_share
        if shares is not None:
            shares = np.asarray(shares)[rows[: rows.size - ahead]]
        are_joints = self.has_joint_commands
        return JobPiece(job, state, self.adjoint, shares, are_joints, ahead)


def preview_rows(job: Job) -> int:
    """Rows by which a job's controller looks ahead; 0 for an ideal one."""
    if job.controller is None:
        return 0
    return job.controller.span(job.tooth_period).ahead


@eqx.filter_jit
def _begin(
    job: Job,
    adjoint: AbstractAdjoint,
    command: Float[Array, "row axis"],
    has_joint_commands: bool,
    rows_before: int,
    preview_rows: int,
) -> JobState:
    start = command[0]
    if job.robot is not None:
        start = job.robot.home
        if job.joint_start is not None:
            start = jnp.asarray(job.joint_start)
    joints = _joints(job, command, start, has_joint_commands)
    motors, memory = JobKinematics(job).motor_positions_from_joints(joints), None
    if job.controller is not None:
        period = job.tooth_period
        memory = job.controller.begin(motors, period, rows_before, preview_rows)
        motors = job.controller.follow(motors, period, memory).motors
    model = MachiningProblem.of(job, adjoint)
    assert model.machine is not None
    coupled = model.machine.begin_run(model.process, motors)
    return JobState(coupled, joints[0], memory)


def _joints(
    job: Job,
    command: Float[Array, "row axis"],
    start: Float[Array, " joint"],
    has_joint_commands: bool,
) -> Float[Array, "row joint"]:
    """Joint positions of a command [rad or m], shape (row, joint)."""
    if has_joint_commands:
        return command
    started = eqx.tree_at(
        lambda j: j.joint_start, job, start, is_leaf=lambda x: x is None
    )
    return JobKinematics(started).joints(command)[0]


def with_rows(job: Job, rows: Int[np.ndarray, " step"]) -> Job:
    """Job with some rows of its path; stock and settings stay.

    Args:
        job: The job.
        rows: The rows, shape (step,); one may come several times.

    **Differentiability**: that of the path.
    """
    path = jax.tree.map(lambda x: np.asarray(x)[rows], job.path)
    return eqx.tree_at(lambda j: j.path, job, path)
