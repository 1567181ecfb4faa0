"""Bandwidth and dead time of a controller from a path in the air.

Where nothing cuts, the tool does what the controller makes of its command. The servos
of all joints are taken as alike, so that the tip follows as each joint does:

    actual(t) = offset + servo(command)(t - t_0)

A slow motion shows the sum of dead time and lag alone; what parts them is acceleration.
"""

import dataclasses
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...robot import Controller
from .study import OnProgress, StudyError, silent

# Where the search begins: bandwidths [Hz] and dead times [s].
_BANDWIDTHS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
_DEAD_TIMES = (0.0, 0.01, 0.03, 0.08, 0.2)
# Relative standard error up to which a bandwidth is known.
_LARGEST_RELATIVE_ERROR = 0.2
# Rows that a record must have besides the unknowns.
_LEAST_ROWS = 20


@dataclasses.dataclass(frozen=True)
class ControllerStudyFit:
    """Servo and dead time.

    Attributes:
        bandwidth: Of the servo [Hz].
        damping_ratio: Of a servo of second order; None for one of first.
        dead_time: [s].
        standard_errors: Of these, by their names.
        is_identifiable: Whether the path shows the bandwidth.
        residual_rms: Root mean square of the residual per axis [m].
        measured: Actual less commanded tip at the rows of the record [m], (row, 3).
        predicted: The same by the fit, shape (row, 3).
    """

    bandwidth: float
    damping_ratio: float | None
    dead_time: float
    standard_errors: dict[str, float]
    is_identifiable: bool
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
        from scipy.optimize import least_squares

        on_progress("bandwidth and dead time")
        rows = self.is_recorded
        if rows.sum() < _LEAST_ROWS or np.ptp(self.commanded, axis=0).max() == 0:
            raise StudyError(
                f"{self.name}: found {int(rows.sum())} rows, but a path that moves and "
                f"at least {_LEAST_ROWS} rows of it are required."
            )
        command = jnp.asarray(self.commanded)
        step = jnp.asarray(self.time_step, float)

        def residual(x: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, " number"]:
            response = np.asarray(_response(jnp.asarray(x), command, step))
            off = (self.actual - response)[rows]
            return (off - off.mean(axis=0)[None]).reshape(-1)

        def slopes(x: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, "number u"]:
            response = np.asarray(_response_slopes(jnp.asarray(x), command, step))[rows]
            return -(response - response.mean(axis=0)[None]).reshape(-1, x.size)

        last = (np.log(0.7),) if self.order == "second" else ()
        starts = [
            np.array([np.log(bandwidth), dead_time, *last])
            for bandwidth in _BANDWIDTHS
            for dead_time in _DEAD_TIMES
        ]
        start = min(starts, key=lambda x: float(np.sum(residual(x) ** 2)))
        lower = np.array([-np.inf, 0.0, -np.inf])[: start.size]
        x = least_squares(
            residual,
            start,
            jac=slopes,  # pyright: ignore[reportArgumentType]
            bounds=(lower, np.inf),
            x_scale="jac",
        ).x
        off, J = residual(x), slopes(x)
        variance = off @ off / (off.size - x.size - 3)
        errors = np.sqrt(np.diag(variance * np.linalg.pinv(J.T @ J)))
        bandwidth = float(np.exp(x[0]))
        standard_errors = {
            "bandwidth": bandwidth * float(errors[0]),
            "dead_time": float(errors[1]),
        }
        zeta = None
        if x.size == 3:
            zeta = float(np.exp(x[2]))
            standard_errors["damping_ratio"] = zeta * float(errors[2])
        response = np.asarray(_response(jnp.asarray(x), command, step))
        offset = (self.actual - response)[rows].mean(axis=0)
        return ControllerStudyFit(
            bandwidth=bandwidth,
            damping_ratio=zeta,
            dead_time=float(x[1]),
            standard_errors=standard_errors,
            is_identifiable=bool(errors[0] < _LARGEST_RELATIVE_ERROR),
            residual_rms=float(np.sqrt(np.mean(off**2))),
            measured=(self.actual - self.commanded)[rows],
            predicted=(response + offset[None] - self.commanded)[rows],
        )


@eqx.filter_jit
def _response(
    x: Float[Array, " unknown"],
    command: Float[Array, "row 3"],
    step: Float[Array, ""],
) -> Float[Array, "row 3"]:
    """Tips behind a controller [m], shape (row, 3), for its command.

    Args:
        x: Logarithm of the bandwidth [Hz], dead time [s], logarithm of zeta if any.
        command: Commanded tips [m].
        step: Time between them [s].
    """
    controller = Controller(
        bandwidth=jnp.exp(x[0]),
        dead_time=x[1],
        damping_ratio=jnp.exp(x[2]) if x.size == 3 else None,
    )
    return controller.respond(command, step)


_response_slopes = eqx.filter_jit(jax.jacfwd(_response))
