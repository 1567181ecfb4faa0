"""A plant that is not known exactly: several of it, each with other parameters.

A correction that is best for one model may be worse than a milder one on the machine
as it is. The mean square over draws of the model's parameters is a least-squares
problem like that of one model, only with the residuals of all draws.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job
from ..._types import FloatRows, RealScalarLike
from ...process import AbstractAdjoint
from ...sim import command_motors, run_motors, with_scaled
from .._core.problem import Motion
from .._job.plant_segments import wall_motion
from .delay import delayed

Draws = Float[Array, "member parameter"] | Float[np.ndarray, "member parameter"]


class Ensemble(eqx.Module):
    """Draws of a plant's parameters.

    Attributes:
        plant: Maps the parameters of a member, shape (parameter,), and a command,
            shape (step, axis), to the motion that follows; traceable.
        draws: Parameters of the members, shape (member, parameter).
        weights: Shares of the members in a mean, which sum to 1, shape (member,);
            None for equal ones.
    """

    plant: Callable[..., Any]
    draws: Draws
    weights: Float[np.ndarray, " member"] | Float[Array, " member"] | None = None

    def roots(self, dtype: jnp.dtype) -> Float[Array, " member"]:
        """Return the roots of the weights, shape (member,)."""
        count = len(self.draws)
        equal = np.full(count, 1 / count)
        weights = equal if self.weights is None else self.weights
        return jnp.sqrt(jnp.asarray(weights, dtype))

    def motions(self, command: Float[Array, "step axis"]) -> Motion:
        """Return the motions of all members, stacked along their first axis.

        One after the other: memory grows by the results only.

        **Differentiability**: that of the plant.
        """
        draws = jnp.asarray(self.draws, command.dtype)
        return jax.lax.map(lambda draw: self.plant(draw, command), draws)


class ScaledPlant(eqx.Module):
    """A job with scaled parameters as a plant that is commanded by tip positions.

    The controller knows the job as it is, so that a stiffness that is not the true one
    leaves a part of the sag.

    Attributes:
        job: The job.
        adjoint: How to differentiate through the removal.
    """

    job: Job
    adjoint: AbstractAdjoint

    def __call__(
        self, log_scale: Float[Array, " parameter"], command: Float[Array, "step 3"]
    ) -> Motion:
        """Return the motion of one member, see `sim.with_scaled`."""
        motors, _ = command_motors(self.job, command)
        ran = run_motors(with_scaled(self.job, log_scale), motors, self.adjoint)
        return wall_motion(self.job, ran, None)


class LatePlant(eqx.Module):
    """A plant of an ensemble whose offsets come late to a program that is in time.

    A command that is late as a whole does the same, only later: nothing that an offset
    could make better.

    Attributes:
        plant: Maps parameters and a command to a motion, see `Ensemble`.
        nominal: The program, without offsets, shape (step, axis).
        time_step: Time between two rows [s].
    """

    plant: Callable[..., Any]
    nominal: FloatRows
    time_step: RealScalarLike

    def __call__(
        self,
        parameters: Float[Array, " parameter_and_delay"],
        command: Float[Array, "step axis"],
    ) -> Motion:
        """Return the motion of one member, whose last parameter is its delay [s]."""
        late = delayed(command, parameters[-1], self.time_step, nominal=self.nominal)
        return self.plant(parameters[:-1], late)


def with_delays(
    draws: Draws, *, largest: RealScalarLike, seed: int
) -> Float[np.ndarray, "member parameter_and_delay"]:
    """Return draws with a last column of delays, each in its own share of the span.

    A few draws from the whole span could all lie at one end of it; so each member gets
    one of as many equal parts of the span, in an order of its own.

    Args:
        draws: Parameters of the members, shape (member, parameter).
        largest: Largest delay [s], at least 0; the smallest is 0.
        seed: Seed of the delays.

    Returns:
        Parameters and delays, for a `LatePlant`, shape (member, parameter + 1).

    Raises:
        ValueError: The largest delay is negative.

    **Differentiability**: none, a host function.
    """
    if not largest >= 0:
        raise ValueError(f"Argument `largest` must be at least 0, but is {largest}.")
    # A stream of its own: the parameters of a seed stay what they are without delays.
    rng = np.random.default_rng([seed, 1])
    count = len(draws)
    share = (rng.permutation(count) + rng.uniform(size=count)) / count
    return np.column_stack([np.asarray(draws), float(largest) * share])


def draw_scales(
    names: tuple[str, ...],
    *,
    count: int,
    seed: int,
    stiffness: RealScalarLike = 0.0,
    damping: RealScalarLike = 0.0,
    force: RealScalarLike = 0.0,
    is_gaussian: bool = False,
) -> Float[np.ndarray, "member parameter"]:
    """Return draws of the logarithms of the parameters' factors.

    Args:
        names: `sim.parameter_names`.
        count: Number of members.
        seed: Seed of the draws.
        stiffness: Relative uncertainty of every joint's stiffness: half the width of
            an interval, or the standard deviation.
        damping: That of every joint's damping.
        force: That of every force coefficient.
        is_gaussian: Whether the logarithms are normal; else the factors are uniform in
            1 - uncertainty to 1 + uncertainty.

    Returns:
        Logarithms, shape (member, parameter); 0 for the speed.

    Raises:
        ValueError: An uncertainty is negative or, of an interval, not below 1.

    **Differentiability**: none, a host function.
    """
    kinds = {"K ": stiffness, "D ": damping}
    sizes = np.array(
        [0.0 if name == "speed" else kinds.get(name[:2], force) for name in names],
        np.float64,
    )
    if np.any(sizes < 0) or (not is_gaussian and np.any(sizes >= 1)):
        raise ValueError(
            "Arguments `stiffness`, `damping` and `force` must be at least 0 and, of "
            f"intervals, below 1, but are {stiffness}, {damping} and {force}."
        )
    rng = np.random.default_rng(seed)
    if is_gaussian:
        return sizes[None] * rng.normal(size=(count, len(names)))
    return np.log1p(sizes[None] * rng.uniform(-1, 1, size=(count, len(names))))
