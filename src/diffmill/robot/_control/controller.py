"""The controller: what a drive's motor does of what the program commands.

A chain of linear operators, the same for a short and a long path, in the order of the
signal:

    moving average    (1 / T_f) int_{t - T_f}^t u        a limit of the jerk
    input shaper      A_1 u(t) + A_2 u(t - T_d / 2)      leaves a mode at rest
    interpolation     u at the instants n T_c, and what the drive makes of them
    dead time         u(t - t_0)
    low-pass          y' = w_f (u - y)
    servo             y' = w (u - y)   or   y'' + 2 zeta w y' + w^2 y = w^2 u

A command moves linearly between the tooth instants, as the simulation takes it, and
stands still before the first and after the last. The averages of such a command are
exact, and so are the servos for an input that is linear between the instants at which
they are evaluated, and for a staircase that jumps once between them.

A path is known beforehand, so that a delay alone leaves no error on the part: it only
makes the program late. `motors` therefore tells the motors on a clock that is late by
the chain's mean delay: what remains is what it does to the shape of the path, and where
the joints differ.

On that clock an instant needs the command before and behind it. Filters need a few rows
of either, and servos what they do at the instant before; cycles count from the start of
the path. So a path can be gone through piece by piece, by `begin` and `follow`.
"""

import math
from collections.abc import Callable
from typing import Literal, NamedTuple, TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._arrays import is_traced
from ..._types import RealScalarLike

# A number for all joints, or one for each.
EachJoint: TypeAlias = (
    Float[Array, " joint"] | Float[np.ndarray, " joint"] | RealScalarLike
)
Interpolation: TypeAlias = Literal["hold", "linear", "spline"]
_Tree = TypeVar("_Tree")
# Cycles by which the kinds of interpolation come late: a drive that goes from one point
# to the next has to know the next, and a spline one more.
_LATE_CYCLES = {"hold": 0.5, "linear": 1.0, "spline": 2.0}
# Cycles back to the first set point that an instant may need.
_USED_CYCLES = {"hold": 1.0, "linear": 2.0, "spline": 4.0}
# What a chain divides by.
_POSITIVE = (
    *("moving_average", "shaper_frequency", "interpolation_cycle"),
    *("low_pass", "bandwidth"),
)
# Parts of a tooth period in which low-pass and servos see a staircase.
_STAIRCASE_PARTS = 4
# Roundings by which turns may miss the whole number that they are.
_ROUNDINGS = 128
# Those of a ratio of two times.
_RATIO_ROUNDINGS = 2
# Digits in which rows are counted in cycles, so that each takes few roundings.
_DIGIT = 64
# Rows further than these are beyond any path.
_FAR_ROWS = 2**30


class RowSpan(NamedTuple):
    """Rows of the command of which the motors at one row follow, servos apart.

    Attributes:
        before: Rows before it, at least 1.
        ahead: Rows behind it.
    """

    before: int
    ahead: int


class _Lags(eqx.Module):
    """State of low-pass and servos; what is absent is None.

    Attributes:
        filtered: What the low-pass gives [rad or m], shape (joint,).
        position: What the servos do [rad or m], shape (joint,).
        speed: Its rate of change over w, of servos of second order, shape (joint,).
    """

    filtered: Float[Array, "joint ..."] | None = None
    position: Float[Array, "joint ..."] | None = None
    speed: Float[Array, "joint ..."] | None = None

    def plus(self, rows: Float[Array, "joint ..."]) -> "_Lags":
        """Return the state where all positions are higher by some."""
        add = lambda x: None if x is None else x + rows
        return _Lags(add(self.filtered), add(self.position), self.speed)


class ControllerState(eqx.Module):
    """What a controller remembers at a row of a path, on the clock of `motors`.

    Attributes:
        before: Commanded motors at the rows before, shape (row, joint).
        lags: State of low-pass and servos at the row.
        row: The row, from 0, since the cycles count from the start of the path.
        ahead: Rows of the command behind a row that `follow` needs.
    """

    before: Float[Array, "row joint ..."]
    lags: _Lags
    row: Int[Array, ""]
    ahead: int = eqx.field(static=True)

    def of_changes(self, directions: int) -> "ControllerState":
        """Return the state of changes in some directions that begin at the row."""
        still = lambda x: jnp.zeros((*x.shape, directions), x.dtype)
        before, lags = jax.tree.map(still, (self.before, self.lags))
        return ControllerState(before, lags, self.row, self.ahead)


class ControlledPiece(NamedTuple):
    """What the motors do in some rows of a path.

    Attributes:
        motors: Motor positions [rad or m], shape (step, joint).
        state: The controller's at the last of these rows.
    """

    motors: Float[Array, "step joint ..."]
    state: ControllerState


class Controller(eqx.Module):
    """A linear controller between commanded and actual motor positions.

    Each part is left out where it is None; one without any part is ideal.

    Attributes:
        moving_average: Time T_f over which the command is averaged [s].
        shaper_frequency: Frequency of the damped mode that the input shaper leaves at
            rest [Hz].
        shaper_damping_ratio: Damping ratio of that mode, below 1 [-].
        interpolation_cycle: Cycle T_c of the set points [s].
        interpolation: What the drive makes of them: "hold", a staircase; "linear", a
            polygon; "spline", cubic pieces with continuous speed.
        dead_time: Time t_0 until a command acts at all [s].
        low_pass: Cut-off frequency w_f / (2 pi) of a low-pass of first order [Hz].
        bandwidth: w / (2 pi) of the servos, one for all joints or one for each [Hz],
            shape () or (joint,).
        damping_ratio: zeta of servos of second order [-], same shapes; None for those
            of first order.
    """

    moving_average: RealScalarLike | None = None
    shaper_frequency: RealScalarLike | None = None
    shaper_damping_ratio: RealScalarLike = 0.0
    interpolation_cycle: RealScalarLike | None = None
    interpolation: Interpolation = eqx.field(static=True, default="spline")
    dead_time: RealScalarLike | None = None
    low_pass: RealScalarLike | None = None
    bandwidth: EachJoint | None = None
    damping_ratio: EachJoint | None = None

    def __check_init__(self):
        if self.interpolation not in _LATE_CYCLES:
            raise ValueError(
                "Argument `interpolation` must be one of "
                f"{', '.join(_LATE_CYCLES)}, but is {self.interpolation!r}."
            )
        if self.damping_ratio is not None and self.bandwidth is None:
            raise ValueError(
                "Argument `damping_ratio` must come with a `bandwidth`, but has none."
            )
        for name in _POSITIVE:
            value = getattr(self, name)
            if value is None or is_traced(value):
                continue
            if not np.all(np.asarray(value) > 0):
                raise ValueError(
                    f"Argument `{name}` must be positive, or None for none, but is "
                    f"{value}."
                )

    @property
    def delay(self) -> Float[Array, ""]:
        """Mean delay of a slow motion, that of the servos averaged over them [s]."""
        number = lambda x: jnp.asarray(x, float)
        late = jnp.zeros((), float)
        if self.moving_average is not None:
            late = late + number(self.moving_average) / 2
        if self.shaper_frequency is not None:
            late = late + self._shaper()[1] / (2 * number(self.shaper_frequency))
        if self.interpolation_cycle is not None:
            cycles = _LATE_CYCLES[self.interpolation]
            late = late + cycles * number(self.interpolation_cycle)
        if self.dead_time is not None:
            late = late + number(self.dead_time)
        if self.low_pass is not None:
            late = late + 1 / (2 * math.pi * number(self.low_pass))
        if self.bandwidth is not None:
            late = late + jnp.mean(self._servo_lag())
        return late

    def motors(
        self, commands: Float[Array, "step joint ..."], time_step: RealScalarLike
    ) -> Float[Array, "step joint ..."]:
        """Return what the motors do, on a clock that is late by `delay`.

        Args:
            commands: Commanded motor positions [rad or m], shape (step, joint), or
                changes of them in some directions, shape (step, joint, direction).
            time_step: Time between two rows [s].

        **Differentiability**: linear in the commands; smooth in bandwidth and damping,
        with kinks in the other numbers.
        """
        return self._respond(commands, time_step, self.delay)

    def span(self, time_step: RealScalarLike) -> RowSpan:
        """Return of which rows of the command the motors at a row follow.

        Args:
            time_step: Time between two rows [s].

        **Differentiability**: runs on the host, not traceable.
        """
        T, latest = float(time_step), float(self.delay)
        if self.dead_time is not None:
            latest -= float(self.dead_time)
        earliest = latest
        if self.interpolation_cycle is not None:
            used = _USED_CYCLES[self.interpolation]
            earliest -= used * float(self.interpolation_cycle)
        if self.moving_average is not None:
            earliest -= float(self.moving_average)
        if self.shaper_frequency is not None:
            earliest -= 1 / (2 * float(self.shaper_frequency))
        margin = 1e-9
        ahead = max(0, math.ceil(latest / T - margin))
        return RowSpan(max(1, math.ceil(margin - earliest / T)), ahead)

    def begin(
        self,
        commands: Float[Array, "step joint"],
        time_step: RealScalarLike,
        before: int,
        ahead: int,
    ) -> ControllerState:
        """Return the state at row 0 of a path, before which the command stands still.

        Args:
            commands: Commanded motor positions at the first rows, more than `ahead`
                [rad or m], shape (step, joint).
            time_step: Time between two rows [s].
            before: As of `span`.
            ahead: As of `span`.

        **Differentiability**: that of `motors`.
        """
        start, T = commands[:1], jnp.asarray(time_step, commands.dtype)
        signal = _Signal(commands - start, T)
        lags = self._begun(signal, self.delay.astype(commands.dtype) / T)
        still = jnp.broadcast_to(start, (before, *start.shape[1:]))
        row = jnp.zeros((), jnp.int32)
        return ControllerState(still, lags.plus(start[0]), row, ahead)

    def follow(
        self,
        commands: Float[Array, "row joint ..."],
        time_step: RealScalarLike,
        state: ControllerState,
    ) -> ControlledPiece:
        """Return what the motors do in some rows of a path, and the state after them.

        The pieces one after the other are what `motors` returns of the path.

        Args:
            commands: Commanded motor positions at these rows and `state.ahead` more
                [rad or m], shape (row, joint), or changes as of `motors`.
            time_step: Time between two rows [s].
            state: State at the first of the rows, the last of the piece before.

        **Differentiability**: as `motors`.
        """
        dtype = commands.dtype
        T = jnp.asarray(time_step, dtype)
        first = self.delay.astype(dtype) / T
        count, back = commands.shape[0] - state.ahead, state.before.shape[0]
        known = jnp.concatenate([state.before, commands])
        start = known[:1]
        signal = _Signal(known - start, T, state.row - back)
        lags = state.lags.plus(-start[0])
        rows, lags = self._rows(signal, first, lags, row=state.row, count=count)
        last = count - 1
        ended = ControllerState(
            known[last : last + back],
            lags.plus(start[0]),
            state.row + last,
            state.ahead,
        )
        return ControlledPiece(start + rows, ended)

    def respond(
        self, commands: Float[Array, "step joint ..."], time_step: RealScalarLike
    ) -> Float[Array, "step joint ..."]:
        """Return what the motors do at the instants of the commands, delay and all.

        Arguments, result and **Differentiability** are those of `motors`.
        """
        return self._respond(commands, time_step, jnp.zeros(()))

    def _respond(
        self,
        commands: Float[Array, "step joint ..."],
        time_step: RealScalarLike,
        first: Float[Array, ""],
    ) -> Float[Array, "step joint ..."]:
        """Return what the motors do at instants of which the first is not 0 [s]."""
        dtype = commands.dtype
        T = jnp.asarray(time_step, dtype)
        first = first.astype(dtype) / T
        # From where it starts, so that no digits are lost in integrals over the time.
        start = commands[:1]
        signal = _Signal(commands - start, T)
        lags, row = self._begun(signal, first), jnp.zeros((), jnp.int32)
        count = commands.shape[0]
        rows, _ = self._rows(signal, first, lags, row=row, count=count)
        return start + rows

    @property
    def _has_lags(self) -> bool:
        return self.low_pass is not None or self.bandwidth is not None

    def _rows(
        self,
        signal: "_Signal",
        first: Float[Array, ""],
        lags: _Lags,
        *,
        row: Int[Array, ""],
        count: int,
    ) -> tuple[Float[Array, "step joint ..."], _Lags]:
        """Return what the motors do in some rows, and the state at the last of them.

        Args:
            signal: The command.
            first: Instant of row 0 of the path [rows].
            lags: State at the first of the rows.
            row: Index of the first.
            count: How many rows.
        """
        is_staircase = self.interpolation == "hold" and (
            self.interpolation_cycle is not None
        )
        parts = _STAIRCASE_PARTS if self._has_lags and is_staircase else 1
        index = jnp.arange((count - 1) * parts + 1, dtype=jnp.int32)
        part = (index % parts).astype(first.dtype) / parts
        at = _Instants(row + index // parts, part + first)
        rows, share = self._set_points(signal, at)
        if not self._has_lags:
            return rows, lags
        step, since = signal.time_step / parts, None
        if is_staircase:
            assert share is not None
            cycle = jnp.asarray(self.interpolation_cycle, share.dtype)
            # Several jumps in a step are taken as one, at their mean time.
            jumps = jnp.round(step / cycle + share[:-1] - share[1:])
            since = jnp.maximum(share[1:] + (jumps - 1) / 2, 0) * cycle
        rows, lags = self._lagged(rows, step, lags, since)
        return rows[::parts], lags

    def _begun(self, signal: "_Signal", first: Float[Array, ""]) -> _Lags:
        """Return the state of low-pass and servos at row 0, at some instant [rows].

        A motion that has begun before is followed with the lag of its speed.
        """
        if not self._has_lags:
            return _Lags()
        dtype, joints = first.dtype, signal.rows.shape[1]
        each = lambda x: jnp.broadcast_to(jnp.asarray(x, dtype), (joints,))
        column = lambda x: x.reshape(joints, *(1,) * (signal.rows.ndim - 2))
        span = signal.time_step
        if self.interpolation_cycle is not None:
            span = jnp.maximum(span, jnp.asarray(self.interpolation_cycle, dtype))
        rest = jnp.stack([first - span / signal.time_step, first])
        at = _Instants(jnp.zeros(2, jnp.int32), rest)
        ends = self._set_points(signal, at).rows
        rate, now = (ends[1] - ends[0]) / span, ends[1]
        filtered = position = speed = None
        if self.low_pass is not None:
            w = 2 * math.pi * jnp.asarray(self.low_pass, dtype)
            filtered = now = now - rate / w
        if self.bandwidth is not None:
            position = now - rate * column(each(self._servo_lag()))
            if self.damping_ratio is not None:
                w = 2 * math.pi * each(self.bandwidth)
                speed = rate / column(w)
        return _Lags(filtered, position, speed)

    def _set_points(self, signal: "_Signal", at: "_Instants") -> "_SetPoints":
        """Return what the servos are given at some instants."""
        rows = lambda time: jnp.asarray(time, at.rest.dtype) / signal.time_step
        if self.dead_time is not None:
            at = at.earlier(rows(self.dead_time))
        if self.interpolation_cycle is None:
            return _SetPoints(self._filtered(signal, at), None)
        cycle = rows(self.interpolation_cycle)
        s = at.shares_of_turns(1 / cycle)
        point = lambda back: self._filtered(signal, at.earlier((s + back) * cycle))
        if self.interpolation == "hold":
            return _SetPoints(point(0), s)
        if self.interpolation == "linear":
            return _SetPoints(_shared(1 - s, point(1)) + _shared(s, point(0)), s)
        # Catmull and Rom's cubic between the second and third of four points.
        weights = (
            -0.5 * s + s**2 - 0.5 * s**3,
            1 - 2.5 * s**2 + 1.5 * s**3,
            0.5 * s + 2 * s**2 - 1.5 * s**3,
            -0.5 * s**2 + 0.5 * s**3,
        )
        points = [_shared(w, point(3 - i)) for i, w in enumerate(weights)]
        return _SetPoints(points[0] + points[1] + points[2] + points[3], s)

    def _filtered(
        self, signal: "_Signal", at: "_Instants"
    ) -> Float[Array, "instant joint ..."]:
        """Return the averaged and shaped command at some instants."""
        dtype = at.rest.dtype
        rows = lambda time: jnp.asarray(time, dtype) / signal.time_step
        if self.moving_average is None:
            mean = signal.at
        else:
            span = rows(self.moving_average)
            mean = lambda at: signal.mean(at, span)
        if self.shaper_frequency is None:
            return mean(at)
        first, second = (x.astype(dtype) for x in self._shaper())
        half = 1 / (2 * jnp.asarray(self.shaper_frequency, dtype) * signal.time_step)
        return first * mean(at) + second * mean(at.earlier(half))

    def _shaper(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Return the shares of the two parts of the input shaper."""
        zeta = jnp.asarray(self.shaper_damping_ratio, float)
        K = jnp.exp(-zeta * math.pi / jnp.sqrt(1 - zeta**2))
        return 1 / (1 + K), K / (1 + K)

    def _servo_lag(self) -> Float[Array, "*joint"]:
        """Return by how much the servos come late to a slow motion [s]."""
        assert self.bandwidth is not None
        lag = 1 / (2 * math.pi * jnp.asarray(self.bandwidth, float))
        if self.damping_ratio is None:
            return lag
        return 2 * jnp.asarray(self.damping_ratio, float) * lag

    def _lagged(
        self,
        rows: Float[Array, "instant joint ..."],
        step: Float[Array, ""],
        lags: _Lags,
        since: Float[Array, " step"] | None,
    ) -> tuple[Float[Array, "instant joint ..."], _Lags]:
        """Return what low-pass and servos make of set points, and their last state.

        Args:
            rows: The set points.
            step: Time between them [s].
            lags: State at the first.
            since: How long before each of the others they jumped to it [s]; None for
                linear ones.
        """
        dtype, joints = rows.dtype, rows.shape[1]
        each = lambda x: jnp.broadcast_to(jnp.asarray(x, dtype), (joints,))
        column = lambda x: x.reshape(joints, *(1,) * (rows.ndim - 2))
        filtered = None
        if self.low_pass is not None:
            assert lags.filtered is not None
            w = column(2 * math.pi * each(self.low_pass))
            rows = _first_order(rows, w, step, lags.filtered, since)
            # What comes out has no jumps.
            filtered, since = rows[-1], None
        if self.bandwidth is None:
            return rows, _Lags(filtered)
        assert lags.position is not None
        w = 2 * math.pi * each(self.bandwidth)
        if self.damping_ratio is None:
            rows = _first_order(rows, column(w), step, lags.position, since)
            return rows, _Lags(filtered, rows[-1])
        assert lags.speed is not None
        servo = _SecondOrder(column(w), column(each(self.damping_ratio)))
        rows, speed = servo.follow(rows, step, lags.position, lags.speed, since)
        return rows, _Lags(filtered, rows[-1], speed)


class _Instants(NamedTuple):
    """Instants as whole rows of a path and a rest, so that single precision holds them.

    Attributes:
        row: Rows from the start of the path, shape (instant,).
        rest: What is added to them [rows], as much as a delay, shape (instant,).
    """

    row: Int[Array, " instant"]
    rest: Float[Array, " instant"]

    def earlier(self, rows: Array) -> "_Instants":
        """Return instants that are earlier by some rows."""
        return _Instants(self.row, self.rest - rows)

    def shares_of_turns(self, turns: Float[Array, ""]) -> Float[Array, " instant"]:
        """Return by how much of a turn they are behind the last whole one.

        It is as much below zero as the rounding of the ratio may make of a whole turn.

        Args:
            turns: Turns in a row.
        """
        return _held(lambda at: at._shares(turns), self)

    def _shares(self, turns: Float[Array, ""]) -> Float[Array, " instant"]:
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


class _SetPoints(NamedTuple):
    """What servos are given at some instants.

    Attributes:
        rows: Positions [rad or m], shape (instant, joint).
        share: How much of an interpolation cycle has passed since the last set point,
            shape (instant,); None without cycles.
    """

    rows: Float[Array, "instant joint ..."]
    share: Float[Array, " instant"] | None


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
    """A sum and the rest that its rounding leaves, as `_with_rest` adds them."""

    value: Float[Array, "..."]
    rest: Float[Array, "..."]


class _Signal(eqx.Module):
    """A command that is linear between its rows, and constant before and after.

    Attributes:
        rows: The rows; the first is zero, shape (step, joint) or more.
        time_step: Time between them T [s].
        first: Row of the path that is the first of them, shape ().
        sums: Integral up to each row over T, same shape as the rows each.
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

    def at(self, at: _Instants) -> Float[Array, "instant joint ..."]:
        """Return the command at some instants."""
        place = self._place(at)
        start = self.rows[place.row]
        return start + _shared(place.share, self.rows[place.row + 1] - start)

    def mean(
        self, at: _Instants, span: Float[Array, ""]
    ) -> Float[Array, "instant joint ..."]:
        """Return the mean of the command over some rows before some instants."""
        start, end = self._place(at.earlier(span)), self._place(at)
        between = jax.tree.map(lambda x: x[end.row] - x[start.row], self.sums)
        inside = self._inside(end) - self._inside(start)
        return (between.value + (between.rest + inside)) / span

    def _inside(self, place: _Place) -> Float[Array, "instant joint ..."]:
        """Return the integral over T behind the row before an instant."""
        start = self.rows[place.row]
        inside = _shared(place.share, start) + _shared(
            place.share**2 / 2, self.rows[place.row + 1] - start
        )
        return inside + _shared(place.after, self.rows[-1:])

    def _place(self, at: _Instants) -> _Place:
        """Return the places of some instants."""
        return _held(self._place_anew, at)

    def _place_anew(self, at: _Instants) -> _Place:
        last = self.rows.shape[0] - 1
        rest = jnp.clip(at.rest, -_FAR_ROWS, _FAR_ROWS)
        whole = jnp.floor(rest)
        row, share = at.row - self.first + whole.astype(jnp.int32), rest - whole
        after = jnp.maximum((row - last).astype(rest.dtype) + share, 0)
        share = jnp.where(row < 0, 0, jnp.where(row < last, share, 1))
        return _Place(jnp.clip(row, 0, last - 1), share, after)


def _held(find: Callable[[_Instants], _Tree], at: _Instants) -> _Tree:
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
        value, lost = _with_rest(sums.value, step)
        sums = _with_rest(value, sums.rest + lost)
        return sums, sums

    begun = _Sum(jnp.zeros_like(still), jnp.zeros_like(still))
    _, sums = jax.lax.scan(add, begun, steps)
    return jax.tree.map(lambda x, y: jnp.concatenate([x[None], y]), begun, sums)


def _with_rest(a: Array, b: Array) -> _Sum:
    """Return a sum and what its rounding leaves, after Knuth."""
    total = a + b
    b_held = total - a
    return _Sum(total, (a - (total - b_held)) + (b - b_held))


def _shared(
    weights: Float[Array, " instant"], rows: Float[Array, "row joint ..."]
) -> Float[Array, "instant joint ..."]:
    """Return rows, each times its weight."""
    return weights.reshape(-1, *(1,) * (rows.ndim - 1)) * rows


def _first_order(
    rows: Float[Array, "instant joint ..."],
    w: Float[Array, "joint ..."],
    step: Float[Array, ""],
    begun: Float[Array, "joint ..."],
    since: Float[Array, " step"] | None,
) -> Float[Array, "instant joint ..."]:
    """Return what y' = w (u - y) makes of rows, as of `Controller._lagged`.

    The lag u - y stays right in single precision, where y does not: a step that is
    short beside 1 / w would round away what it changes.
    """
    rises = jnp.diff(rows, axis=0)
    if since is None:
        late = (-jnp.expm1(-w * step) / (w * step))[None]
    else:
        late = jnp.exp(-_times(since, w))
    E = jnp.exp(-w * step)

    def advance(lag: Array, behind: Array) -> tuple[Array, Array]:
        lag = E * lag + behind
        return lag, lag

    begun = rows[0] - begun
    _, found = jax.lax.scan(advance, begun, late * rises)
    return rows - jnp.concatenate([begun[None], found])


def _times(
    since: Float[Array, " step"], w: Float[Array, "joint ..."]
) -> Float[Array, "step joint ..."]:
    """Return times in those of the joints, 1 / w."""
    return since.reshape(-1, *(1,) * w.ndim) * w[None]


class _Servo(NamedTuple):
    """State of a system of second order: the lag u - y, and v = y' / w."""

    lag: Array
    v: Array


class _Transition(NamedTuple):
    """What is left of the state of a servo; the lag that v leaves is -v_of_lag."""

    lag_of_lag: Array
    v_of_lag: Array
    v_of_v: Array


class _SecondOrder(NamedTuple):
    """Servos y'' + 2 zeta w y' + w^2 y = w^2 u, one for each joint.

    Attributes:
        w: Their frequencies [rad/s], shape (joint,) or more.
        zeta: Their damping ratios [-], same shape.
    """

    w: Float[Array, "joint ..."]
    zeta: Float[Array, "joint ..."]

    def follow(
        self,
        rows: Float[Array, "instant joint ..."],
        step: Float[Array, ""],
        begun: Float[Array, "joint ..."],
        speed: Float[Array, "joint ..."],
        since: Float[Array, " step"] | None,
    ) -> tuple[Float[Array, "instant joint ..."], Float[Array, "joint ..."]]:
        """Return what they make of rows, as of `Controller._lagged`, and the last v.

        Args:
            rows: The set points.
            step: Time between them [s].
            begun: y at the first.
            speed: v there.
            since: As of `Controller._lagged`.
        """
        rises, free = jnp.diff(rows, axis=0), self._after(self.w * step)
        if since is None:
            # Of a ramp: the integral of what a jump leaves, over the step.
            x, fallen = self.w * step, 1 - free.lag_of_lag
            lag = (2 * self.zeta * fallen + free.v_of_lag) / x
            behind = _Servo(lag[None] * rises, (fallen / x)[None] * rises)
        else:
            at = self._after(_times(since, self.w))
            behind = _Servo(at.lag_of_lag * rises, at.v_of_lag * rises)

        def advance(state: _Servo, behind: _Servo) -> tuple[_Servo, Array]:
            lag = free.lag_of_lag * state.lag - free.v_of_lag * state.v
            v = free.v_of_lag * state.lag + free.v_of_v * state.v
            state = _Servo(lag + behind.lag, v + behind.v)
            return state, state.lag

        begun = rows[0] - begun
        (_, ended), found = jax.lax.scan(advance, _Servo(begun, speed), behind)
        return rows - jnp.concatenate([begun[None], found]), ended

    def _after(self, x: Float[Array, "..."]) -> "_Transition":
        """Return what is left of a state after x = w t in which u stands still.

        The exponential of [[0, -1], [1, -2 zeta]] x, in closed form.
        """
        zeta = self.zeta.reshape(*(1,) * (x.ndim - self.zeta.ndim), *self.zeta.shape)
        root = (zeta**2 - 1) * x**2
        is_near = jnp.abs(root) < 1e-2
        # Away from the critical damping, where roots have no derivative.
        away = jnp.where(is_near, 1.0, root)
        r = jnp.sqrt(jnp.abs(away))
        is_over = away > 0
        grown = jnp.where(is_over, r, 0.0)
        slow, fast = jnp.exp(grown - zeta * x), jnp.exp(-grown - zeta * x)
        decay = jnp.exp(-zeta * x)
        even = jnp.where(is_over, (slow + fast) / 2, decay * jnp.cos(r))
        odd = jnp.where(is_over, (slow - fast) / 2, decay * jnp.sin(r)) / r
        k = jnp.where(is_near, root, 0.0)
        even = jnp.where(is_near, decay * _series(k, 0), even)
        odd = x * jnp.where(is_near, decay * _series(k, 1), odd)
        return _Transition(even + zeta * odd, odd, even - zeta * odd)


def _series(k: Array, first: int) -> Array:
    """Return the sum of k^n / (2 n + first)! for a small k, cosh or sinh of its root.

    What six terms leave of k = 0.01 is less than rounding.
    """
    total = jnp.zeros_like(k)
    for n in reversed(range(6)):
        total = total * k + 1 / math.factorial(2 * n + first)
    return total
