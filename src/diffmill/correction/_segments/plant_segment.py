"""The interface of a plant that can be run piece by piece."""

import abc

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from ..._types import FloatRows
from .._core.linear_motion import LinearMotion
from .._core.problem import Motion


class AbstractPiece(eqx.Module):
    """Some rows of a plant, from a known state at the first of them."""

    @abc.abstractmethod
    def run(self, command: Float[Array, "row axis"]) -> tuple[Motion, PyTree]:
        """Run the rows.

        Args:
            command: The command at the rows and at those ahead of them, see
                `AbstractPieces.preview_rows`, shape (row, axis).

        Returns:
            The motion, without rows ahead, whose row 0 is the state at the start, and
            the state at the last row; traceable.
        """

    def linearised(self, command: FloatRows) -> LinearMotion | None:
        """Linear system around a command; None where it is not known."""
        return None


class AbstractPieces(eqx.Module):
    """A plant whose state can be kept between two rows.

    The pieces run one after the other do what the whole plant does.
    """

    @property
    def preview_rows(self) -> int:
        """Rows behind a row whose command the plant knows, and follows, already."""
        return 0

    @abc.abstractmethod
    def begin(self, command: Float[Array, "row axis"]) -> PyTree:
        """State at row 0.

        Args:
            command: The command at the first three rows and at those ahead of them,
                shape (row, axis).
        """

    @abc.abstractmethod
    def piece(self, state: PyTree, rows: Int[np.ndarray, " row"]) -> AbstractPiece:
        """Piece that starts from a state.

        Args:
            state: State at the first of the rows.
            rows: Rows of the path, and those ahead of the last, shape (row,); the last
                may be repeated, for a tool that rests at the end. All pieces of as
                many rows have the same structure and shapes.
        """
