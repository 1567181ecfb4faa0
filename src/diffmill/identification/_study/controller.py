"""Bandwidth and dead time of a controller from a path in the air.

Where nothing cuts, the tool does what the controller makes of its command. The servos
of all joints are taken as alike, so that the tip follows as each joint does:

    actual(t) = offset + servo(command)(t - t_0)

A slow motion shows the sum of dead time and lag alone; what parts them is acceleration.
Noise of a tracker is correlated from row to row. With the correlation rho of neighbours
in the residual, slopes J_t and the residual's variance s^2,

    C = A^-1 (s^2 sum_ts rho^|t - s| J_t^T J_s) A^-1,  A = sum_t J_t^T J_t.

Whether one servo suits all axes is judged by a second fit, in which each axis has a
bandwidth of its own and shares the rest: with differences d of these and their
covariance C_d, d^T C_d^-1 d is a chi^2 where all are alike.
"""

import dataclasses
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...robot import Controller
from .study import OnProgress, StudyError, silent

# Where the search begins: bandwidths [Hz] and dead times [s].
_BANDWIDTHS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
_DEAD_TIMES = (0.0, 0.01, 0.03, 0.08, 0.2)
# Relative standard error up to which a bandwidth is known.
_LARGEST_RELATIVE_ERROR = 0.2
# Rows that a record must have besides the unknowns.
_LEAST_ROWS = 20
# Servos differ where chance would part the axes as far once in so many records, and
# bandwidths by this share.
_BY_CHANCE, _APART = 1e-3, 0.05
# An axis moves if its command does by this share of the liveliest.
_MOVES = 0.01


@dataclasses.dataclass(frozen=True)
class ControllerStudyFit:
    """Servo and dead time.

    Attributes:
        bandwidth: Of the servo [Hz].
        damping_ratio: Of a servo of second order; None for one of first.
        dead_time: [s].
        standard_errors: Of these, by their names.
        is_identifiable: Whether the path shows the bandwidth, and one servo suits all
            axes.
        bandwidth_by_axis: Of each axis of the record, if all share the rest [Hz],
            shape (3,); NaN for one that does not move.
        are_servos_alike: Whether these differ by no more than noise makes likely.
        residual_rms: Root mean square of the residual per axis [m].
        measured: Actual less commanded tip at the rows of the record [m], (row, 3).
        predicted: The same by the fit, shape (row, 3).
    """

    bandwidth: float
    damping_ratio: float | None
    dead_time: float
    standard_errors: dict[str, float]
    is_identifiable: bool
    bandwidth_by_axis: Float[np.ndarray, " 3"]
    are_servos_alike: bool
    residual_rms: float
    measured: Float[np.ndarray, "row 3"]
    predicted: Float[np.ndarray, "row 3"]


@dataclasses.dataclass(frozen=True)
class ControllerStudy:
    """Commanded and actual tips of a path in the air, on one clock.

    Attributes:
        name: The file.
        time_step: Time between two rows [s].
        commanded: Tips [m], shape (row, 3).
        actual: Tips [m], shape (row, 3).
        is_recorded: Rows at which the actual tip is known, shape (row,).
        order: Order of the servo.
        notes: What was assumed.
        kind: Kind of the measurements.
        Fit: Result of `run`.
    """

    name: str
    time_step: float
    commanded: Float[np.ndarray, "row 3"]
    actual: Float[np.ndarray, "row 3"]
    is_recorded: Bool[np.ndarray, " row"]
    order: Literal["first", "second"]
    notes: tuple[str, ...]
    kind = "controller"
    Fit = ControllerStudyFit

    def run(self, on_progress: OnProgress = silent) -> ControllerStudyFit:
        """Fit servo and dead time, a constant offset aside.

        Args:
            on_progress: Receives a line about each step.

        Raises:
            StudyError: The path does not move, or has too few rows.
        """
        on_progress("bandwidth and dead time")
        rows = self.is_recorded
        if rows.sum() < _LEAST_ROWS or np.ptp(self.commanded, axis=0).max() == 0:
            raise StudyError(
                f"{self.name}: found {int(rows.sum())} rows, but a path that moves and "
                f"at least {_LEAST_ROWS} rows of it are required."
            )
        last = (np.log(0.7),) if self.order == "second" else ()
        starts = [
            np.array([np.log(bandwidth), dead_time, *last])
            for bandwidth in _BANDWIDTHS
            for dead_time in _DEAD_TIMES
        ]
        alike = _Servos.of(self, np.tile(np.arange(2 + len(last)), (3, 1)))
        start = min(starts, key=lambda x: float(np.sum(alike.residual(x) ** 2)))
        x = alike.solve(start)
        off = alike.residual(x)
        errors = np.sqrt(np.diagonal(alike.covariance(x)))
        bandwidth = float(np.exp(x[0]))
        moves = np.ptp(self.commanded, axis=0)
        moving = np.flatnonzero(moves > _MOVES * moves.max())
        # Own bandwidths of the axes that move, and behind them what all share.
        place = np.tile(moving.size - 1 + np.arange(x.size), (3, 1))
        place[moving, 0] = np.arange(moving.size)
        apart = _Servos.of(self, place)
        y = apart.solve(np.concatenate([np.full(moving.size, x[0]), x[1:]]))
        by_axis = np.full(3, np.nan)
        by_axis[moving] = np.exp(y[: moving.size])
        are_alike = _are_alike(y, apart.covariance(y), moving.size)
        standard_errors = {
            "bandwidth": bandwidth * float(errors[0]),
            "dead_time": float(errors[1]),
        }
        zeta = None
        if x.size == 3:
            zeta = float(np.exp(x[2]))
            standard_errors["damping_ratio"] = zeta * float(errors[2])
        response = alike.response(x)
        offset = (self.actual - response)[rows].mean(axis=0)
        return ControllerStudyFit(
            bandwidth=bandwidth,
            damping_ratio=zeta,
            dead_time=float(x[1]),
            standard_errors=standard_errors,
            is_identifiable=bool(errors[0] < _LARGEST_RELATIVE_ERROR) and are_alike,
            bandwidth_by_axis=by_axis,
            are_servos_alike=are_alike,
            residual_rms=float(np.sqrt(np.mean(off**2))),
            measured=(self.actual - self.commanded)[rows],
            predicted=(response + offset[None] - self.commanded)[rows],
        )


class _Servos(NamedTuple):
    """Servos of the axes with unknowns that some of them share.

    Attributes:
        place: Index of each axis' unknowns among all, shape (3, unknown): logarithm of
            the bandwidth [Hz], dead time [s], logarithm of zeta if any.
        command: Commanded tips [m], shape (row, 3).
        actual: Actual tips [m], shape (row, 3).
        step: Time between them [s], shape ().
        is_recorded: Rows at which the actual tip is known, shape (row,).
    """

    place: Array
    command: Array
    actual: Float[np.ndarray, "row 3"]
    step: Array
    is_recorded: Bool[np.ndarray, " row"]

    @classmethod
    def of(cls, study: ControllerStudy, place: np.ndarray) -> "_Servos":
        """Servos of the paths of a study."""
        return cls(
            jnp.asarray(place),
            jnp.asarray(study.commanded),
            study.actual,
            jnp.asarray(study.time_step, float),
            study.is_recorded,
        )

    def response(self, y: Float[np.ndarray, " all"]) -> Float[np.ndarray, "row 3"]:
        """Tips behind the servos [m]."""
        return np.asarray(
            _response(jnp.asarray(y), self.place, self.command, self.step)
        )

    def residual(self, y: Float[np.ndarray, " all"]) -> Float[np.ndarray, " number"]:
        """Actual less modelled tips at the recorded rows, without their mean [m]."""
        off = (self.actual - self.response(y))[self.is_recorded]
        return (off - off.mean(axis=0)[None]).reshape(-1)

    def slopes(self, y: Float[np.ndarray, " all"]) -> Float[np.ndarray, "number all"]:
        """Slopes of the residual by the unknowns."""
        J = _response_slopes(jnp.asarray(y), self.place, self.command, self.step)
        J = np.asarray(J)[self.is_recorded]
        return -(J - J.mean(axis=0)[None]).reshape(-1, y.size)

    def solve(self, start: Float[np.ndarray, " all"]) -> Float[np.ndarray, " all"]:
        """Unknowns of least squares; dead times are not negative."""
        from scipy.optimize import least_squares

        lower = np.full(start.size, -np.inf)
        lower[int(self.place[0, 1])] = 0.0
        return least_squares(
            self.residual,
            start,
            jac=self.slopes,  # pyright: ignore[reportArgumentType]
            bounds=(lower, np.inf),
            x_scale="jac",
        ).x

    def covariance(self, y: Float[np.ndarray, " all"]) -> Float[np.ndarray, "all all"]:
        """Covariance of the unknowns under noise that is correlated in time."""
        from scipy.signal import lfilter

        rows, count = self.is_recorded, self.is_recorded.size
        flat = self.slopes(y)
        r, J = np.zeros((count, 3)), np.zeros((count, 3, y.size))
        r[rows], J[rows] = self.residual(y).reshape(-1, 3), flat.reshape(-1, 3, y.size)
        known, both = int(rows.sum()), rows[1:] & rows[:-1]
        square = np.maximum(np.sum(r**2, axis=0), 1e-300)
        product = np.sum((r[1:] * r[:-1])[both], axis=0) * known / max(both.sum(), 1)
        M = np.zeros((y.size, y.size))
        for axis, rho in enumerate(np.clip(product / square, 0.0, 1 - 1 / known)):
            own = J[:, axis]
            later = lfilter([1.0], [1.0, -rho], own, axis=0)
            sooner = lfilter([1.0], [1.0, -rho], own[::-1], axis=0)[::-1]
            # The offset and a share of the unknowns are fitted to each axis.
            variance = square[axis] / max(known - 1 - y.size / 3, 1)
            M += variance * own.T @ (later + sooner - own)
        A = np.linalg.pinv(flat.T @ flat)
        return A @ M @ A


def _are_alike(
    y: Float[np.ndarray, " all"], C: Float[np.ndarray, "all all"], count: int
) -> bool:
    """True if noise makes it likely that bandwidths differ as the first unknowns do.

    Args:
        y: Logarithms of the bandwidths, and other unknowns.
        C: Their covariance.
        count: How many bandwidths there are.
    """
    from scipy.stats import chi2

    if count < 2 or np.ptp(y[:count]) < _APART:
        return True
    R = np.eye(count - 1, y.size) - np.eye(count - 1, y.size, 1)
    d = R @ y
    statistic = float(d @ np.linalg.pinv(R @ C @ R.T) @ d)
    return bool(chi2.sf(statistic, count - 1) > _BY_CHANCE)


@eqx.filter_jit
def _response(
    y: Float[Array, " all"],
    place: Int[Array, "3 unknown"],
    command: Float[Array, "row 3"],
    step: Float[Array, ""],
) -> Float[Array, "row 3"]:
    """Tips behind servos [m], shape (row, 3), for their command; see `_Servos`."""

    def axis(x: Float[Array, " unknown"], path: Float[Array, " row"]) -> Array:
        controller = Controller(
            bandwidth=jnp.exp(x[0]),
            dead_time=x[1],
            damping_ratio=jnp.exp(x[2]) if x.size == 3 else None,
        )
        return controller.respond(path[:, None], step)[:, 0]

    return jax.vmap(axis, in_axes=(0, 1), out_axes=1)(y[place], command)


_response_slopes = eqx.filter_jit(jax.jacfwd(_response))
