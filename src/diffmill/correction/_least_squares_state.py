"""The iteration of the least squares between two steps, and what it is made of."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from .._result import RESULTS
from .._types import RealScalarLike
from ._held_rows import HeldRows, LinearModel
from ._least_squares_records import (
    LeastSquaresMemory,
    LeastSquaresSolution,
    LeastSquaresStep,
    LevenbergMarquardt,
)
from ._products import Residual
from ._quadratic import projected_gradient

# A bound of all unknowns: one number, or one per unknown.
Bound = RealScalarLike | Float[Array, "*unknown"] | Float[np.ndarray, "*unknown"]


class Box(eqx.Module):
    """Bounds and scale of the unknowns x, in NumPy; inside, z = x / scale."""

    least: np.ndarray
    most: np.ndarray
    scale: np.ndarray
    dtype: np.dtype

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of z."""
        return self.least / self.scale

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of z."""
        return self.most / self.scale

    def point(self, z: np.ndarray) -> Array:
        """Return x on the device for a z, within the bounds to the last bit."""
        x = np.clip(z * self.scale, self.least, self.most)
        return jnp.asarray(x, self.dtype)

    def vector(self, p: np.ndarray) -> Array:
        """Return the difference of two x on the device for one of two z."""
        return jnp.asarray(p * self.scale, self.dtype)


class State(eqx.Module):
    """The iteration between two outer steps, in units of the scale."""

    z: np.ndarray
    cost: float
    gradient: np.ndarray
    linear: LinearModel | None
    residual: Array | None
    weight: float
    damping: float
    growth: float
    products: int
    forward_runs: int


def unit_box(start: Array, lower: Bound, upper: Bound, scale: Bound) -> Box:
    """Return the bounds in units of the scale.

    Raises:
        ValueError: They cross, or the scale is no positive number.
    """
    full = [
        np.broadcast_to(np.asarray(value, np.float64), start.shape)
        for value in (lower, upper, scale)
    ]
    if not np.all(full[0] <= full[1]):
        raise ValueError("Argument `lower` must not exceed `upper`, but does.")
    if not np.all((full[2] > 0) & np.isfinite(full[2])):
        raise ValueError("Argument `scale` must be positive and finite, but is not.")
    return Box(full[0], full[1], full[2], np.dtype(start.dtype))


def state_at(box: Box, start: Array) -> State:
    """Return the state at a start, of which only the linearisation is missing."""
    z = np.clip(np.asarray(start, np.float64) / box.scale, box.lower, box.upper)
    return State(z, np.inf, z, None, None, 0.0, 0.0, 2.0, 0, 0)


def state_of(memory: LeastSquaresMemory) -> State:
    """Return the state of which only the linearisation is missing."""
    return State(
        z=memory.z,
        cost=np.inf,
        gradient=memory.z,
        linear=None,
        residual=None,
        weight=0.0,
        damping=memory.damping,
        growth=memory.growth,
        # The linearisation has been counted.
        products=memory.products - 1,
        forward_runs=memory.forward_runs - 1,
    )


def memory_of(
    state: State, first_kkt: float, is_done: bool, history: list[LeastSquaresStep]
) -> LeastSquaresMemory:
    """Return what is needed to go on from a state."""
    return LeastSquaresMemory(
        z=state.z,
        damping=state.damping,
        growth=state.growth,
        first_kkt=first_kkt,
        is_done=bool(is_done),
        products=state.products,
        forward_runs=state.forward_runs,
        history=tuple(history),
    )


def linearised(
    solver: LevenbergMarquardt,
    residual: Residual,
    args: PyTree,
    box: Box,
    held: HeldRows,
    state: State,
) -> State:
    """Return the state with residual, gradient and linear program at its z."""
    r, program = solver.products.linearise(residual, box.point(state.z), args)
    model = LinearModel(solver.products, program, box.vector, box.scale)
    weight = held.weight(r)
    gradient = model.gradient(held.slope(r, weight))
    model.spent = 0
    return State(
        z=state.z,
        cost=held.cost(r, weight),
        gradient=gradient,
        linear=model,
        residual=r,
        weight=weight,
        damping=state.damping,
        growth=state.growth,
        products=state.products + 1,
        forward_runs=state.forward_runs + 1,
    )


def normal(held: HeldRows, state: State, p: np.ndarray) -> np.ndarray:
    """Return J^T J p in units of the scale, rows that are held left out."""
    model, _ = model_at(state)
    return model.transpose(held.without(model.forward(p)))


def model_at(state: State) -> tuple[LinearModel, Array]:
    """Return the linear model at a state and its residual, which must be there."""
    assert state.linear is not None and state.residual is not None
    return state.linear, state.residual


def first_damping(solver: LevenbergMarquardt, held: HeldRows, state: State) -> State:
    """Set the damping relative to the curvature along the gradient."""
    g = state.gradient
    curvature = np.sum(g * normal(held, state, g)) / max(np.sum(g**2), 1e-300)
    return dataclasses.replace(
        state,
        damping=solver.damping * float(curvature),
        products=state.products + take_spent(state),
    )


def take_spent(state: State) -> int:
    """Return the products since the last count, and count anew."""
    model, _ = model_at(state)
    spent, model.spent = model.spent, 0
    return spent


def largest_slope(state: State, box: Box) -> float:
    """Return the largest entry of the projected gradient."""
    entries = projected_gradient(state.z, state.gradient, box.lower, box.upper)
    return float(np.max(np.abs(entries)))


def solution_at(
    box: Box,
    held: HeldRows,
    state: State,
    history: list[LeastSquaresStep],
    result: RESULTS,
) -> LeastSquaresSolution:
    """Return the solution at a state."""
    _, residual = model_at(state)
    return LeastSquaresSolution(
        x=box.point(state.z),
        cost=state.cost,
        history=tuple(history),
        result=result,
        held=held.rows(residual) if held.count else np.zeros(0),
    )
