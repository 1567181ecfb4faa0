"""A path run piece by piece: what has been done so far, and the rows of a segment."""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from ..._types import FloatRows
from ...optimise import LeastSquaresStep
from .._core.linear_motion import LinearMotion, linear_motion
from .._core.problem import Motion, Problem
from .._spline.spline_offsets import CLAMPED, SplineOffsets
from .plant_segment import AbstractPiece, AbstractPieces


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
    state: PyTree
    square: float
    history: tuple[LeastSquaresStep, ...]
    unsettled: int = 0


# Rows of numbers, on a device or on the host.
AnyRows = Float[Array, "row ..."] | Float[np.ndarray, "row ..."]


class StillRows(eqx.Module):
    """Rows around a piece in which its motion rests.

    Attributes:
        reach: Rows at either end, which only the contour looks at.
        ahead: Rows behind the last one whose command the piece looks at, before those.
    """

    reach: int = eqx.field(static=True)
    ahead: int = eqx.field(static=True)

    def known(self, command: AnyRows) -> Float[Array, "inner ..."]:
        """Rows of a command, or of its changes, that the piece sees."""
        return jnp.asarray(command)[self.reach : -self.reach]

    def around(self, motion: Motion) -> Motion:
        """Motion with its first and last rows repeated."""
        ends = self.reach, self.reach + self.ahead
        pad = lambda x: jnp.pad(
            x, (*((0, 0),) * (x.ndim - 2), ends, (0, 0)), mode="edge"
        )
        return Motion(pad(motion.actual), pad(motion.force))


class PaddedPiece(eqx.Module):
    """A piece with still rows before and after it.

    Attributes:
        piece: The piece.
        still: The rows.
    """

    piece: AbstractPiece
    still: StillRows

    def __call__(self, command: Float[Array, "step axis"]) -> Motion:
        """Motion that follows a command, its first and last row repeated."""
        return self.run(command)[0]

    def run(self, command: Float[Array, "step axis"]) -> tuple[Motion, PyTree]:
        """Motion, and the plant's state at the piece's last row."""
        motion, state = self.piece.run(self.still.known(command))
        return self.still.around(motion), state

    def linearised(self, command: FloatRows) -> "PaddedMotion":
        """Linear system around a command."""
        inner = linear_motion(_Rows(self.piece), self.still.known(command))
        return PaddedMotion(self.still.around(inner.motion), inner, self.still)


class PaddedMotion(LinearMotion):
    """The linear system of a piece with still rows before and after it.

    Attributes:
        motion: The motion with these rows.
        inner: The linear system of the piece.
        still: The rows.
    """

    motion: Motion
    inner: LinearMotion
    still: StillRows

    def move(self, changes: Float[Array, "step axis direction"]) -> Motion:
        """Changes of the motion, each direction a row of the first axis."""
        return self.still.around(self.inner.move(self.still.known(changes)))


class _Rows(eqx.Module):
    """A piece as a plant."""

    piece: AbstractPiece

    def __call__(self, command: Float[Array, "step axis"]) -> Motion:
        """Motion that follows a command, shape (step, axis)."""
        return self.piece.run(command)[0]

    def linearised(self, command: FloatRows) -> LinearMotion | None:
        """Linear system around a command, if the piece knows it."""
        return self.piece.linearised(command)


@eqx.filter_jit
def advance(
    part: Problem, command: Float[Array, "step axis"]
) -> tuple[PyTree, Float[Array, ""]]:
    """State at a piece's last row, and its sum of squared errors [m^2].

    The last row belongs to the piece after.
    """
    padded: Any = part.plant
    motion, state = padded.run(command)
    weights = jnp.asarray(part.is_cutting, command.dtype)
    weights = weights.at[-1 - padded.still.ahead - part.window].set(0)
    square = jnp.sum(part.contour(motion) ** 2, axis=1)
    return state, jnp.sum(jnp.where(weights > 0, weights * square, 0))


def part_of(
    problem: Problem, pieces: AbstractPieces, state: PyTree, row: int, count: int
) -> Problem:
    """Problem of some rows, with more around them that do not count."""
    rows, reach, ahead = problem.nominal.shape[0], problem.window, pieces.preview_rows
    inner = np.arange(row, row + count + ahead)
    around = np.clip(np.arange(row - reach, row + count + ahead + reach), 0, rows - 1)
    weights = np.asarray(problem.is_cutting)[np.minimum(inner, rows - 1)]
    counts = (inner < rows) & (inner < row + count)
    weights = np.pad(np.where(counts, weights, 0), reach)
    piece = pieces.piece(state, np.minimum(inner, rows - 1))
    plant = PaddedPiece(piece, StillRows(reach, ahead))
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
    """Command at some rows, and at some more around them."""
    nominal = np.asarray(problem.nominal)
    offsets = spline.offsets(jnp.asarray(coefficients[CLAMPED:-CLAMPED], nominal.dtype))
    command = nominal + np.asarray(offsets)
    at = np.clip(np.arange(row - reach, row + count + reach), 0, len(nominal) - 1)
    return jnp.asarray(command[at])


def rms_so_far(problem: Problem, run: HorizonRun, counted: int) -> float:
    """Root mean square contour error of the rows that count so far [m]."""
    weight = float(np.sum(np.asarray(problem.is_cutting)[:counted]))
    return float(np.sqrt(run.square / weight)) if weight > 0 else 0.0
