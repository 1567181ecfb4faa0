"""How the motion of a plant changes with its command, around one command.

A plant that knows its linear system says so (`HasLinearMotion`); of any other JAX
stores the linear program of its run.
"""

import abc
from typing import Protocol, cast, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from ..._types import FloatRows
from .problem import Motion, Plant


class LinearMotion(eqx.Module):
    """A motion and how it changes with the command."""

    motion: eqx.AbstractVar[Motion]

    @abc.abstractmethod
    def move(self, changes: Float[Array, "step axis direction"]) -> Motion:
        """Changes of the motion, each direction a row of the first axis.

        Args:
            changes: Of the command, shape (step, axis, direction).

        **Differentiability**: linear.
        """


@runtime_checkable
class HasLinearMotion(Protocol):
    """A plant that knows its linear system."""

    def linearised(self, command: FloatRows) -> LinearMotion | None:
        """Linear system around a command; None where it is not known."""
        ...


class TracedMotion(LinearMotion):
    """The linear program that JAX stores of a run.

    Attributes:
        motion: The motion.
        jvp: Maps a change of the command to that of the motion, a tree.
    """

    motion: Motion
    jvp: PyTree

    def move(self, changes: Float[Array, "step axis direction"]) -> Motion:
        """Changes of the motion, each direction a row of the first axis."""
        return jax.vmap(self.jvp, in_axes=-1)(changes)


def linear_motion(plant: Plant, command: FloatRows) -> LinearMotion:
    """Motion of a plant and its linear system around a command.

    Args:
        plant: The plant.
        command: The whole command, shape (step, axis).

    **Differentiability**: none, a host function.
    """
    system = plant.linearised(command) if isinstance(plant, HasLinearMotion) else None
    if system is not None:
        return system
    return _traced(cast(Plant, plant), jnp.asarray(command))


@eqx.filter_jit
def _traced(plant: Plant, command: Float[Array, "step axis"]) -> TracedMotion:
    return TracedMotion(*jax.linearize(plant, command))
