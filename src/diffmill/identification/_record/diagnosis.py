"""Diagnosis of a record: a code and its numbers, no words.

Nothing is changed by a diagnosis. Sentences are those of who shows it.
"""

from collections.abc import Mapping

import equinox as eqx

# Codes of faults that make coefficients wrong; others are only worth knowing.
_GRAVE = (
    "samples_lost",
    "clock_rate",
    "tooth_count",
    "channel_gain",
    "offset",
    "drift",
    "implausible_pressure",
    "implausible_ratio",
)


class Diagnosis(eqx.Module):
    """Fault of a record, by its numbers.

    Attributes:
        code: Kind of the fault:
            "samples_lost": phase steps by `shift` [s] at the instant `time` [s];
            "clock_wanders": clock and spindle part by `spread` [s] rms;
            "clock_rate": teeth pass `ratio` times as often as the spindle turns them;
            "tooth_count": forces repeat `found` times a turn, not `given` times;
            "channel_gain": the force along `axis` (0, 1, 2 of the work) is `ratio`
            times what suits the others; with it a share `left` of the squared force is
            not explained, without it `before`;
            "offset", "drift": constants `x, y, z` [N] or slopes [N/s], likewise;
            "spindle_line": the fit leaves sines of amplitudes `x, y, z` [N] at the
            spindle's `frequency` [Hz], though more than one tooth cuts; `is_fitted` is
            1 where a run-out was fitted, else 0;
            "implausible_pressure": K_tc, `value` [Pa], lies outside `least` to `most`,
            and would not divided by `factor` (NaN where no power of ten helps);
            "implausible_ratio": `radial` or `axial` over tangential coefficient.
        record: Index of its record; 0 if it concerns all.
        values: Its numbers, by name.
    """

    code: str = eqx.field(static=True)
    record: int = eqx.field(static=True)
    values: Mapping[str, float]

    @property
    def is_grave(self) -> bool:
        """True if coefficients are wrong by it.

        A line at the spindle's frequency is that where no run-out was fitted: teeth of
        unlike length begin and end their chips elsewhere.
        """
        is_unfitted = self.code == "spindle_line" and not self.values["is_fitted"]
        return is_unfitted or self.code in _GRAVE
