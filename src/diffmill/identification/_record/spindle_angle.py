"""The spindle's angle from the pulses of a tacho."""

import dataclasses

import numpy as np
from jaxtyping import Float


@dataclasses.dataclass(frozen=True)
class Pulses:
    """Pulses of a tacho.

    Attributes:
        instants: Instants [s], increasing, shape (pulse,).
        numbers: Their numbers, lost pulses counted, shape (pulse,).
    """

    instants: Float[np.ndarray, " pulse"]
    numbers: Float[np.ndarray, " pulse"]

    @classmethod
    def of_signal(
        cls, time: Float[np.ndarray, " sample"], signal: Float[np.ndarray, " sample"]
    ) -> "Pulses":
        """Pulses of a signal; see `Record.angle_from_tacho`.

        Args:
            time: [s], shape (sample,).
            signal: The tacho's, shape (sample,).

        Raises:
            ValueError: There are fewer than two pulses.
        """
        low, high = float(signal.min()), float(signal.max())
        middle, rearm = 0.5 * (low + high), low + 0.4 * (high - low)
        rises = np.flatnonzero((signal[1:] >= middle) & (signal[:-1] < middle))
        falls = np.flatnonzero(signal < rearm)
        # A rise counts if the signal was below the lower level since the rise before.
        last_fall = np.searchsorted(falls, rises, side="right")
        is_new = np.diff(last_fall, prepend=0) > 0
        rises = rises[is_new]
        part = (middle - signal[rises]) / (signal[rises + 1] - signal[rises])
        pulses = time[rises] + part * (time[rises + 1] - time[rises])
        if pulses.size >= 3:
            typical = float(np.median(np.diff(pulses)))
            pulses = pulses[np.diff(pulses, prepend=-np.inf) > 0.5 * typical]
        if pulses.size < 2:
            raise ValueError(
                f"The tacho must have at least 2 pulses, but has {pulses.size}."
            )
        steps = np.diff(pulses)
        counts = np.maximum(1.0, np.round(steps / np.median(steps)))
        return cls(pulses, np.concatenate([[0.0], np.cumsum(counts)]))

    def smoothed(self, width: int) -> "Pulses":
        """All pulses, lost ones too, at smooth instants.

        Args:
            width: Pulses through which a parabola is laid; up to three change nothing.
        """
        if width <= 3:
            return self
        from scipy.signal import savgol_filter

        every = np.arange(self.numbers[-1] + 1)
        instants = np.interp(every, self.numbers, self.instants)
        width = min(width, every.size)
        width -= 1 - width % 2
        if width > 3:
            instants = np.asarray(savgol_filter(instants, width, 2))
        return Pulses(instants, every)

    def passed(
        self, time: Float[np.ndarray, " sample"]
    ) -> Float[np.ndarray, " sample"]:
        """Number of pulses since the first, in parts too, shape (sample,).

        Args:
            time: [s], shape (sample,); outside the pulses the last speed goes on.
        """
        speeds = np.diff(self.numbers) / np.diff(self.instants)
        inside = np.interp(time, self.instants, self.numbers)
        before = np.minimum(time - self.instants[0], 0.0) * speeds[0]
        after = np.maximum(time - self.instants[-1], 0.0) * speeds[-1]
        return inside + before + after
