"""A job as a plant that is run piece by piece."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._job import Job
from ..._types import FloatRows
from ...process import AbstractAdjoint
from ...sim import (
    JobKinematics,
    JobModel,
    RunState,
)
from .._core.problem import Motion
from .._segments.plant_segment import AbstractPiece, AbstractPieces
from .linear_job import (
    LinearJob,
    Steps,
    linear_job,
    wall_motion,
)


class JobState(eqx.Module):
    """State of a job's plant between two rows.

    Attributes:
        coupled: The simulation's.
        joints: Where inverse kinematics begins: the joints that were commanded at
            the row [rad or m], shape (joint,).
    """

    coupled: RunState
    joints: Float[Array, " joint"]


class JobPiece(AbstractPiece):
    """Some rows of a job.

    Attributes:
        job: The job with the rows of its path, and the state's stock.
        state: State at the first row.
        adjoint: How to differentiate through the removal.
        wall_share: When in each period its wall is made; see `TipPlant`.
        has_joint_commands: Whether the command is joint positions, not tips.
    """

    job: Job
    state: JobState
    adjoint: AbstractAdjoint
    wall_share: Steps | None
    has_joint_commands: bool = eqx.field(static=True)

    def run(self, command: Float[Array, "step axis"]) -> tuple[Motion, JobState]:
        """Return the motion and the state at the last row."""
        before, job = self.state, self.job
        joints = _joints(job, command, before.joints, self.has_joint_commands)
        motors = JobKinematics(job).motors_of(joints)
        model = JobModel.of(job, self.adjoint)
        assert model.machine is not None
        rows = model.machine.run_segment(model.process, motors, before.coupled)
        motion = wall_motion(job, rows, self.wall_share)
        return motion, JobState(rows.state, joints[-1])

    def linearised(self, command: FloatRows) -> LinearJob:
        """Return the linear system around a command, from the fixed first state."""
        job, start = self.job, self.state.joints
        command, are_joints = jnp.asarray(command), self.has_joint_commands
        joints = _joints(job, command, start, are_joints)
        slopes = JobKinematics(job).motor_slopes(
            joints, None if are_joints else command
        )
        motors, state = JobKinematics(job).motors_of(joints), self.state.coupled
        return linear_job(job, motors, slopes, self.wall_share, state)


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

    def __check_init__(self):
        if self.job.controller is not None:
            raise ValueError(
                "Argument `job` must have an ideal controller to be run piece by "
                "piece: the motors of any other follow commands before and after them."
            )

    def begin(self, command: Float[Array, "step axis"]) -> JobState:
        """Return the state in equilibrium with the motion of the first period."""
        job = with_rows(self.job, np.arange(command.shape[0]))
        return _begin(job, self.adjoint, command, self.has_joint_commands)

    def piece(self, state: Any, rows: Int[np.ndarray, " step"]) -> JobPiece:
        """Return the piece that starts from a state."""
        # The stock is the state's: the raw one would only be carried along.
        job = eqx.tree_at(
            lambda j: j.stock, with_rows(self.job, rows), state.coupled.process.stock
        )
        shares = None if self.wall_share is None else np.asarray(self.wall_share)[rows]
        return JobPiece(job, state, self.adjoint, shares, self.has_joint_commands)


@eqx.filter_jit
def _begin(
    job: Job,
    adjoint: AbstractAdjoint,
    command: Float[Array, "step axis"],
    has_joint_commands: bool,
) -> JobState:
    start = command[0]
    if job.robot is not None:
        start = job.robot.home
        if job.joint_start is not None:
            start = jnp.asarray(job.joint_start)
    joints = _joints(job, command, start, has_joint_commands)
    model, motors = JobModel.of(job, adjoint), JobKinematics(job).motors_of(joints)
    assert model.machine is not None
    coupled = model.machine.begin_run(model.process, motors)
    return JobState(coupled, joints[0])


def _joints(
    job: Job,
    command: Float[Array, "step axis"],
    start: Float[Array, " joint"],
    has_joint_commands: bool,
) -> Float[Array, "step joint"]:
    """Return the joint positions of a command."""
    if has_joint_commands:
        return command
    started = eqx.tree_at(
        lambda j: j.joint_start, job, start, is_leaf=lambda x: x is None
    )
    return JobKinematics(started).joints(command)[0]


def with_rows(job: Job, rows: Int[np.ndarray, " step"]) -> Job:
    """Return a job with some rows of its path.

    Args:
        job: The job.
        rows: The rows, shape (step,); one may come several times.

    Returns:
        The job; stock and settings stay.

    **Differentiability**: that of the path.
    """
    path = jax.tree.map(lambda x: np.asarray(x)[rows], job.path)
    return eqx.tree_at(lambda j: j.path, job, path)
