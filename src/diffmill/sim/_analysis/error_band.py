"""Band of expected error: what is left when the model is not quite the machine.

Stiffness, damping and force coefficients are known to some percent. Each that is off by
its standard deviation moves the tool by one column of the linear system around the run;
independent of each other, their squares add up to the covariance of the tool's place.
The stock is held: how a surface moves with the poses that cut it is left out.

The place of the work is found with the arm itself, so what is off where the path begins
is no error of the part: a stiffness that is off shows by how the sag changes along the
path, not by the sag. With errors of links, servos, reversal, registration or run-out
the work is touched off anew, see `MachineColumns`.
"""

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..._job import Job, parameter_uncertainty
from ...process import FrozenStock, wall_deviation
from ...toolpath import contour_vector
from .._job.simulate import Solution, job_machine, job_process
from .._linear.linear_run import linearise
from .._linear.period_slopes import CuttingMachine
from .._machine.commands import JobKinematics
from .._truth.machine_columns import MachineColumns

if TYPE_CHECKING:
    import xarray


class ErrorBand(eqx.Module):
    """The contour error that is to be expected of a machine like the model.

    Attributes:
        names: The parameters that scatter, as of `parameter_names`.
        shift: Change of the contour vector by one standard deviation of each [m],
            shape (parameter, step, 3).
        contour_error: Of the model [m], shape (step,); of the machine with the mean
            friction, gaps and run-out, where these scatter.
        is_cutting: Whether the rigid tool cuts in the period before, shape (step,).
    """

    names: tuple[str, ...] = eqx.field(static=True)
    shift: Float[np.ndarray, "parameter step 3"]
    contour_error: Float[np.ndarray, " step"]
    is_cutting: Bool[np.ndarray, " step"]

    @property
    def spread(self) -> Float[np.ndarray, " step"]:
        """Return the standard deviation of the tool across the path [m]."""
        return np.sqrt(np.sum(self.shift**2, axis=(0, 2)))

    @property
    def expected(self) -> Float[np.ndarray, " step"]:
        """Return the root mean square contour error over machines [m]."""
        return np.hypot(self.contour_error, self.spread)

    @property
    def rms(self) -> float:
        """Return the expected root mean square error where the tool cuts [m]."""
        return float(np.sqrt(np.mean(self.expected[self.is_cutting] ** 2)))

    def shares(self) -> dict[str, float]:
        """Return the rms by each parameter where the tool cuts [m], largest first."""
        square = np.mean(np.sum(self.shift[:, self.is_cutting] ** 2, axis=2), axis=1)
        found = dict(zip(self.names, np.sqrt(square).tolist(), strict=True))
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    def to_dataset(self) -> "xarray.Dataset":
        """Return spread and expected error as an `xarray.Dataset` on step."""
        import xarray

        text = "with the scatter of the model's parameters"
        return xarray.Dataset(
            {
                "contour_error_spread": (
                    "step",
                    self.spread,
                    {"units": "m", "long_name": f"standard deviation {text}"},
                ),
                "contour_error_expected": (
                    "step",
                    self.expected,
                    {"units": "m", "long_name": f"rms contour error {text}"},
                ),
            },
            attrs={"expected_contour_error_rms_m": self.rms},
        )


def error_band(job: Job, solution: Solution) -> ErrorBand:
    """Return the error to be expected under `job.simulation.scatter`.

    The motors do what they do in the solution: the controller knows the model alone.

    Args:
        job: The job; its machine must not be rigid, and its scatter be given.
        solution: Its solution.

    Returns:
        The band.

    Raises:
        ValueError: The machine is rigid, the job has no scatter, or JAX is not set up
            for its precision.

    Differentiability: runs on the host, not traceable.
    """
    job = job.with_precision()
    scatter = job.simulation.scatter
    if scatter is None:
        raise ValueError("Argument `job` must have `simulation.scatter`, but has None.")
    if scatter.robot_errors:
        if job.robot is None or not job.simulation.mode.vibrates:
            raise ValueError(
                "Argument `job` must have a robot that swings for a scatter of "
                f"{', '.join(scatter.robot_errors)}."
            )
        columns = MachineColumns.about(job, solution, scatter)
        return ErrorBand(
            names=columns.names,
            shift=columns.shift,
            contour_error=np.asarray(columns.mean.contour_error),
            is_cutting=np.asarray(solution.is_cutting),
        )
    motors = solution.motor_positions
    if motors is None:
        motors, _ = JobKinematics(job).motors(jnp.asarray(solution.commanded))
        if job.controller is not None:
            motors = job.controller.motors(motors, job.tooth_period)
    names = job.parameter_names[:-1]
    sizes = parameter_uncertainty(
        names, stiffness=scatter.stiffness, damping=scatter.damping, force=scatter.force
    )
    kept = [k for k, size in enumerate(sizes) if size > 0]
    directions = np.zeros((len(names) + 1, len(kept)))
    directions[kept, np.arange(len(kept))] = [sizes[k] for k in kept]
    shift = _shifts(job, motors, solution.wall_share, jnp.asarray(directions))
    return ErrorBand(
        names=tuple(names[k] for k in kept),
        shift=np.asarray(shift),
        contour_error=np.asarray(solution.contour_error),
        is_cutting=np.asarray(solution.is_cutting),
    )


@eqx.filter_jit
def _shifts(
    job: Job,
    motors: Float[Array, "step joint"],
    shares: Float[Array, " step"],
    directions: Float[Array, "parameter direction"],
) -> Float[Array, "direction step 3"]:
    """Return the changes of the contour vector in some directions of the parameters."""
    desired = jnp.asarray(job.path.positions)

    def model(_: CuttingMachine | None, parameters: Array) -> CuttingMachine:
        scaled = job.with_scaled(parameters)
        return CuttingMachine(job_machine(scaled), job_process(scaled, FrozenStock()))

    count = directions.shape[0]
    machine, process = model(None, jnp.zeros(count, desired.dtype))
    run = linearise(machine, process, motors, scaled=model, parameter_count=count)
    still = jnp.zeros((*motors.shape, directions.shape[1]), desired.dtype)
    moved = run.move(still, directions.astype(desired.dtype))
    at = desired + job.path.disturbed(wall_deviation(run.ends, desired, shares))

    def across(ends: Float[Array, "step substep 3"]) -> Float[Array, "step 3"]:
        change = wall_deviation(ends, jnp.zeros_like(desired), shares)
        # The place of the work was probed with the arm as it hangs at the start.
        change = change - change[:1]
        return jax.jvp(lambda x: contour_vector(x, desired), (at,), (change,))[1]

    return jax.vmap(across, in_axes=-1)(moved.ends)
