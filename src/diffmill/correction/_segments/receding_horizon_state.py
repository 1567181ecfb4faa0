"""A path run piece by piece: what has been done so far, and the rows of a segment."""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import FloatRows
from ...optimise import LeastSquaresStep
from .._core.linear_motion import LinearMotion, linear_motion
from .._core.problem import Motion, Problem
from .._method.checkpoint import (
    Arrays,
    below,
    pack_history,
    pack_tree,
    under,
    unpack_history,
    unpack_tree,
)
from .._spline.spline_offsets import CLAMPED, SplineOffsets
from .plant_segment import AbstractPiece


class HorizonRun(eqx.Module):
    """State at the end of a segment.

    Attributes:
        sweep: How many sweeps have been finished before.
        row: First row that has not been run; the number of rows at the end.
        coefficients: Of the whole program, the clamped included.
        state: The plant's at that row.
        square: Sum of the weighted squares of the contour error so far [m^2].
        history: Steps of all segments so far.
        unsettled: Segments of this sweep in which the steps ran out before the
            optimiser settled.
    """

    sweep: int
    row: int
    coefficients: np.ndarray
    state: Any
    square: float
    history: tuple[LeastSquaresStep, ...]
    unsettled: int = 0


class PaddedPiece(eqx.Module):
    """A piece with still rows before and after it, which only the contour looks at."""

    piece: AbstractPiece
    reach: int = eqx.field(static=True)

    def __call__(self, command: Float[Array, "step axis"]) -> Motion:
        """Return the motion, its first and last row repeated."""
        return self.run(command)[0]

    def run(self, command: Float[Array, "step axis"]) -> tuple[Motion, Any]:
        """Return the motion and the plant's state at the piece's last row."""
        motion, state = self.piece.run(command[self.reach : -self.reach])
        return _repeated(motion, self.reach), state

    def linearised(self, command: FloatRows) -> "PaddedMotion":
        """Return the linear system around a command."""
        inner = linear_motion(_Rows(self.piece), command[self.reach : -self.reach])
        return PaddedMotion(_repeated(inner.motion, self.reach), inner, self.reach)


class PaddedMotion(LinearMotion):
    """The linear system of a piece with still rows before and after it.

    Attributes:
        motion: The motion with these rows.
        inner: The linear system of the piece.
        reach: Still rows at either end.
    """

    motion: Motion
    inner: LinearMotion
    reach: int = eqx.field(static=True)

    def move(self, changes: Float[Array, "step axis direction"]) -> Motion:
        """Return the changes of the motion, each direction a row of the first axis."""
        return _repeated(self.inner.move(changes[self.reach : -self.reach]), self.reach)


class _Rows(eqx.Module):
    """A piece as a plant."""

    piece: AbstractPiece

    def __call__(self, command: Float[Array, "step axis"]) -> Motion:
        """Return the motion that follows a command, shape (step, axis)."""
        return self.piece.run(command)[0]

    def linearised(self, command: FloatRows) -> LinearMotion | None:
        """Return the linear system around a command, if the piece knows it."""
        return self.piece.linearised(command)


def _repeated(motion: Motion, reach: int) -> Motion:
    """Return a motion with its first and last rows repeated."""
    pad = lambda x: jnp.pad(
        x, (*((0, 0),) * (x.ndim - 2), (reach, reach), (0, 0)), mode="edge"
    )
    return Motion(pad(motion.actual), pad(motion.force))


@eqx.filter_jit
def advance(
    part: Problem, command: Float[Array, "step axis"]
) -> tuple[Any, Float[Array, ""]]:
    """Return the state at a piece's last row, and its sum of squared errors.

    The last row belongs to the piece after.
    """
    padded: Any = part.plant
    motion, state = padded.run(command)
    weights = jnp.asarray(part.is_cutting, command.dtype)
    weights = weights.at[-1 - part.window].set(0)
    square = jnp.sum(part.contour(motion) ** 2, axis=1)
    return state, jnp.sum(jnp.where(weights > 0, weights * square, 0))


def part_of(problem: Problem, piece: Any, state: Any, row: int, count: int) -> Problem:
    """Return the problem of some rows, with more around them that do not count."""
    rows, reach = problem.nominal.shape[0], problem.window
    inner = np.arange(row, row + count)
    around = np.clip(np.arange(row - reach, row + count + reach), 0, rows - 1)
    weights = np.asarray(problem.is_cutting)[np.minimum(inner, rows - 1)]
    weights = np.pad(np.where(inner < rows, weights, 0), reach)
    plant = PaddedPiece(piece(state, np.minimum(inner, rows - 1)), reach)
    return dataclasses.replace(
        problem,
        plant=plant,
        nominal=np.asarray(problem.nominal)[around],
        desired=np.asarray(problem.desired)[around],
        is_cutting=weights,
    )


def command_at(
    problem: Problem,
    spline: SplineOffsets,
    coefficients: np.ndarray,
    row: int,
    count: int,
    reach: int = 0,
) -> Float[Array, "step axis"]:
    """Return the command at some rows, and at some more around them."""
    nominal = np.asarray(problem.nominal)
    offsets = spline.offsets(jnp.asarray(coefficients[CLAMPED:-CLAMPED], nominal.dtype))
    command = nominal + np.asarray(offsets)
    at = np.clip(np.arange(row - reach, row + count + reach), 0, len(nominal) - 1)
    return jnp.asarray(command[at])


def rms_so_far(problem: Problem, run: HorizonRun, counted: int) -> float:
    """Return the rms contour error of the rows that count so far [m]."""
    weight = float(np.sum(np.asarray(problem.is_cutting)[:counted]))
    return float(np.sqrt(run.square / weight)) if weight > 0 else 0.0


def pack_run(run: HorizonRun) -> dict[str, np.ndarray]:
    """Return a run as arrays for a checkpoint."""
    return {
        "sweep": np.asarray(run.sweep),
        "row": np.asarray(run.row),
        "coefficients": run.coefficients,
        "square": np.asarray(run.square),
        "history": pack_history(run.history),
        "unsettled": np.asarray(run.unsettled),
        **under("state", pack_tree(run.state)),
    }


def unpack_run(arrays: Arrays, like: HorizonRun) -> HorizonRun:
    """Return the run that `pack_run` was given; `like` has a state of the same form."""
    return HorizonRun(
        int(arrays["sweep"]),
        int(arrays["row"]),
        np.asarray(arrays["coefficients"]),
        unpack_tree(below("state", arrays), like.state),
        float(arrays["square"]),
        unpack_history(arrays["history"]),
        int(arrays["unsettled"]),
    )
