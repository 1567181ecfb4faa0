"""Low-pass filters for forces and deviations, on the host."""

import numpy as np
from jaxtyping import Array, Float

from .._types import RealScalarLike


def lowpass(
    signal: Float[Array, "sample axis"] | Float[np.ndarray, "sample axis"],
    sample_rate: RealScalarLike,
    cutoff: RealScalarLike,
    *,
    order: int = 4,
) -> Float[np.ndarray, "sample axis"]:
    """Signal after a Butterworth low-pass filter, run forward and backward.

    The two passes cancel each other's phase: nothing is delayed. Together they are
    one multiplication of the spectrum by the gain

        |H(f)|^2 = 1 / (1 + (tan(pi f / f_s) / tan(pi f_c / f_s))^(2 order)),

    so it is 1/2 (-6 dB) at the cut-off. The ends are extended by odd reflection.

    Args:
        signal: Equally spaced samples, one column per axis, shape (sample, axis).
        sample_rate: Samples per second f_s [Hz].
        cutoff: Cut-off frequency f_c [Hz], below half of `sample_rate`.
        order: Order of one pass.

    Returns:
        The filtered signal in the unit of `signal`, shape (sample, axis).

    Differentiability: linear in `signal`, but a host function of NumPy arrays; it
    cannot be traced.
    """
    rate, edge = float(sample_rate), float(cutoff)
    if not 0.0 < edge < rate / 2:
        raise ValueError(
            f"Argument `cutoff` must lie between 0 and half of `sample_rate` "
            f"({rate / 2:g} Hz), but is {edge:g} Hz."
        )
    if order < 1:
        raise ValueError(f"Argument `order` must be at least 1, but is {order}.")
    values = np.asarray(signal, dtype=np.float64)
    # The spectrum takes the record as periodic: both its ends are continued until the
    # filter's slowest pole has forgotten the step from the last sample to the first.
    padding = int(np.ceil(3 * order * rate / edge))
    longer = np.pad(values, ((padding,) * 2, (0, 0)), "reflect", reflect_type="odd")
    count = longer.shape[0]
    with np.errstate(over="ignore"):
        # At half the sampling rate the tangent, and its power, have no bound.
        warped = np.tan(np.pi * np.fft.rfftfreq(count)) / np.tan(np.pi * edge / rate)
        gain = 1 / (1 + np.abs(warped) ** (2 * order))
    filtered = np.fft.irfft(np.fft.rfft(longer, axis=0) * gain[:, None], count, axis=0)
    return np.ascontiguousarray(filtered[padding : padding + values.shape[0]])
