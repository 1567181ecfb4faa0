"""Residual of a fit over time and over frequency."""

import numpy as np
from jaxtyping import Float

from .force_coefficients import ForceCoefficientFit
from .regression_rows import equations


def residual_force(
    fit: ForceCoefficientFit, record: int = 0
) -> Float[np.ndarray, "row 3"]:
    """Return measured minus modelled force of a record.

    Args:
        fit: The fit.
        record: Index of the record.

    Returns:
        Force in `work` axes [N], shape (row, 3); NaN where nothing was measured or
        the record is outside the cut.
    """
    row = equations(fit.records[record], ())
    return row.force - row.columns @ fit.raw


def residual_spectrum(
    fit: ForceCoefficientFit, record: int = 0
) -> tuple[Float[np.ndarray, " frequency"], Float[np.ndarray, "frequency 3"]]:
    """Return the amplitudes that a fit leaves, over the frequency.

    Peaks at the spindle frequency tell of run-out, at the tooth passing and its
    multiples of a wrong engagement or law, elsewhere of vibration. White noise is flat.

    Args:
        fit: The fit.
        record: Index of the record, which must have been sampled evenly; missing
            samples count as zero.

    Returns:
        Frequencies [Hz], shape (frequency,), and amplitudes of sines in `work` axes
        [N], shape (frequency, 3), of the whole record (rectangular window).
    """
    off = np.nan_to_num(residual_force(fit, record))
    step = float(np.median(np.diff(fit.records[record].time)))
    amplitude = 2 * np.abs(np.fft.rfft(off, axis=0)) / len(off)
    return np.fft.rfftfreq(len(off), step), amplitude
