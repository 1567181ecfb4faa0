"""A plant that is not known exactly: several of it, each with other parameters.

A correction that is best for one model may be worse than a milder one on the machine
as it is. The mean square over draws of the model's parameters is a least-squares
problem like that of one model, only with the residuals of all draws.
"""

import abc
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import parameter_uncertainty
from ..._types import FloatRows, RealScalarLike
from .._core.linear_motion import LinearMotion, linear_motion
from .._core.problem import AbstractHostPlant, Motion, Plant, motion_of

Draws = Float[Array, "member parameter"] | Float[np.ndarray, "member parameter"]
Parameters = Float[Array, " parameter"] | Float[np.ndarray, " parameter"]


class AbstractUncertainPlant(eqx.Module):
    """A plant whose parameters are not known exactly."""

    @abc.abstractmethod
    def member(self, parameters: Parameters) -> Plant:
        """Plant with given parameters, shape (parameter,)."""


class Ensemble(eqx.Module):
    """Draws of a plant's parameters.

    Attributes:
        plant: The uncertain plant, or a function of the parameters of a member, shape
            (parameter,), and a command, shape (step, axis); traceable.
        draws: Parameters of the members, shape (member, parameter).
        weights: Shares of the members in a mean, which sum to 1, shape (member,); None
            for equal ones. The worst case takes all alike.
    """

    plant: AbstractUncertainPlant | Callable[..., Motion]
    draws: Draws
    weights: Float[np.ndarray, " member"] | None = None

    def plants(self) -> tuple[Plant, ...]:
        """Plants of all members."""
        return tuple(member_of(self.plant, np.asarray(draw)) for draw in self.draws)

    @staticmethod
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
        """Draws of the logarithms of the parameters' factors.

        Args:
            names: `Job.parameter_names`.
            count: Number of members.
            seed: Seed of the draws.
            stiffness: Relative uncertainty of every joint's stiffness: half the width
                of an interval, or the standard deviation.
            damping: That of every joint's damping.
            force: That of every force coefficient, exponents aside.
            is_gaussian: Whether the logarithms are normal; else the factors are uniform
                in 1 - uncertainty to 1 + uncertainty.

        Returns:
            Logarithms, shape (member, parameter); 0 for the speed.

        Raises:
            ValueError: An uncertainty is negative or, of an interval, not below 1.

        **Differentiability**: none, a host function.
        """
        sizes = parameter_uncertainty(
            names, stiffness=stiffness, damping=damping, force=force
        )
        if np.any(sizes < 0) or (not is_gaussian and np.any(sizes >= 1)):
            raise ValueError(
                "Arguments `stiffness`, `damping` and `force` must be at least 0 and, "
                f"of intervals, below 1, but are {stiffness}, {damping} and {force}."
            )
        rng = np.random.default_rng(seed)
        if is_gaussian:
            return sizes[None] * rng.normal(size=(count, len(names)))
        return np.log1p(sizes[None] * rng.uniform(-1, 1, size=(count, len(names))))


class _Member(eqx.Module):
    """A function of parameters and a command, its parameters given."""

    plant: Callable[..., Motion]
    parameters: Parameters

    def __call__(self, command: Float[Array, "step axis"]) -> Motion:
        """Motion that follows a command, shape (step, axis)."""
        return self.plant(jnp.asarray(self.parameters, command.dtype), command)


def member_of(
    plant: AbstractUncertainPlant | Callable[..., Motion], parameters: Parameters
) -> Plant:
    """Uncertain plant with given parameters, shape (parameter,)."""
    if isinstance(plant, AbstractUncertainPlant):
        return plant.member(parameters)
    return _Member(plant, parameters)


class DelayedPlant(AbstractUncertainPlant):
    """A plant of an ensemble whose offsets come late to a program that is in time.

    A command that is late as a whole does the same, only later: nothing that an offset
    could make better.

    Attributes:
        plant: The plant that the late command reaches, see `Ensemble`.
        nominal: The program, without offsets, shape (step, axis).
        time_step: Time between two rows [s].
    """

    plant: AbstractUncertainPlant | Callable[..., Motion]
    nominal: FloatRows
    time_step: RealScalarLike

    def member(self, parameters: Parameters) -> "Delayed":
        """Plant of one member, whose last parameter is its delay [s]."""
        plant = member_of(self.plant, parameters[:-1])
        return Delayed(plant, parameters[-1], self.nominal, self.time_step)

    @staticmethod
    def with_delays(
        draws: Draws, *, largest: RealScalarLike, seed: int
    ) -> Float[np.ndarray, "member parameter_and_delay"]:
        """Draws with a last column of delays, each in its own share of the span.

        A few draws from the whole span could all lie at one end of it; so each member
        gets one of as many equal parts of the span, in an order of its own.

        Args:
            draws: Parameters of the members, shape (member, parameter).
            largest: Largest delay [s], at least 0; the smallest is 0.
            seed: Seed of the delays.

        Returns:
            Parameters and delays, for a `DelayedPlant`, shape (member, parameter + 1).

        Raises:
            ValueError: The largest delay is negative.

        **Differentiability**: none, a host function.
        """
        if not largest >= 0:
            raise ValueError(
                f"Argument `largest` must be at least 0, but is {largest}."
            )
        # A stream of its own: the parameters of a seed stay what they are without
        # delays.
        rng = np.random.default_rng([seed, 1])
        count = len(draws)
        share = (rng.permutation(count) + rng.uniform(size=count)) / count
        return np.column_stack([np.asarray(draws), float(largest) * share])


class Delayed(AbstractHostPlant):
    """A plant whose offsets come late.

    Attributes:
        plant: The plant that the late command reaches.
        delay: [s], shape ().
        nominal: The program, without offsets, shape (step, axis).
        time_step: Time between two rows [s].
    """

    plant: Callable[..., Motion]
    delay: RealScalarLike
    nominal: FloatRows
    time_step: RealScalarLike

    def late(self, command: Float[Array, "step axis"]) -> Float[Array, "step axis"]:
        """Command that the plant gets, shape (step, axis)."""
        delay = jnp.asarray(self.delay, command.dtype)
        return delayed(command, delay, self.time_step, nominal=self.nominal)

    def __call__(self, command: Float[Array, "step axis"]) -> Motion:
        """Motion that follows a command, shape (step, axis)."""
        return self.plant(self.late(command))

    def run(self, command: FloatRows) -> Motion:
        """Motion that follows a command, by compiled programs; not traceable."""
        return motion_of(self.plant, _late(self, jnp.asarray(command)))

    def linearised(self, command: FloatRows) -> LinearMotion:
        """Linear system around a command."""
        late = _late(self, jnp.asarray(command))
        inner = linear_motion(self.plant, late)
        return DelayedMotion(inner.motion, inner, self, jnp.asarray(command))


class DelayedMotion(LinearMotion):
    """The linear system behind a delay.

    Attributes:
        motion: The motion of the plant.
        inner: The linear system of the plant.
        late: The delay.
        command: Around which command, before the delay.
    """

    motion: Motion
    inner: LinearMotion
    late: Delayed
    command: Float[Array, "step axis"]

    def move(self, changes: Float[Array, "step axis direction"]) -> Motion:
        """Changes of the motion, each direction a row of the first axis."""
        _, jvp = jax.linearize(self.late.late, self.command)
        return self.inner.move(jax.vmap(jvp, in_axes=-1, out_axes=-1)(changes))


def delayed(
    command: FloatRows,
    delay: RealScalarLike,
    time_step: RealScalarLike,
    *,
    nominal: FloatRows | None = None,
) -> Float[Array, "step axis"]:
    """Command that comes late, shape (step, axis); before it, the first row counts.

    Between two rows a command moves linearly, as the simulation takes it.

    Args:
        command: The command, shape (step, axis).
        delay: Delay between the command and the motion it asks for [s], at least 0.
        time_step: Time between two rows [s].
        nominal: Where given, only the offset from it is late, as where a controller
            runs the program and takes corrections from outside, shape (step, axis).

    Returns:
        The late command, shape (step, axis).

    **Differentiability**: linear in the command; in the delay, kinks at multiples of
    the time step.
    """
    rows = jnp.asarray(command)
    if nominal is not None:
        base = jnp.asarray(nominal, rows.dtype)
        return base + delayed(rows - base, delay, time_step)
    late = jnp.asarray(delay, rows.dtype) / jnp.asarray(time_step, rows.dtype)
    place = jnp.maximum(jnp.asarray(np.arange(len(rows)), rows.dtype) - late, 0)
    first = jnp.minimum(jnp.floor(place).astype(jnp.int32), len(rows) - 2)
    share = (place - first.astype(rows.dtype))[:, None]
    return (1 - share) * rows[first] + share * rows[first + 1]


@eqx.filter_jit
def _late(
    plant: Delayed, command: Float[Array, "step axis"]
) -> Float[Array, "step axis"]:
    return plant.late(command)
