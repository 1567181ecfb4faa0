"""A straight cut of constant width and depth, as test cuts usually are."""

import dataclasses
import math
from typing import Literal

import numpy as np

from ...cutter import AbstractCutter
from ...workpiece import box
from .cut_model import Cut

Side = Literal["slot", "up", "down"]

# Tooth periods after which a cut that begins within the stock repeats itself.
SETTLED = 12
# Pitch of the rays over the radius, and the least number of rays across the depth.
# Twice the pitch moves coefficients of a slot by 0.1 %, those of its edges by 0.5 %.
_PITCH, _LEAST = 1 / 40, 6


@dataclasses.dataclass(frozen=True)
class StraightCut:
    """A straight cut of constant sizes.

    Attributes:
        cutter: The cutter.
        spindle_speed: Nominal [rad/s], or None if it is not known.
        feed_per_tooth: f_z [m].
        axial_depth: a_p [m].
        radial_depth: a_e [m], not above the diameter; None for a slot.
        side: "slot", "up" or "down".
    """

    cutter: AbstractCutter
    spindle_speed: float | None
    feed_per_tooth: float
    axial_depth: float
    radial_depth: float | None = None
    side: Side = "slot"

    def cut(self, *, teeth: int = 64, largest_feed: float | None = None) -> Cut:
        """Straight cut along x that begins within the stock.

        The tool is upright and moves along +x. In a slot both flanks of the tool
        are engaged; in up milling the stock lies where a tooth enters with a thin chip
        (+y), in down milling where it leaves with one (-y).

        Args:
            teeth: Tooth periods of the cut, the first 12 of which are not steady.
            largest_feed: The largest feed per tooth of several cuts [m]: with it all
                have stock of one size, and are compiled once.

        Returns:
            The cut.

        Raises:
            ValueError: Sizes that no straight cut has, or no spindle speed.
        """
        if self.spindle_speed is None:
            raise ValueError(
                "Argument `sizes` must have a spindle speed, but has none."
            )
        cutter, feed, depth = self.cutter, self.feed_per_tooth, self.axial_depth
        radius = float(cutter.nominal_radius)
        _check(feed, depth, self.radial_depth, self.side, radius)
        width = 2 * radius if self.radial_depth is None else self.radial_depth
        room = 0.2 * radius
        high = radius + room if self.side != "down" else width - radius
        low = -radius - room if self.side != "up" else radius - width
        x = feed * np.arange(teeth + 1)
        rows = np.column_stack([x, np.zeros_like(x), np.full_like(x, -depth)])
        pitch = min(_PITCH * radius, depth / _LEAST)
        lower = [-radius - room, low, -depth - 2 * pitch]
        length = teeth * max(feed, largest_feed or 0.0)
        upper = [length + radius + room, high, 0.0]
        stock = box(lower, upper, pitch, interval_counts=(4, 4, 1))
        return Cut(rows, stock, cutter, self.spindle_speed)

    @staticmethod
    def immersion(
        diameter: float, radial_depth: float | None, side: Side
    ) -> tuple[float, float]:
        """Entry and exit angle of a straight cut [rad].

        Args:
            diameter: Of the cutter [m].
            radial_depth: a_e [m]; not for a slot.
            side: "slot", "up" or "down".

        Returns:
            Immersion angles at which a tooth enters and leaves.

        Raises:
            ValueError: A radial depth that no such cut has.
        """
        _check(1.0, 1.0, radial_depth, side, diameter / 2)
        if radial_depth is None:
            return 0.0, math.pi
        angle = math.acos(1 - 2 * radial_depth / diameter)
        return (0.0, angle) if side == "up" else (math.pi - angle, math.pi)


def _check(
    feed: float, depth: float, width: float | None, side: str, radius: float
) -> None:
    """Refuse sizes that no straight cut has."""
    if not (feed > 0 and depth > 0):
        raise ValueError(
            "Arguments `feed_per_tooth` and `axial_depth` must be positive, but are "
            f"{feed} and {depth} m."
        )
    if side not in ("slot", "up", "down"):
        raise ValueError(
            f'Argument `side` must be "slot", "up" or "down", but is "{side}".'
        )
    if (width is None) != (side == "slot"):
        raise ValueError(
            'Argument `radial_depth` must be given for `side` "up" and "down", and not '
            f'for "slot", but is {width} for "{side}".'
        )
    if width is not None and not 0 < width <= 2 * radius * (1 + 1e-9):
        raise ValueError(
            f"Argument `radial_depth` must lie above 0 and not above the diameter, "
            f"{2e3 * radius:g} mm, but is {1e3 * width:g} mm."
        )
