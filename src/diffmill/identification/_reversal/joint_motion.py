"""Motion of a joint between its encoders: what its regressions are made of.

    link(t + T) - motor(t) = c - tau / K + h s(q) + beta a        with the torque
    link(t + T) - motor(t) = c - r s(q) - T_v v + beta a + load   at equal load
    tau(t) = c + F_c s(q) + F_v v + J a + load                    the torque itself

with s an elastic, perfectly plastic element over the travel of the joint, as friction
of a robot with presliding.
"""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from .._record.record import MeasuredChannel

# Points and order of the polynomials that velocity and acceleration are taken from.
_WINDOW, _ORDER = 15, 3
# Samples of a period of the highest frequency that is left.
_SAMPLES_OF_PERIOD = 4


@dataclasses.dataclass(frozen=True)
class JointRecord:
    """A record of the joints of a robot that moves in the air.

    Attributes:
        name: The file.
        time_step: Time between two rows [s].
        motor: Angles of the motors behind their gears [rad], shape (row, joint).
        link: Angles of the links [rad], shape (row, joint); NaN where not measured.
        torque: Torques of the motors times the gear ratio [N m], shape (row, joint).
        notes: What was assumed.
        channels: The columns that were read.
    """

    name: str
    time_step: float
    motor: Float[np.ndarray, "row joint"]
    link: Float[np.ndarray, "row joint"]
    torque: Float[np.ndarray, "row joint"]
    notes: tuple[str, ...] = ()
    channels: tuple[MeasuredChannel, ...] = ()


def bristle(
    positions: Float[np.ndarray, " row"], presliding: float
) -> Float[np.ndarray, " row"]:
    """Stretch s of an elastic, perfectly plastic element, from -1 to 1.

        s_(k+1) = clip(s_k + (q_(k+1) - q_k) / z, -1, 1)

    Args:
        positions: q of the joint [rad], shape (row,).
        presliding: Travel z from the middle to sliding [rad].

    Returns:
        s, 0 at first, shape (row,).
    """
    steps = np.diff(positions)
    turns = np.flatnonzero(np.diff(np.sign(steps))) + 1
    stretch, value = np.zeros(len(positions)), 0.0
    # Between two turns the clip acts once.
    for first, last in zip([0, *turns], [*turns, len(steps)], strict=True):
        way = (positions[first + 1 : last + 1] - positions[first]) / presliding
        stretch[first + 1 : last + 1] = np.clip(value + way, -1.0, 1.0)
        value = stretch[last]
    return stretch


@dataclasses.dataclass(frozen=True)
class JointMotion:
    """A joint of one record, below a cut-off frequency.

    Attributes:
        record: The record.
        joint: Index of the joint.
        lowpass: Cut-off frequency [Hz].
        longest_presliding: Travel at whose double the state of the bristle is known
            [rad].
    """

    record: JointRecord
    joint: int
    lowpass: float
    longest_presliding: float

    @property
    def positions(self) -> Float[np.ndarray, " row"]:
        """Angle q of the motor [rad], shape (row,)."""
        return self.record.motor[:, self.joint]

    @functools.cached_property
    def is_used(self) -> Bool[np.ndarray, " row"]:
        """Rows of the thinned record where the bristle no longer knows its start.

        Those at the ends, which the low-pass does not know, are left out.
        """
        way = np.maximum.accumulate(np.abs(self.positions - self.positions[0]))
        is_known = way > 2 * self.longest_presliding
        margin = int(1.0 / (self.lowpass * self.record.time_step))
        is_known[:margin] = is_known[len(way) - margin :] = False
        return is_known[:: self._stride]

    @property
    def _stride(self) -> int:
        rate = _SAMPLES_OF_PERIOD * self.lowpass * self.record.time_step
        return max(int(1.0 / rate), 1)

    def low(self, signals: Float[np.ndarray, "..."]) -> np.ndarray:
        """Signals below the cut-off frequency, thinned, at the rows that are used."""
        from scipy.signal import butter, sosfiltfilt

        share = 2 * self.record.time_step * self.lowpass
        if share < 0.9:
            sos = butter(3, share, output="sos")
            signals = sosfiltfilt(sos, signals, axis=0)
        return signals[:: self._stride][self.is_used]

    @functools.cached_property
    def _rates(self) -> Float[np.ndarray, "2 row joint"]:
        """Velocities and accelerations of all motors [rad/s, rad/s^2]."""
        from scipy.signal import savgol_filter

        return np.array(
            [
                savgol_filter(
                    self.record.motor,
                    _WINDOW,
                    _ORDER,
                    deriv=order,
                    delta=self.record.time_step,
                    axis=0,
                )
                for order in (1, 2)
            ]
        )

    @functools.cached_property
    def velocity(self) -> Float[np.ndarray, " used"]:
        """Velocity v of the motor [rad/s], shape (used,)."""
        return self.low(self._rates[0, :, self.joint])

    @functools.cached_property
    def acceleration(self) -> Float[np.ndarray, " used"]:
        """Acceleration a of the motor [rad/s^2], shape (used,)."""
        return self.low(self._rates[1, :, self.joint])

    @functools.cached_property
    def torque(self) -> Float[np.ndarray, " used"]:
        """Torque tau [N m], shape (used,)."""
        return self.low(self.record.torque[:, self.joint])

    @functools.cached_property
    def angle(self) -> Float[np.ndarray, " used"]:
        """Angle q at the rows that are used [rad], shape (used,)."""
        return self.positions[:: self._stride][self.is_used]

    @functools.cached_property
    def load(self) -> Float[np.ndarray, "used column"]:
        """Columns of weight and inertia at the rows that are used."""
        return self.low(self._load)

    def torque_terms(self, presliding: float) -> Float[np.ndarray, "row column"]:
        """Columns of bristle, v, a, load and 1 at every row of the record."""
        own = [
            bristle(self.positions, presliding),
            *self._rates[:, :, self.joint],
            np.ones(len(self.positions)),
        ]
        return np.column_stack([*own[:3], self._load, own[3]])

    @functools.cached_property
    def _load(self) -> Float[np.ndarray, "row column"]:
        """Columns of which weight and inertia are made: angles of it and neighbours.

        The weight of an arm at one of its joints is a sum of products of sines and
        cosines of the joints; of those of the neighbours here, with their
        accelerations.
        """
        motor, own = self.record.motor, self.joint
        waves = lambda k: [np.sin(motor[:, k]), np.cos(motor[:, k])]
        columns = waves(own)
        for k in (own - 1, own + 1):
            if 0 <= k < motor.shape[1] and np.ptp(motor[:, k]) > 0:
                columns += waves(k)
                columns += [x * y for x in waves(own) for y in waves(k)]
                a = self._rates[1, :, k]
                columns.append(a / max(float(np.abs(a).max()), 1e-300))
        return np.stack(columns, axis=1)

    def deflection(self, delay: float) -> Float[np.ndarray, " used"]:
        """Link less motor, a delay of the link's encoder taken out [rad].

        Args:
            delay: T [s].
        """
        from scipy.interpolate import CubicSpline

        if delay not in self._deflections:
            time = np.arange(len(self.positions)) * self.record.time_step
            link = CubicSpline(time, self.record.link[:, self.joint])
            shifted = link(time + delay)
            self._deflections[delay] = self.low(shifted - self.positions)
        return self._deflections[delay]

    def bristle(self, presliding: float) -> Float[np.ndarray, " used"]:
        """Bristle s(q) [-], shape (used,)."""
        if presliding not in self._bristles:
            stretch = bristle(self.positions, presliding)
            self._bristles[presliding] = self.low(stretch)
        return self._bristles[presliding]

    # Of travels and delays that were asked for: each serves several regressions.
    @functools.cached_property
    def _bristles(self) -> dict[float, np.ndarray]:
        return {}

    @functools.cached_property
    def _deflections(self) -> dict[float, np.ndarray]:
        return {}


def offsets(motions: Sequence[JointMotion]) -> list[Float[np.ndarray, "used record"]]:
    """Columns of a constant per record: encoders are zeroed between records."""
    return [
        np.tile(np.arange(len(motions)) == place, (len(one.angle), 1)).astype(float)
        for place, one in enumerate(motions)
    ]
