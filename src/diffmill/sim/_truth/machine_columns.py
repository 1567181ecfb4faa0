"""Changes of a run with each error of its machine, by one linear system.

Left out: that a cut and a mass push on joints which are turned, so that errors of links
bend the machine otherwise, by its own deflection times the angle.
"""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from ..._job import Job
from ...process import FrozenStock, wall_deviation
from ...robot import NominalRobot, forward_kinematics
from ...settings.machine_errors import MachineErrorSettings
from ...toolpath import contour_vector
from .._job.simulate import Solution, job_machine, job_process
from .._linear.drive_torques import drive_torques
from .._linear.driven_run import DrivenRun
from .._linear.linear_run import linearise
from .._linear.period_slopes import CuttingMachine
from .machine_errors import POSITIVE, MachineErrors
from .mismatched import nominal_robot

# Mean and standard deviation of a half-normal error, in units of its size.
_MEAN, _DEVIATION = math.sqrt(2 / math.pi), math.sqrt(1 - 2 / math.pi)


class MachineColumns(eqx.Module):
    """Changes of the contour vector with the errors of a machine.

    Attributes:
        mean: Run on the machine with the means of the errors that are not negative.
        shift: Change by a standard deviation of each error [m], shape (error, step, 3).
        names: Names of the errors.
    """

    mean: Solution
    shift: Float[np.ndarray, "error step 3"]
    names: tuple[str, ...] = eqx.field(static=True)

    @classmethod
    def about(
        cls, job: Job, solution: Solution, settings: MachineErrorSettings
    ) -> "MachineColumns":
        """Changes about the run of a command.

        Args:
            job: The job, in its precision, with a robot that swings.
            solution: Its solution.
            settings: Standard deviations; of friction, gaps and run-out the sizes of
                half-normal distributions.

        Raises:
            SimulationFailed: The mean machine does not run.
        """
        sizes = MachineErrors.sizes(job, settings)
        shares = lambda signed, positive: sizes.each_by(
            lambda name, size: size * (positive if name in POSITIVE else signed)
        )
        scatter = _Scatter(
            job,
            nominal_robot(job),
            shares(0.0, _MEAN),
            shares(1.0, _DEVIATION),
            settings.presliding,
        )
        commanded = jnp.asarray(solution.commanded)
        run = lambda machine: Solution.of_command(
            machine, solution.rigid, commanded, FrozenStock()
        )
        middle = scatter.machine(None)
        mean = around = run(middle)
        mean.raise_unless_successful(middle)
        if sizes.backlash is not None:
            around = run(_with_round_gaps(middle))
        driven = DrivenRun.of(middle, around)
        kept = np.flatnonzero(np.asarray(ravel_pytree(scatter.deviation)[0]))
        names = sizes.names(job)
        shift = _shifts(scatter, driven, jnp.asarray(kept))
        return cls(mean, np.asarray(shift), tuple(names[k] for k in kept))


def _with_round_gaps(job: Job) -> Job:
    """Job whose gaps have corners as wide as they can be.

    Slopes at a sharp corner hold for a micrometre.
    """
    assert job.robot is not None
    if job.robot.backlash is None:
        return job
    robot = job.robot.with_backlash(job.robot.backlash.gap, corner=1.0)
    return dataclasses.replace(job, robot=robot)


class _Scatter(eqx.Module):
    """Machines about a model.

    Attributes:
        model: The job on its model.
        known: What the controller knows.
        mean: Means of the errors.
        deviation: Their standard deviations.
        presliding: By which a joint with friction yields before it slides [rad].
    """

    model: Job
    known: NominalRobot
    mean: MachineErrors
    deviation: MachineErrors
    presliding: float = eqx.field(static=True)

    def errors(self, x: Float[Array, " error"] | None) -> MachineErrors:
        """Errors at some parameters, in units of the deviations; None for the mean."""
        if x is None:
            return self.mean
        mean, unravel = ravel_pytree(self.mean)
        change = ravel_pytree(self.deviation)[0] * x.astype(mean.dtype)
        return unravel(mean + change)

    def machine(self, x: Float[Array, " error"] | None) -> Job:
        """Job on the machine of some parameters, touched off."""
        return self.errors(x).machine_of(self.model, self.known, self.presliding)


@eqx.filter_jit
def _shifts(
    scatter: _Scatter, around: DrivenRun, kept: Int[Array, " error"]
) -> Float[Array, "error step 3"]:
    """Changes of the contour vector with the errors that scatter."""
    size, _ = ravel_pytree(scatter.deviation)
    zero = jnp.zeros(kept.shape, around.motors.dtype)
    of = lambda x: jnp.zeros(size.shape, x.dtype).at[kept].set(x)
    at = lambda x: _with_round_gaps(scatter.machine(of(x)))
    job = at(zero)
    joints, period = around.joints, job.tooth_period
    desired = jnp.asarray(job.path.positions)

    def tips(x: Array) -> Float[Array, "step 3"]:
        """Tips on the part, with the joints where they are."""
        machine = at(x)
        T, robot = jnp.asarray(machine.T_base_work), machine.robot
        assert robot is not None
        p = jax.vmap(lambda q: forward_kinematics(robot, q)[:3, 3])(joints)
        return (p - T[:3, 3][None]) @ T[:3, :3]

    def parameters(x: Array) -> Float[Array, " parameter"]:
        """Logarithms of factors, with that of the speed, and the run-out."""
        errors = scatter.errors(of(x))
        runout = 0.0 if errors.runout is None else errors.runout
        return jnp.concatenate([errors.scale, jnp.stack([0.0, runout])])

    # Motors that move the tip as links and frame do.
    motors = jnp.einsum("kja,kap->kjp", around.slopes, jax.jacfwd(tips)(zero))
    if scatter.deviation.bandwidth is not None:

        def driven(x: Array) -> Float[Array, "step joint"]:
            controller = at(x).controller
            assert controller is not None
            return controller.motors(around.motors, period)

        motors = motors + jax.jacfwd(driven)(zero)
    # Stiffness and damping are parameters of the linear system.
    is_scale = kept < scatter.deviation.scale.size
    torque = drive_torques(at, zero, joints, around.driven, period)
    torque = jnp.where(is_scale[None, None], 0.0, torque)
    directions = jax.jacfwd(parameters)(zero).astype(zero.dtype)
    plain = dataclasses.replace(job, nominal=None)

    def model(_: CuttingMachine | None, change: Array) -> CuttingMachine:
        scaled = plain.with_scaled(change[:-1])
        if scatter.deviation.runout is not None:
            runout = jnp.asarray(scaled.cutter.runout) + change[-1]
            scaled = eqx.tree_at(lambda j: j.cutter.runout, scaled, runout)
        return CuttingMachine(job_machine(scaled), job_process(scaled, FrozenStock()))

    count = directions.shape[0]
    machine, process = model(None, jnp.zeros(count, zero.dtype))
    command = jnp.concatenate([around.driven, jnp.zeros_like(joints)], axis=1)
    run = linearise(machine, process, command, scaled=model, parameter_count=count)
    moved = run.move(jnp.concatenate([motors, torque], axis=1), directions)
    shares = around.wall_share
    place = desired + job.path.disturbed(wall_deviation(run.ends, desired, shares))

    def across(ends: Float[Array, "step substep 3"]) -> Float[Array, "step 3"]:
        change = wall_deviation(ends, jnp.zeros_like(desired), shares)
        return jax.jvp(lambda x: contour_vector(x, desired), (place,), (change,))[1]

    return jax.vmap(across, in_axes=-1)(moved.ends)
