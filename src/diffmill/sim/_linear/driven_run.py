"""A run of an arm about which slopes in errors of its machine are taken."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._job import Job
from .._job.simulate import Solution
from .._machine.commands import JobKinematics


class DrivenRun(eqx.Module):
    """A run about which slopes are taken.

    Attributes:
        motors: Commanded motors, before the controller [rad or m], shape (step, joint).
        slopes: Slopes of them in the commanded tip, shape (step, joint, 3).
        joints: Where the joints are [rad or m], shape (step, joint).
        driven: Motors behind the controller [rad or m], shape (step, joint).
        wall_share: When in each period the wall is made, shape (step,).
    """

    motors: Float[Array, "step joint"]
    slopes: Float[Array, "step joint 3"]
    joints: Float[Array, "step joint"]
    driven: Float[Array, "step joint"]
    wall_share: Float[Array, " step"]

    @classmethod
    def of(cls, job: Job, run: Solution) -> "DrivenRun":
        """The run of a command.

        Args:
            job: The job, which has a robot.
            run: Its solution.

        **Differentiability**: smooth.
        """
        assert run.joint_positions is not None and run.motor_positions is not None
        known, commanded = JobKinematics(job), jnp.asarray(run.commanded)
        joints, _ = known.joints(commanded)
        return cls(
            known.motor_positions_from_joints(joints),
            known.motor_slopes(joints, commanded),
            run.joint_positions,
            run.motor_positions,
            run.wall_share,
        )
