"""A command known at the rows of a path, at instants between them, and its means."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

_Tree = TypeVar("_Tree")
# Roundings by which a whole number of turns may be missed.
_TURN_ROUNDINGS = 128
# Roundings of a ratio of two times.
_RATIO_ROUNDINGS = 2
# Base of the digits in which rows are counted in cycles, so that each digit takes few
# roundings.
_DIGIT_BASE = 64
# Number of rows beyond any path.
_FAR_ROWS = 2**30


class Instants(NamedTuple):
    """Instants as whole rows of a path and a rest, so that single precision holds them.

    Attributes:
        row: Rows from the start of the path, shape (instant,).
        rest: Fraction to add to them [rows], which may be as long as a delay, shape
            (instant,).
    """

    row: Int[Array, " instant"]
    rest: Float[Array, " instant"]

    def earlier(self, rows: Array) -> "Instants":
        """Instants that are earlier by some rows."""
        return Instants(self.row, self.rest - rows)

    def shares_of_turns(self, turns: Float[Array, ""]) -> Float[Array, " instant"]:
        """Shares of a turn since the last whole one, shape (instant,).

        A share is as far below zero as the rounding of a whole turn may make it.

        Args:
            turns: Turns in a row.
        """

        def shares(at: Instants) -> Float[Array, " instant"]:
            share = at.rest * turns
            for unit in (1, _DIGIT_BASE, _DIGIT_BASE**2):
                digit = at.row // unit
                # The highest digit has no bound.
                digit = digit % _DIGIT_BASE if unit < _DIGIT_BASE**2 else digit
                whole = unit * turns
                share = share + digit.astype(turns.dtype) * (whole - jnp.floor(whole))
                share = share - jnp.floor(share)
            rows = at.row.astype(turns.dtype)
            roundings = _TURN_ROUNDINGS + _RATIO_ROUNDINGS * rows * turns
            margin = jnp.finfo(turns.dtype).eps * jax.lax.stop_gradient(roundings)
            return share - jnp.floor(share + margin)

        return _computed_once(shares, self)


class _Place(NamedTuple):
    """Places of instants in a signal, shape (instant,) each.

    Attributes:
        row: Row before it.
        share: Share of the step behind that row.
        after: Steps since the last row.
    """

    row: Int[Array, " instant"]
    share: Float[Array, " instant"]
    after: Float[Array, " instant"]


class _Sum(NamedTuple):
    """A sum and its rounding error, as `_two_sum` adds them."""

    value: Float[Array, "..."]
    rest: Float[Array, "..."]


class Signal(eqx.Module):
    """A command that is linear between its rows, and constant before and after.

    Attributes:
        rows: The rows; the first is zero, shape (step, joint) or more.
        time_step: Time between them T [s].
        first: Row of the path that is the first of them, shape ().
        sums: Integral up to each row, divided by T; two arrays of the rows' shape.
    """

    rows: Float[Array, "step joint ..."]
    time_step: Float[Array, ""]
    first: Int[Array, ""]
    sums: _Sum

    def __init__(
        self,
        rows: Float[Array, "step joint ..."],
        time_step: Array,
        first: Array | None = None,
    ):
        self.rows, self.time_step = rows, time_step
        self.first = jnp.zeros((), jnp.int32) if first is None else first
        self.sums = _running_sums((rows[:-1] + rows[1:]) / 2, rows[0])

    def at(self, at: Instants) -> Float[Array, "instant joint ..."]:
        """Command at some instants [rad or m]."""
        place = self._place(at)
        start = self.rows[place.row]
        return start + shared(place.share, self.rows[place.row + 1] - start)

    def mean(
        self, at: Instants, span: Float[Array, ""]
    ) -> Float[Array, "instant joint ..."]:
        """Mean of the command over a span of rows before some instants [rad or m]."""
        start, end = self._place(at.earlier(span)), self._place(at)
        between = jax.tree.map(lambda x: x[end.row] - x[start.row], self.sums)
        inside = self._inside(end) - self._inside(start)
        return (between.value + (between.rest + inside)) / span

    def _inside(self, place: _Place) -> Float[Array, "instant joint ..."]:
        """Integral from the row before an instant up to it, divided by T."""
        start = self.rows[place.row]
        inside = shared(place.share, start) + shared(
            place.share**2 / 2, self.rows[place.row + 1] - start
        )
        return inside + shared(place.after, self.rows[-1:])

    def _place(self, at: Instants) -> _Place:
        """Places of some instants in the signal."""
        last = self.rows.shape[0] - 1

        def place(at: Instants) -> _Place:
            rest = jnp.clip(at.rest, -_FAR_ROWS, _FAR_ROWS)
            whole = jnp.floor(rest)
            row, share = at.row - self.first + whole.astype(jnp.int32), rest - whole
            after = jnp.maximum((row - last).astype(rest.dtype) + share, 0)
            share = jnp.where(row < 0, 0, jnp.where(row < last, share, 1))
            return _Place(jnp.clip(row, 0, last - 1), share, after)

        return _computed_once(place, at)


def _computed_once(function: Callable[[Instants], _Tree], at: Instants) -> _Tree:
    """Function of instants, computed once, in a loop whose results XLA stores.

    XLA computes a cheap number anew wherever it is used, and rounds it there in one way
    or the other: a row and the share behind it would belong to different places.
    """
    count = at.row.shape[0]
    halves = jax.tree.map(lambda x: jnp.pad(x, (0, count % 2)).reshape(2, -1), at)
    values = jax.lax.map(function, halves)
    return jax.tree.map(lambda x: x.reshape(-1)[:count], values)


def _running_sums(
    steps: Float[Array, "step joint ..."], still: Float[Array, "joint ..."]
) -> _Sum:
    """Sums up to each row, each with its rounding error.

    A mean over some rows is a difference of two of them, each as large as the path.
    """

    def add(sums: _Sum, step: Array) -> tuple[_Sum, _Sum]:
        value, lost = _two_sum(sums.value, step)
        sums = _two_sum(value, sums.rest + lost)
        return sums, sums

    begun = _Sum(jnp.zeros_like(still), jnp.zeros_like(still))
    _, sums = jax.lax.scan(add, begun, steps)
    return jax.tree.map(lambda x, y: jnp.concatenate([x[None], y]), begun, sums)


def _two_sum(a: Array, b: Array) -> _Sum:
    """Sum and its rounding error, after Knuth."""
    total = a + b
    b_rounded = total - a
    return _Sum(total, (a - (total - b_rounded)) + (b - b_rounded))


def shared(
    weights: Float[Array, " instant"], rows: Float[Array, "row joint ..."]
) -> Float[Array, "instant joint ..."]:
    """Rows, each times its weight."""
    return weights.reshape(-1, *(1,) * (rows.ndim - 1)) * rows
