"""Sensitivity of the deviation to each parameter of machine and cut.

Forward mode beside one simulation per parameter: exact derivatives, in the memory of a
simulation. All parameters are taken relative: a derivative with respect to ln p says
what a change of p by its own size would do to first order, so that a hundredth of it is
the effect of 1 % and parameters of any unit can be compared.
"""

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job
from ..._types import FloatRows3
from ...process import FrozenStock, ThroughPoses, wall_deviation, wall_shares
from ...toolpath import contour_error, contour_vector
from .._job.simulate import MachiningProblem, rigid_cut
from .._machine.commands import JobKinematics

if TYPE_CHECKING:
    import xarray


class Sensitivity(eqx.Module):
    """Derivatives with respect to the logarithms of the parameters.

    Attributes:
        names: "K" and "D" with the joint's name for stiffness and damping, the force
            law's own names, and "speed": spindle and feed together, the chip unchanged.
        deviation: d(deviation) / d(ln p) [m], shape (parameter, step, 3).
        contour_vector: d(contour vector) / d(ln p) [m], shape (parameter, step, 3):
            how far the tool moves across the path.
        contour_error: d(contour error) / d(ln p) [m], shape (parameter, step): the
            part of it along the contour vector. Where a correction leaves nearly
            none, its sign says little.
        time: [s], shape (step,).
    """

    names: tuple[str, ...] = eqx.field(static=True)
    deviation: Float[np.ndarray, "parameter step 3"]
    contour_vector: Float[np.ndarray, "parameter step 3"]
    contour_error: Float[np.ndarray, "parameter step"]
    time: Float[np.ndarray, " step"]

    def to_dataset(self) -> "xarray.Dataset":
        """Return the maps as an `xarray.Dataset` on parameter, step and axis."""
        import xarray

        text = "change per relative change of the parameter of the"
        return xarray.Dataset(
            {
                "sensitivity_deviation": (
                    ("parameter", "step", "axis"),
                    self.deviation,
                    {"units": "m", "long_name": f"{text} deviation"},
                ),
                "sensitivity_contour_vector": (
                    ("parameter", "step", "axis"),
                    self.contour_vector,
                    {"units": "m", "long_name": f"{text} contour vector"},
                ),
                "sensitivity_contour_error": (
                    ("parameter", "step"),
                    self.contour_error,
                    {"units": "m", "long_name": f"{text} contour error"},
                ),
            },
            coords={"parameter": list(self.names), "axis": ["x", "y", "z"]},
        )


def sensitivity(job: Job, *, commanded: FloatRows3 | None = None) -> Sensitivity:
    """Sensitivity of the tool's motion along the path to each parameter.

    The place of the work is found with the arm itself: a controller that lifts the sag
    lifts that of each stiffness.

    Args:
        job: The job; its machine must not be rigid.
        commanded: Tip positions that the program commands instead of the desired
            path [m], shape (step, 3).

    Returns:
        The maps, one row per stiffness, damping, force coefficient, and the speed.

    Raises:
        ValueError: The machine is rigid, or JAX is not set up for its precision.

    Differentiability: runs on the host, not traceable.
    """
    job = job.with_precision()
    if job.is_rigid:
        raise ValueError("Argument `job` must not have a rigid machine, but has.")
    command = job.path.positions if commanded is None else commanded
    dtype = jnp.dtype(job.simulation.precision)
    command = jnp.asarray(command, dtype)
    names = job.parameter_names
    # The side of the wall, and with it the instant, is seen in what is left.
    finished = rigid_cut(job, FrozenStock()).stock
    shares = wall_shares(
        jnp.asarray(job.path.positions), job.tool_axes, job.cutter, finished
    )
    pushed = [
        _path_derivatives(
            job, command, shares, jnp.zeros(len(names), dtype).at[k].set(1)
        )
        for k in range(len(names))
    ]
    return Sensitivity(
        names=names,
        deviation=np.stack([np.asarray(way.deviation) for way in pushed]),
        contour_vector=np.stack([np.asarray(way.contour_vector) for way in pushed]),
        contour_error=np.stack([np.asarray(way.contour_error) for way in pushed]),
        time=np.asarray(job.path.time),
    )


class _PathDerivatives(eqx.Module):
    """Tip and contour, or their derivatives in one direction [m]."""

    deviation: Float[Array, "step 3"]
    contour_vector: Float[Array, "step 3"]
    contour_error: Float[Array, " step"]


@eqx.filter_jit
def _path_derivatives(
    job: Job,
    command: Float[Array, "step 3"],
    shares: Float[Array, " step"],
    direction: Float[Array, " parameter"],
) -> _PathDerivatives:
    """Return the derivatives of the tip and of its contour error in a direction."""
    joints, _ = JobKinematics(job).joints(command)
    desired = jnp.asarray(job.path.positions)

    def errors(log_scale: Float[Array, " parameter"]) -> _PathDerivatives:
        scaled = job.with_scaled(log_scale)
        motors = JobKinematics(scaled).motor_positions_from_joints(joints)
        ran = MachiningProblem.of(scaled, ThroughPoses()).run(motors)
        at = desired + wall_deviation(ran.ends, desired, shares)
        return _PathDerivatives(
            ran.actual, contour_vector(at, desired), contour_error(at, desired)
        )

    return jax.jvp(errors, (jnp.zeros_like(direction),), (direction,))[1]
