"""The controller: what a drive's motor does of what the program commands.

A chain of linear operators, the same for a short and a long path, in the order of the
signal:

    moving average    (1 / T_f) int_{t - T_f}^t u        a limit of the jerk
    input shaper      A_1 u(t) + A_2 u(t - T_d / 2)      leaves a mode at rest
    interpolation     u at the instants n T_c, and the drive's path through them
    dead time         u(t - t_0)
    low-pass          y' = w_f (u - y)
    servo             y' = w (u - y)   or   y'' + 2 zeta w y' + w^2 y = w^2 u

A command moves linearly between the tooth instants, as the simulation takes it, and
rests before the first and after the last. The averages of such a command are
exact, and so are the servos for an input that is linear between the instants at which
they are evaluated, and for a staircase that jumps once between them.

A path is known beforehand, so that a delay alone leaves no error on the part: it only
makes the program late. `motors` therefore gives the motors on a clock that is late by
the chain's mean delay: only changes of the path's shape remain, and differences between
the joints.

On that clock an instant needs the command before and behind it. Filters need a few rows
of either, and servos their own output at the instant before; cycles count from the
start of the path. So a path can be gone through piece by piece, by `begin` and
`follow`.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._arrays import check_known
from ..._types import RealScalarLike
from .servos import Jumps, SecondOrder, first_order
from .signal import Instants, Signal, shared

# A number for all joints, or one for each.
EachJoint: TypeAlias = (
    Float[Array, " joint"] | Float[np.ndarray, " joint"] | RealScalarLike
)
Interpolation: TypeAlias = Literal["hold", "linear", "spline"]


@dataclasses.dataclass(frozen=True)
class _InterpolationRule:
    """Path of a drive between its set points.

    Attributes:
        delay: Mean delay [cycles]: a drive that goes from one point to the next has to
            know the next, and a spline one more.
        point_count: Number of the last set points that an instant needs.
        weights: Weights of these points, the oldest first, by the share s of a cycle
            that has passed since the last one.
    """

    delay: float
    point_count: int
    weights: Callable[[Array], Sequence[Array]]

    @property
    def is_staircase(self) -> bool:
        """True if the path jumps at its set points."""
        return self.point_count == 1


_INTERPOLATIONS = {
    "hold": _InterpolationRule(0.5, 1, lambda s: (jnp.ones_like(s),)),
    "linear": _InterpolationRule(1.0, 2, lambda s: (1 - s, s)),
    # Catmull and Rom's cubic between the second and third of four points.
    "spline": _InterpolationRule(
        2.0,
        4,
        lambda s: (
            -0.5 * s + s**2 - 0.5 * s**3,
            1 - 2.5 * s**2 + 1.5 * s**3,
            0.5 * s + 2 * s**2 - 1.5 * s**3,
            -0.5 * s**2 + 0.5 * s**3,
        ),
    ),
}
# Parameters above zero, as one number or as one for each joint.
_POSITIVE_NUMBERS = (
    *("moving_average", "shaper_frequency", "interpolation_cycle", "low_pass"),
)
_POSITIVE_PER_JOINT = ("bandwidth", "damping_ratio")
# Parts of a tooth period in which low-pass and servos see a staircase.
_STAIRCASE_PARTS = 4


class RowSpan(NamedTuple):
    """Rows of the command on which the motors at one row depend, servos apart.

    Attributes:
        before: Rows before it, at least 1.
        ahead: Rows behind it.
    """

    before: int
    ahead: int


class _Lags(eqx.Module):
    """State of low-pass and servos; None for an absent part.

    Attributes:
        filtered: Output of the low-pass [rad or m], shape (joint,).
        position: Output of the servos [rad or m], shape (joint,).
        speed: Its rate of change over w, of servos of second order, shape (joint,).
    """

    filtered: Float[Array, "joint ..."] | None = None
    position: Float[Array, "joint ..."] | None = None
    speed: Float[Array, "joint ..."] | None = None

    def plus(self, rows: Float[Array, "joint ..."]) -> "_Lags":
        """State with all positions shifted by the same rows."""
        add = lambda x: None if x is None else x + rows
        return _Lags(add(self.filtered), add(self.position), self.speed)


class ControllerState(eqx.Module):
    """State of a controller at a row of a path, on the clock of `motors`.

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
        """State of changes in some directions that begin at the row."""
        zeros = lambda x: jnp.zeros((*x.shape, directions), x.dtype)
        before, lags = jax.tree.map(zeros, (self.before, self.lags))
        return ControllerState(before, lags, self.row, self.ahead)


class ControlledPiece(NamedTuple):
    """Motor positions in some rows of a path, and the controller's state behind them.

    Attributes:
        motors: Motor positions [rad or m], shape (step, joint).
        state: State of the controller at the last of these rows.
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
        interpolation: The drive's path through them: "hold", a staircase; "linear", a
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
        if self.interpolation not in _INTERPOLATIONS:
            raise ValueError(
                "Argument `interpolation` must be one of "
                f"{', '.join(_INTERPOLATIONS)}, but is {self.interpolation!r}."
            )
        if self.damping_ratio is not None and self.bandwidth is None:
            raise ValueError(
                "Argument `damping_ratio` must come with a `bandwidth`, but has none."
            )
        per_joint = ((), (None,))
        for names, shapes in (
            (_POSITIVE_NUMBERS, ((),)),
            (_POSITIVE_PER_JOINT, per_joint),
        ):
            for name in names:
                value = getattr(self, name)
                if value is not None:
                    check_known(name, value, least=0.0, is_open=True, shapes=shapes)
        each = [x for x in (self.bandwidth, self.damping_ratio) if x is not None]
        sizes = {jnp.asarray(x).shape for x in each} - {()}
        if len(sizes) > 1:
            raise ValueError(
                "Arguments `bandwidth` and `damping_ratio` must be of as many joints, "
                f"but have shapes {' and '.join(map(str, sorted(sizes)))}."
            )
        if self.dead_time is not None:
            check_known("dead_time", self.dead_time, least=0.0)
        check_known(
            "shaper_damping_ratio", self.shaper_damping_ratio, least=0.0, below=1.0
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
            cycles = _INTERPOLATIONS[self.interpolation].delay
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
        """Motor positions on a clock that is late by `delay` [rad or m].

        Args:
            commands: Commanded motor positions [rad or m], shape (step, joint), or
                changes of them in some directions, shape (step, joint, direction).
            time_step: Time between two rows [s].

        **Differentiability**: linear in the commands; smooth in bandwidth and damping,
        with kinks in the other numbers.
        """
        return self._respond(commands, time_step, self.delay)

    def span(self, time_step: RealScalarLike) -> RowSpan:
        """Rows of the command on which the motors at one row depend.

        Args:
            time_step: Time between two rows [s].

        **Differentiability**: runs on the host, not traceable.
        """
        T, latest = float(time_step), float(self.delay)
        if self.dead_time is not None:
            latest -= float(self.dead_time)
        earliest = latest
        if self.interpolation_cycle is not None:
            cycles = _INTERPOLATIONS[self.interpolation].point_count
            earliest -= cycles * float(self.interpolation_cycle)
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
        """State at row 0 of a path, before which the command rests.

        Args:
            commands: Commanded motor positions at the first rows, more than `ahead`
                [rad or m], shape (step, joint).
            time_step: Time between two rows [s].
            before: Rows before a row that `follow` needs, as `span` gives.
            ahead: Rows behind it.

        **Differentiability**: that of `motors`.
        """
        start, T = commands[:1], jnp.asarray(time_step, commands.dtype)
        signal = Signal(commands - start, T)
        lags = self._initial_lags(signal, self.delay.astype(commands.dtype) / T)
        standstill = jnp.broadcast_to(start, (before, *start.shape[1:]))
        row = jnp.zeros((), jnp.int32)
        return ControllerState(standstill, lags.plus(start[0]), row, ahead)

    def follow(
        self,
        commands: Float[Array, "row joint ..."],
        time_step: RealScalarLike,
        state: ControllerState,
    ) -> ControlledPiece:
        """Motor positions in some rows of a path, and the state after them.

        The pieces one after the other are the result of `motors` for the whole path.

        Args:
            commands: Commanded motor positions at these rows and `state.ahead` more
                [rad or m], shape (row, joint), or changes of them as for `motors`.
            time_step: Time between two rows [s].
            state: State at the first of the rows, the last of the piece before.

        **Differentiability**: as `motors`.
        """
        T = jnp.asarray(time_step, commands.dtype)
        first = self.delay.astype(T.dtype) / T
        return self._in(T.dtype)._followed(commands, T, first, state)

    @eqx.filter_jit
    def _followed(
        self,
        commands: Float[Array, "row joint ..."],
        T: Float[Array, ""],
        first: Float[Array, ""],
        state: ControllerState,
    ) -> ControlledPiece:
        """Result of `follow`, the time step T in seconds, instant of row 0 in rows."""
        count, back = commands.shape[0] - state.ahead, state.before.shape[0]
        known = jnp.concatenate([state.before, commands])
        start = known[:1]
        signal = Signal(known - start, T, state.row - back)
        lags = state.lags.plus(-start[0])
        rows, lags = self._rows(signal, first, lags, row=state.row, count=count)
        last = count - 1
        state_at_last = ControllerState(
            known[last : last + back],
            lags.plus(start[0]),
            state.row + last,
            state.ahead,
        )
        return ControlledPiece(start + rows, state_at_last)

    def respond(
        self, commands: Float[Array, "step joint ..."], time_step: RealScalarLike
    ) -> Float[Array, "step joint ..."]:
        """Motor positions at the instants of the commands, delay included [rad or m].

        Arguments, result and **Differentiability** are those of `motors`.
        """
        return self._respond(commands, time_step, jnp.zeros(()))

    def _respond(
        self,
        commands: Float[Array, "step joint ..."],
        time_step: RealScalarLike,
        first: Float[Array, ""],
    ) -> Float[Array, "step joint ..."]:
        """Motor positions at instants that begin at some time [s]."""
        T = jnp.asarray(time_step, commands.dtype)
        return self._in(T.dtype)._responded(commands, T, first.astype(T.dtype) / T)

    def _in(self, dtype: jnp.dtype) -> "Controller":
        """Controller whose numbers are arrays, so that others compile nothing new."""
        return jax.tree.map(lambda x: jnp.asarray(x, dtype), self)

    @eqx.filter_jit
    def _responded(
        self,
        commands: Float[Array, "step joint ..."],
        T: Float[Array, ""],
        first: Float[Array, ""],
    ) -> Float[Array, "step joint ..."]:
        """Result of `_respond`, the time step T in seconds, first instant in rows."""
        # Relative to the start, so that no digits are lost in integrals over the time.
        start = commands[:1]
        signal = Signal(commands - start, T)
        lags, row = self._initial_lags(signal, first), jnp.zeros((), jnp.int32)
        count = commands.shape[0]
        rows, _ = self._rows(signal, first, lags, row=row, count=count)
        return start + rows

    @property
    def _has_lags(self) -> bool:
        return self.low_pass is not None or self.bandwidth is not None

    def _rows(
        self,
        signal: Signal,
        first: Float[Array, ""],
        lags: _Lags,
        *,
        row: Int[Array, ""],
        count: int,
    ) -> tuple[Float[Array, "step joint ..."], _Lags]:
        """Motor positions in some rows, and the state at the last of them.

        Args:
            signal: The command.
            first: Instant of row 0 of the path [rows].
            lags: State at the first of the rows.
            row: Index of the first.
            count: Number of rows.
        """
        is_staircase = self.interpolation_cycle is not None and (
            _INTERPOLATIONS[self.interpolation].is_staircase
        )
        parts = _STAIRCASE_PARTS if self._has_lags and is_staircase else 1
        index = jnp.arange((count - 1) * parts + 1, dtype=jnp.int32)
        part = (index % parts).astype(first.dtype) / parts
        at = Instants(row + index // parts, part + first)
        rows, share = self._set_points(signal, at)
        if not self._has_lags:
            return rows, lags
        step, since = signal.time_step / parts, None
        if is_staircase:
            assert share is not None
            cycle = jnp.asarray(self.interpolation_cycle, share.dtype)
            jumps = jnp.round(step / cycle + share[:-1] - share[1:])
            since = Jumps.of_cycles(jumps, share[1:], cycle)
        rows, lags = self._lagged(rows, step, lags, since)
        return rows[::parts], lags

    def _initial_lags(self, signal: Signal, first: Float[Array, ""]) -> _Lags:
        """State of low-pass and servos at row 0, at some instant [rows].

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
        instants = jnp.stack([first - span / signal.time_step, first])
        at = Instants(jnp.zeros(2, jnp.int32), instants)
        ends, _ = self._set_points(signal, at)
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

    def _set_points(
        self, signal: Signal, at: Instants
    ) -> tuple[Float[Array, "instant joint ..."], Float[Array, " instant"] | None]:
        """Set points of the servos at some instants [rad or m], and shares of a cycle.

        The share of an interpolation cycle that has passed since the last set point has
        shape (instant,); it is None without cycles.
        """
        rows = lambda time: jnp.asarray(time, at.rest.dtype) / signal.time_step
        if self.dead_time is not None:
            at = at.earlier(rows(self.dead_time))
        if self.interpolation_cycle is None:
            return self._filtered(signal, at), None
        cycle = rows(self.interpolation_cycle)
        s = at.shares_of_turns(1 / cycle)
        rule = _INTERPOLATIONS[self.interpolation]
        first, *others = (
            shared(w, self._filtered(signal, at.earlier((s + back) * cycle)))
            for w, back in zip(
                rule.weights(s), reversed(range(rule.point_count)), strict=True
            )
        )
        return sum(others, first), s

    def _filtered(
        self, signal: Signal, at: Instants
    ) -> Float[Array, "instant joint ..."]:
        """Averaged and shaped command at some instants [rad or m]."""
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
        """Amplitudes A_1 and A_2 of the input shaper [-]."""
        zeta = jnp.asarray(self.shaper_damping_ratio, float)
        K = jnp.exp(-zeta * math.pi / jnp.sqrt(1 - zeta**2))
        return 1 / (1 + K), K / (1 + K)

    def _servo_lag(self) -> Float[Array, "*joint"]:
        """Delay of the servos behind a slow motion [s]."""
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
        since: Jumps | None,
    ) -> tuple[Float[Array, "instant joint ..."], _Lags]:
        """Response of low-pass and servos to set points, and their last state.

        Args:
            rows: The set points.
            step: Time between them [s].
            lags: State at the first.
            since: The jumps to each of the others; None for an input that is linear
                between them.
        """
        dtype, joints = rows.dtype, rows.shape[1]
        each = lambda x: jnp.broadcast_to(jnp.asarray(x, dtype), (joints,))
        column = lambda x: x.reshape(joints, *(1,) * (rows.ndim - 2))
        filtered = None
        if self.low_pass is not None:
            assert lags.filtered is not None
            w = column(2 * math.pi * each(self.low_pass))
            rows = first_order(rows, w, step, lags.filtered, since)
            # The output of a low-pass has no jumps.
            filtered, since = rows[-1], None
        if self.bandwidth is None:
            return rows, _Lags(filtered)
        assert lags.position is not None
        w = 2 * math.pi * each(self.bandwidth)
        if self.damping_ratio is None:
            rows = first_order(rows, column(w), step, lags.position, since)
            return rows, _Lags(filtered, rows[-1])
        assert lags.speed is not None
        servo = SecondOrder(column(w), column(each(self.damping_ratio)))
        rows, speed = servo.follow(rows, step, lags.position, lags.speed, since)
        return rows, _Lags(filtered, rows[-1], speed)
