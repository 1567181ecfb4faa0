"""Parts of a path where different things go wrong: entry, exit, corner, plateau.

An arm that enters the material is pushed aside and rings; in a corner the force turns
with the feed; on a plateau the force is steady, so that what is left there is mostly a
mean. One figure for the whole path hides which of them a correction has missed.
"""

from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._moving_rows import is_moving, step_lengths
from ..._types import BoolSteps, FloatRows3, FloatSteps

# Turn of the feed within the length of a window that makes a corner [rad].
_CORNER_TURN = np.deg2rad(10.0)
# Change of the cut section over a window, relative to the larger, that is no plateau.
_SECTION_CHANGE = 0.25
# Row spacing below which a tool dwells [m].
_DWELL_SPACING = 1e-9
# A full cut pushes the rigid tool by at least this share of the median force on it.
_FULL_CUT_SHARE = 0.25


class PathParts(eqx.Module):
    """Part of the path to which every row belongs.

    Attributes:
        index: Index into `NAMES`, -1 where the tool does not cut, shape (step,).
    """

    NAMES: ClassVar[tuple[str, ...]] = ("entry", "exit", "corner", "plateau")

    index: Int[np.ndarray, " step"]

    @classmethod
    def of_path(
        cls,
        desired: FloatRows3,
        is_cutting: BoolSteps,
        reach: float,
        *,
        removed_volume: FloatSteps | None = None,
    ) -> "PathParts":
        """Parts of a path.

        A row is in a corner if the desired path turns by more than 10 degrees within
        half a reach to either side. Else it is an entry within a reach after the cut
        begins, and an exit within a reach before it ends. Where the removed volume is
        given, rows within a reach behind a rise of the cut section by more than a
        quarter are an entry too, and those behind a fall an exit. The rest is plateau.

        Args:
            desired: Desired tips [m], shape (step, 3).
            is_cutting: Whether the rigid tool cuts, shape (step,).
            reach: Travel in which the cut settles [m]; the radius of the tool is the
                travel from its first touch to full immersion.
            removed_volume: Volume that the rigid tool removes at each row [m^3], shape
                (step,).

        Raises:
            ValueError: The reach is not positive.

        **Differentiability**: none, a host function.
        """
        if not reach > 0:
            raise ValueError(f"Argument `reach` must be positive, but is {reach}.")
        entry, exit_, corner, plateau = range(4)
        desired = np.asarray(desired, np.float64)
        is_cutting = np.asarray(is_cutting, bool)
        travel = np.cumsum(step_lengths(desired))
        since, until = _distances_to_air(travel, is_cutting)
        part = np.full(len(desired), plateau, np.int32)
        if removed_volume is not None:
            rise = _section_rise(travel, np.asarray(removed_volume, np.float64), reach)
            part[rise > _SECTION_CHANGE] = entry
            part[rise < -_SECTION_CHANGE] = exit_
        part[until < reach] = exit_
        part[since < reach] = entry
        part[_turn(desired, travel, reach / 2) > _CORNER_TURN] = corner
        part[~is_cutting] = -1
        return cls(part)

    def rows(self, *names: str) -> Bool[np.ndarray, " step"]:
        """True at rows that belong to one of some parts, shape (step,)."""
        return np.isin(self.index, [self.NAMES.index(name) for name in names])

    def figures(
        self, error: Float[np.ndarray, " step"] | Float[Array, " step"]
    ) -> dict[str, Float[np.ndarray, " part"]]:
        """Figures of an error for each part, NaN where a part is absent.

        Args:
            error: Length of the error at every row [m], shape (step,).

        Returns:
            "rms", "p95" and "max" [m] and "rows", each of shape (part,).

        **Differentiability**: none, a host function.
        """
        error = np.asarray(error, np.float64)
        found = [error[self.rows(name)] for name in self.NAMES]
        nothing = np.nan

        def each(figure):
            return np.array([figure(e) if e.size else nothing for e in found])

        return {
            "rms": each(lambda e: np.sqrt(np.mean(e**2))),
            "p95": each(lambda e: np.percentile(e, 95)),
            "max": each(np.max),
            "rows": np.array([e.size for e in found], np.float64),
        }

    def is_out_of_cut(
        self, force: FloatRows3, *, rigid_force: FloatRows3, desired: FloatRows3
    ) -> Bool[np.ndarray, " step"]:
        """True at rows where a tool cuts nothing but should be in a full cut, (step,).

        Entries and exits do not count: there a tool that is a little off begins or ends
        its cut a little earlier or later. Nor do rows at which the tool nearly rests,
        as at an exact stop, or at which the rigid tool hardly cuts. The force tells,
        not the removed volume, which poses that stand close together leave to one of
        them.

        Args:
            force: Mean force of the tooth period before each row [N], shape (step, 3).
            rigid_force: That on the rigid tool [N], shape (step, 3).
            desired: Desired tips [m], shape (step, 3).

        Returns:
            Whether it does, for each row, shape (step,).

        **Differentiability**: none, a host function.
        """
        is_out = self.rows("corner", "plateau")
        if not is_out.any():
            return is_out
        size = np.linalg.norm(np.asarray(rigid_force, np.float64), axis=1)
        is_full = size >= _FULL_CUT_SHARE * np.median(size[is_out])
        moves = is_moving(step_lengths(desired), np.asarray(self.index >= 0))
        return is_out & is_full & moves & ~np.any(np.asarray(force) != 0, axis=1)


def _distances_to_air(
    travel: Float[np.ndarray, " step"], is_cutting: Bool[np.ndarray, " step"]
) -> tuple[Float[np.ndarray, " step"], Float[np.ndarray, " step"]]:
    """Travel since the cut began and until it ends [m], each of shape (step,)."""
    air = np.flatnonzero(~is_cutting)
    rows = np.arange(len(travel))
    if not air.size:
        # The path begins and ends within the material.
        return travel - travel[0], travel[-1] - travel
    place = np.searchsorted(air, rows)
    first, last = np.clip(place - 1, 0, None), np.clip(place, None, len(air) - 1)
    since = np.where(place > 0, travel - travel[air[first]], travel - travel[0])
    until = np.where(place < len(air), travel[air[last]] - travel, travel[-1] - travel)
    return since, until


def _turn(
    desired: Float[np.ndarray, "step 3"],
    travel: Float[np.ndarray, " step"],
    window: float,
) -> Float[np.ndarray, " step"]:
    """Angle of the feed `window` ahead of a row to that behind it [rad], (step,)."""
    steps = np.diff(desired, axis=0)
    length = np.linalg.norm(steps, axis=1)
    moves = np.flatnonzero(length > _DWELL_SPACING)
    if not moves.size:
        return np.zeros(len(desired))
    direction = steps[moves] / length[moves, None]
    middle = 0.5 * (travel[moves] + travel[moves + 1])

    def at(place):
        nearest = np.clip(np.searchsorted(middle, place), 0, len(middle) - 1)
        return direction[nearest]

    cosine = np.sum(at(travel - window) * at(travel + window), axis=1)
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def _section_rise(
    travel: Float[np.ndarray, " step"],
    volume: Float[np.ndarray, " step"],
    reach: float,
) -> Float[np.ndarray, " step"]:
    """Relative rise of the cut section over the last reach, -1 to 1, shape (step,).

    The section is the removed volume per travel, over half a reach to either side.
    """
    # The rows without dwells, with all that was removed up to their end.
    is_last = np.append(np.diff(travel) > 0, True)
    rising, total = travel[is_last], np.cumsum(volume)[is_last]

    def removed(place):
        return np.interp(place, rising, total)

    def section(place):
        return (removed(place + reach / 2) - removed(place - reach / 2)) / reach

    now, before = section(travel), section(travel - reach)
    larger = np.maximum(now, before)
    return np.divide(now - before, larger, out=np.zeros_like(now), where=larger > 0)
