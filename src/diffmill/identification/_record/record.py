"""A measured record of forces, with what is doubtful in it marked."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float


class Record(eqx.Module):
    """Three measured forces over time, in SI units, on the host.

    The axes are those of the dynamometer and the sign is the one that it recorded:
    nothing is turned or mirrored by reading. Forces are finite; rows that had none
    are left out and leave a gap, and a force that was not measured at all is zero.

    Attributes:
        time: Instants [s], increasing, shape (sample,).
        force: Forces in the recorded axes [N], shape (sample, 3).
        rate: Nominal sampling rate [Hz].
        is_saturated: Whether a channel is at the end of its range, shape (sample,).
        is_after_gap: Whether samples are missing just before, shape (sample,).
        tacho: Pulses of the spindle in any unit, shape (sample,), or None.
        angle: Measured spindle angle [rad], shape (sample,), or None.
        names: What the file calls the three forces.
        is_measured: Whether there is a channel of each force.
        notes: What was assumed or repaired when reading, one sentence each.
        source: The file, or where else the record comes from.

    Raises:
        ValueError: If shapes disagree, fewer than 2 samples are given, a force is not
            finite, no force is measured or one that is not differs from zero, the
            time does not increase or the rate is not positive.
    """

    time: Float[np.ndarray, " sample"]
    force: Float[np.ndarray, "sample 3"]
    rate: float
    is_saturated: Bool[np.ndarray, " sample"]
    is_after_gap: Bool[np.ndarray, " sample"]
    tacho: Float[np.ndarray, " sample"] | None = None
    angle: Float[np.ndarray, " sample"] | None = None
    names: tuple[str, str, str] = eqx.field(static=True, default=("Fx", "Fy", "Fz"))
    is_measured: tuple[bool, bool, bool] = eqx.field(static=True, default=(True,) * 3)
    notes: tuple[str, ...] = eqx.field(static=True, default=())
    source: str = eqx.field(static=True, default="")

    def __check_init__(self) -> None:
        """Refuse arrays that make no record."""
        count = np.size(self.time)
        if count < 2:
            raise ValueError(f"A record needs at least 2 samples, but has {count}.")
        for name in ("force", "is_saturated", "is_after_gap", "tacho", "angle"):
            value = getattr(self, name)
            wanted = (count, 3) if name == "force" else (count,)
            if value is not None and np.shape(value) != wanted:
                raise ValueError(
                    f"Argument `{name}` must have the shape {wanted}, but has "
                    f"{np.shape(value)}."
                )
        if not np.all(np.isfinite(self.force)):
            raise ValueError("Argument `force` must be finite, but is not.")
        if not any(self.is_measured):
            raise ValueError("Argument `is_measured` must name a force, but has none.")
        if np.any(self.force[:, ~np.array(self.is_measured)]):
            raise ValueError(
                "Argument `force` must be zero where not measured, but is not."
            )
        # Written so that NaN is refused, too.
        if not np.all(np.diff(self.time) > 0):
            raise ValueError("Argument `time` must increase, but does not.")
        if not (np.isfinite(self.rate) and self.rate > 0):
            raise ValueError(
                f"Argument `rate` must be positive and finite, but is {self.rate}."
            )
