"""A command known at the rows of a path, at instants between them, and its means."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

_Tree = TypeVar("_Tree")
# Roundings by which turns may miss the whole number that they are.
_ROUNDINGS = 128
# Those of a ratio of two times.
_RATIO_ROUNDINGS = 2
# Digits in which rows are counted in cycles, so that each takes few roundings.
_DIGIT = 64
# Rows further than these are beyond any path.
_FAR_ROWS = 2**30


class Instants(NamedTuple):
    """Instants as whole rows of a path and a rest, so that single precision holds them.

    Attributes:
        row: Rows from the start of the path, shape (instant,).
        rest: What is added to them [rows], as much as a delay, shape (instant,).
    """

    row: Int[Array, " instant"]
    rest: Float[Array, " instant"]

    def earlier(self, rows: Array) -> "Instants":
        """Return instants that are earlier by some rows."""
        return Instants(self.row, self.rest - rows)

    def shares_of_turns(self, turns: Float[Array, ""]) -> Float[Array, " instant"]:
        """Return the shares of a turn by which they are behind the last whole one.

        It is as much below zero as the rounding of the ratio may make of a whole turn.

        Args:
            turns: Turns in a row.
        """
        return _computed_once(lambda at: at._shares(turns), self)

    def _shares(self, turns: Float[Array, ""]) -> Float[Array, " instant"]:
        """Return them, computed anew wherever XLA uses them."""
        share = self.rest * turns
        for unit in (1, _DIGIT, _DIGIT**2):
            digit = self.row // unit
            # The highest takes what is left.
            digit = digit % _DIGIT if unit < _DIGIT**2 else digit
            whole = unit * turns
            share = share + digit.astype(turns.dtype) * (whole - jnp.floor(whole))
            share = share - jnp.floor(share)
        roundings = _ROUNDINGS + _RATIO_ROUNDINGS * self.row.astype(turns.dtype) * turns
        margin = jnp.finfo(turns.dtype).eps * jax.lax.stop_gradient(roundings)
        return share - jnp.floor(share + margin)


class _Place(NamedTuple):
    """Where an instant is in a signal, shape (instant,) each.

    Attributes:
        row: Row before it.
        share: Share of the step behind that row.
        after: Steps since the last row.
    """

    row: Int[Array, " instant"]
    share: Float[Array, " instant"]
    after: Float[Array, " instant"]


class _Sum(NamedTuple):
    """A sum and the rest that its rounding leaves, as `_two_sum` adds them."""

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
        """Return the command at some instants."""
        place = self._place(at)
        start = self.rows[place.row]
        return start + shared(place.share, self.rows[place.row + 1] - start)

    def mean(
        self, at: Instants, span: Float[Array, ""]
    ) -> Float[Array, "instant joint ..."]:
        """Return the mean of the command over some rows before some instants."""
        start, end = self._place(at.earlier(span)), self._place(at)
        between = jax.tree.map(lambda x: x[end.row] - x[start.row], self.sums)
        inside = self._inside(end) - self._inside(start)
        return (between.value + (between.rest + inside)) / span

    def _inside(self, place: _Place) -> Float[Array, "instant joint ..."]:
        """Return the integral from the row before an instant up to it, divided by T."""
        start = self.rows[place.row]
        inside = shared(place.share, start) + shared(
            place.share**2 / 2, self.rows[place.row + 1] - start
        )
        return inside + shared(place.after, self.rows[-1:])

    def _place(self, at: Instants) -> _Place:
        """Return the places of some instants."""
        return _computed_once(self._place_anew, at)

    def _place_anew(self, at: Instants) -> _Place:
        """Return them, computed anew wherever XLA uses them."""
        last = self.rows.shape[0] - 1
        rest = jnp.clip(at.rest, -_FAR_ROWS, _FAR_ROWS)
        whole = jnp.floor(rest)
        row, share = at.row - self.first + whole.astype(jnp.int32), rest - whole
        after = jnp.maximum((row - last).astype(rest.dtype) + share, 0)
        share = jnp.where(row < 0, 0, jnp.where(row < last, share, 1))
        return _Place(jnp.clip(row, 0, last - 1), share, after)


def _computed_once(find: Callable[[Instants], _Tree], at: Instants) -> _Tree:
    """Return what is found of instants, computed once.

    XLA computes a cheap number anew wherever it is used, and rounds it there in one way
    or the other: a row and the share behind it would belong to different places. What
    comes out of a loop is held.
    """
    count = at.row.shape[0]
    halves = jax.tree.map(lambda x: jnp.pad(x, (0, count % 2)).reshape(2, -1), at)
    found = jax.lax.map(find, halves)
    return jax.tree.map(lambda x: x.reshape(-1)[:count], found)


def _running_sums(
    steps: Float[Array, "step joint ..."], still: Float[Array, "joint ..."]
) -> _Sum:
    """Return the sums up to each row, which keep the digits that single ones lose.

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
    """Return a sum and what its rounding leaves, after Knuth."""
    total = a + b
    b_held = total - a
    return _Sum(total, (a - (total - b_held)) + (b - b_held))


def shared(
    weights: Float[Array, " instant"], rows: Float[Array, "row joint ..."]
) -> Float[Array, "instant joint ..."]:
    """Return rows, each times its weight."""
    return weights.reshape(-1, *(1,) * (rows.ndim - 1)) * rows
