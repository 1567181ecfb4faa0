"""Modes of ring-downs or frequency responses, and the joints' dampers from them."""

import dataclasses
import itertools
import math

import numpy as np
from jaxtyping import Bool, Complex, Float

from ...robot import Robot, natural_frequencies
from .._modal.frequency_response import FrequencyResponseFit, fit_frequency_response
from .._modal.ring_down import (
    JointDampingFit,
    RingDownFit,
    fit_joint_damping,
    fit_ring_down,
    ring_down_frequencies,
)
from .._record.record import MeasuredChannel
from .study import OnProgress, StudyError, silent

# A response is doubted if modes explain a smaller share of it; another sign of its
# phase is the cause if it leaves at most this share as much.
_LEAST_EXPLAINED, _LESS_LEFT = 0.9, 0.5
# Relative distance of a measured frequency from the model's at which both hardly are of
# one mode.
_FAR = 0.3


@dataclasses.dataclass(frozen=True)
class ResponseFaults:
    """Signs of a frequency response that no structure has.

    Attributes:
        is_conjugate: Whether the phase has the other sign.
        is_reversed: Whether all modes move against the force at the point itself.
    """

    is_conjugate: bool = False
    is_reversed: bool = False


@dataclasses.dataclass(frozen=True)
class RingDown:
    """A free vibration.

    Attributes:
        name: The file.
        time: [s], shape (sample,).
        signal: Without its mean, shape (sample,).
        mode_count: Number of modes.
        frequencies: Guesses [Hz], shape (mode,), or None.
        q: Joint positions [rad or m], shape (joint,), or None.
        notes: What was assumed.
        channels: The columns that were read; none where a script gives the numbers.
        kind: Kind of the measurement.
        Fit: Result of `fit`.
    """

    name: str
    time: Float[np.ndarray, " sample"]
    signal: Float[np.ndarray, " sample"]
    mode_count: int
    frequencies: Float[np.ndarray, " mode"] | None
    q: Float[np.ndarray, " joint"] | None
    notes: tuple[str, ...]
    channels: tuple[MeasuredChannel, ...] = ()
    kind = "ring_down"
    Fit = RingDownFit

    def fit(self) -> RingDownFit:
        """Modes of the vibration.

        Raises:
            ValueError: It shows none.
        """
        guess = self.frequencies
        if guess is None:
            guess = ring_down_frequencies(self.time, self.signal, self.mode_count)
        return fit_ring_down(self.time, self.signal, guess)

    def faults(self, fit: RingDownFit | None) -> ResponseFaults:
        """Signs that no structure has: none, since a vibration has no reference.

        Args:
            fit: Of the vibration.
        """
        del fit
        return ResponseFaults()


@dataclasses.dataclass(frozen=True)
class FrequencyResponse:
    """A measured frequency response.

    Attributes:
        name: The file.
        frequency: [Hz], shape (line,).
        response: In SI units, shape (line,).
        quantity: "receptance", "mobility" or "accelerance".
        is_fitted: Which lines lie in the band to fit, shape (line,).
        mode_count: How many modes are sought.
        frequencies: Guesses [Hz], shape (mode,), or None.
        q: Joint positions [rad or m], shape (joint,), or None.
        notes: What was assumed.
        direction: In which the tool tip was struck and its motion measured, in the
            axes of the machine, of any length; None if it was not there.
        channels: The columns that were read; none where a script gives the numbers.
        kind: Kind of the measurement.
        Fit: Result of `fit`.
        Faults: Result of `faults`.
    """

    name: str
    frequency: Float[np.ndarray, " line"]
    response: Complex[np.ndarray, " line"]
    quantity: str
    is_fitted: Bool[np.ndarray, " line"]
    mode_count: int
    frequencies: Float[np.ndarray, " mode"] | None
    q: Float[np.ndarray, " joint"] | None
    notes: tuple[str, ...]
    direction: list[int | float] | None = None
    channels: tuple[MeasuredChannel, ...] = ()
    kind = "frequency_response"
    Fit = FrequencyResponseFit
    Faults = ResponseFaults

    def fit(self) -> FrequencyResponseFit:
        """Modes of the response.

        Raises:
            ValueError: It shows too few.
        """
        band = self.is_fitted
        return fit_frequency_response(
            self.frequency[band],
            self.response[band],
            modes=self.mode_count if self.frequencies is None else None,
            frequencies=self.frequencies,
            quantity=self.quantity,  # pyright: ignore[reportArgumentType]
        )

    def faults(self, fit: FrequencyResponseFit | None) -> ResponseFaults:
        """Signs of the response that no structure has.

        Energy goes into a damped structure and never out of it: with the phase of the
        other sign no modes are found. Where tip and sensor are one point, modes that
        all move against the force tell that one of both signs is reversed.

        Args:
            fit: Of the response as it is; None if it shows too few modes.
        """
        explained = -math.inf if fit is None else fit.explained
        is_conjugate = False
        if explained < _LEAST_EXPLAINED:
            try:
                other = dataclasses.replace(self, response=np.conj(self.response)).fit()
            except ValueError:
                other = None
            if other is not None and other.explained >= _LEAST_EXPLAINED:
                left = _LESS_LEFT * (1 - max(explained, 0.0))
                is_conjugate = 1 - other.explained <= left
                fit = other if is_conjugate else fit
        is_reversed = False
        if (
            self.direction is not None
            and fit is not None
            and fit.explained >= _LEAST_EXPLAINED
        ):
            is_reversed = bool((1 / fit.stiffness).sum() < 0)
        return ResponseFaults(is_conjugate, is_reversed)


@dataclasses.dataclass(frozen=True)
class ModeMatch:
    """A measured mode beside that of the model.

    Attributes:
        measurement: Index of the measurement.
        frequency: As measured [Hz].
        mode: Index of the model's mode.
        own: Frequency of that [Hz].
        is_far: Whether it is too far from it to count.
        is_taken: Whether another measured mode was taken for it before.
    """

    measurement: int
    frequency: float
    mode: int
    own: float
    is_far: bool
    is_taken: bool


@dataclasses.dataclass(frozen=True)
class ModeStudyFit:
    """Modes of each measurement, and the joints' dampers.

    Attributes:
        modes: Of each measurement.
        matches: Measured modes beside the model's, those in poses that are given.
        damping: Dampers, or None if no pose is given or no mode belongs to the model.
        faults: Of each measurement the signs that no structure has.
    """

    modes: tuple[RingDownFit, ...] | tuple[FrequencyResponseFit, ...]
    matches: tuple[ModeMatch, ...]
    damping: JointDampingFit | None
    faults: tuple[ResponseFaults, ...]


@dataclasses.dataclass(frozen=True)
class ModeStudy:
    """Ring-downs or frequency responses.

    Attributes:
        name: The file.
        robot: The robot with masses and joint stiffness, or None.
        measured: The measurements, all of one kind.
        Fit: Result of `run`.
    """

    name: str
    robot: Robot | None
    measured: tuple[RingDown, ...] | tuple[FrequencyResponse, ...]
    Fit = ModeStudyFit

    @property
    def kind(self) -> str:
        """Kind of the measurements."""
        return self.measured[0].kind

    def run(self, on_progress: OnProgress = silent) -> ModeStudyFit:
        """Fit the modes, and the dampers if a robot and poses are given.

        Args:
            on_progress: Receives a line about each step.

        Raises:
            StudyError: A measurement cannot be fitted.
        """
        fits, faults = [], []
        for one in self.measured:
            on_progress(f"modes of {one.name}")
            fit, reason = None, ""
            try:
                fit = one.fit()
            except ValueError as error:
                reason = str(error)
            # A measurement and its own fit are of one kind.
            fault = one.faults(fit)  # pyright: ignore[reportArgumentType]
            if fit is None:
                if fault.is_conjugate:
                    reason += (
                        " The phase has the wrong sign: with the other it shows them."
                    )
                raise StudyError(f"{one.name}: {reason}")
            fits.append(fit)
            faults.append(fault)
        robot = self.robot
        poses = {i: one.q for i, one in enumerate(self.measured) if one.q is not None}
        if robot is None or not poses:
            return ModeStudyFit(tuple(fits), (), None, tuple(faults))
        matches, ratios = [], np.full((len(poses), robot.joint_count), np.nan)
        for row, (i, q) in zip(ratios, poses.items(), strict=True):
            own = np.asarray(natural_frequencies(robot, q), np.float64)
            modes = zip(fits[i].frequencies, fits[i].damping_ratios, strict=True)
            for f, zeta in itertools.compress(modes, fits[i].identifiable):
                k = int(np.argmin(np.abs(np.log(own / f))))
                is_far = bool(abs(f / own[k] - 1) > _FAR)
                is_taken = bool(np.isfinite(row[k]))
                matches.append(
                    ModeMatch(i, float(f), k, float(own[k]), is_far, is_taken)
                )
                if not (is_far or is_taken):
                    row[k] = zeta
        damping = None
        if np.isfinite(ratios).any():
            damping = fit_joint_damping(robot, list(poses.values()), ratios)
        return ModeStudyFit(tuple(fits), tuple(matches), damping, tuple(faults))
