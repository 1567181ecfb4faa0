"""Time and error of a program at several feeds."""

from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...toolpath import Path
from .trade_off_curve import FeedPoint

if TYPE_CHECKING:
    import xarray


class FeedTradeoff(eqx.Module):
    """Cycle time and error of a program at several overrides.

    Attributes:
        override: Factors of the feed, shape (override,).
        cycle_time: Time of the whole program [s], shape (override,).
        feed_per_tooth: Median advance per tooth where the tool cuts [m], shape
            (override,).
        uncorrected: Root mean square contour error over the length that is cut [m],
            shape (override,).
        corrected: The same of the corrected program; NaN where none was asked for.
        max_offset: Largest offset of the corrected program per axis [m]; NaN likewise.
    """

    override: Float[np.ndarray, " override"]
    cycle_time: Float[np.ndarray, " override"]
    feed_per_tooth: Float[np.ndarray, " override"]
    uncorrected: Float[np.ndarray, " override"]
    corrected: Float[np.ndarray, " override"]
    max_offset: Float[np.ndarray, " override"]

    def to_dataset(self) -> "xarray.Dataset":
        """Table on the dimension `override`, units in the attributes."""
        import xarray

        rms = "root mean square contour error over the length that is cut"
        about = {
            "cycle_time": ("s", "time of the whole program"),
            "feed_per_tooth": ("m", "median advance per tooth where the tool cuts"),
            "uncorrected": ("m", f"{rms}, program as it is"),
            "corrected": ("m", f"{rms}, corrected program"),
            "max_offset": ("m", "largest offset of the corrected program per axis"),
        }
        return xarray.Dataset(
            {
                name: ("override", getattr(self, name), _attributes(*text))
                for name, text in about.items()
            },
            coords={
                "override": (
                    "override",
                    self.override,
                    _attributes("1", "factor of the feed of the whole program"),
                )
            },
        )


class TunedFeed(eqx.Module):
    """The overrides along the path that are best for some weights of the time.

    Attributes:
        points: The program as it is, then one point for each weight.
        travel: Length of the path at the knots [m], shape (knot,).
        paths: The path of each point.
    """

    points: tuple[FeedPoint, ...]
    travel: Float[np.ndarray, " knot"]
    paths: tuple[Path, ...]

    def to_dataset(self) -> "xarray.Dataset":
        """Curve on the dimensions `weight` and `knot`."""
        import xarray

        column = lambda name: np.array([getattr(p, name) for p in self.points])
        rms = "root mean square contour error over the length that is cut"
        return xarray.Dataset(
            {
                "cycle_time": (
                    "weight",
                    column("cycle_time"),
                    _attributes("s", "time of the whole program"),
                ),
                "rms": ("weight", column("rms"), _attributes("m", rms)),
                "runs": (
                    "weight",
                    column("runs").astype(np.int32),
                    _attributes("1", "simulations, those with derivatives included"),
                ),
                "is_settled": (
                    "weight",
                    column("is_settled").astype(np.int8),
                    _attributes("1", "whether no further step promised anything"),
                ),
                "feed_override": (
                    ("weight", "knot"),
                    np.stack([point.override for point in self.points]),
                    _attributes("1", "feed over the programmed one"),
                ),
            },
            coords={
                "weight": (
                    "weight",
                    column("weight"),
                    _attributes("1", "weight of the time; none of the program itself"),
                ),
                "travel": ("knot", self.travel, _attributes("m", "length of the path")),
            },
        )


def _attributes(unit: str, meaning: str) -> dict[str, str]:
    return {"units": unit, "long_name": meaning}
