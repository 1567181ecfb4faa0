"""Offsets of a command as pure functions for optimisers of other packages.

`optimistix`, `optax` and `scipy` want a function of the unknowns and of constant
arguments, those arguments, and a start. Unknowns are the coefficients of the offset in
units of the largest that is allowed, so that all of them are of the size of one.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import RealScalarLike
from .._core.path_objective import AbstractObjective, PathObjective
from .._core.problem import Motion, Problem
from .._spline.spline_offsets import SplineOffsets
from .offset_fit import ContourResidual, command_of

Unknowns = Float[Array, "coefficient axis"]


class OffsetResidual(eqx.Module):
    """Pure functions of the offsets of a command, their arguments and a start.

    Every function takes the unknowns, shape (coefficient, axis), in units of
    `max_offset`, and `args`; none of them looks at anything else, so that `jit`,
    `grad`, `jvp` and `vmap` apply.

    Attributes:
        args: The problem, the basis of the offsets and the objective: arrays of JAX.
        start: Unknowns of the uncorrected command, all zero.
    """

    args: ContourResidual
    start: Unknowns

    @staticmethod
    def residual(unknowns: Unknowns, args: ContourResidual) -> Float[Array, " error"]:
        """Weighted errors, in units of 0.1 mm, and the roughness [-].

        With the path as the objective, the square is (rms contour error / 0.1 mm)^2
        over the rows that cut, and little terms that keep the command from drifting
        along the path and from being rough.

        **Differentiability**: that of the plant; kinks where the nearest segment of the
        path changes.
        """
        return args(_scaled(unknowns, args))

    @staticmethod
    def cost(unknowns: Unknowns, args: ContourResidual) -> Float[Array, ""]:
        """Half the square of the residual [-], shape ().

        **Differentiability**: as `residual`.
        """
        return 0.5 * jnp.sum(OffsetResidual.residual(unknowns, args) ** 2)

    @staticmethod
    def command(unknowns: Unknowns, args: ContourResidual) -> Float[Array, "step axis"]:
        """Whole command, shape (step, axis): tips [m] of a job."""
        return command_of(_scaled(unknowns, args), args)

    @staticmethod
    def motion(unknowns: Unknowns, args: ContourResidual) -> Motion:
        """Motion of the plant that follows the command, for an objective of one's own.

        **Differentiability**: that of the plant.
        """
        return args.problem.plant(OffsetResidual.command(unknowns, args))


def offset_residual(
    problem: Problem,
    *,
    knot_spacing: float,
    objective: AbstractObjective = PathObjective(),
    smoothness: RealScalarLike = 1e-2,
    lag_weight: RealScalarLike = 0.03,
) -> OffsetResidual:
    """Offsets of a problem as pure functions.

    Args:
        problem: The problem.
        knot_spacing: Smallest spacing of the knots [s].
        objective: The error that is to become small.
        smoothness: Weight of the roughness, see `GaussNewton`.
        lag_weight: Weight of the deviation along the path, see `GaussNewton`.
    """
    nominal = jnp.asarray(problem.nominal)
    rows, axes = nominal.shape
    spline = SplineOffsets(rows, problem.time_step, knot_spacing)
    weight = lambda value: jnp.asarray(value, nominal.dtype)
    args = ContourResidual(
        problem,
        spline,
        weight(smoothness),
        weight(lag_weight),
        objective,
    )
    arrays = lambda leaf: jnp.asarray(leaf) if isinstance(leaf, np.ndarray) else leaf
    start = jnp.zeros((spline.coefficient_count, axes), nominal.dtype)
    return OffsetResidual(jax.tree.map(arrays, args), start)


def _scaled(unknowns: Unknowns, args: ContourResidual) -> Unknowns:
    return unknowns * jnp.asarray(args.problem.max_offset, unknowns.dtype)
