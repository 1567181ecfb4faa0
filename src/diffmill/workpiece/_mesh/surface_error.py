"""Surface error: signed distance from the ideal surface at every ray end.

The ends of the machined stock are points on its surface, exact to rounding. The ideal
stock becomes a mesh, and each point gets its distance to the nearest triangle, whatever
way the surface faces there: walls, floors and slopes are treated alike.

The measure goes one way: a rib of the ideal that was cut off altogether shows only in
the points of its foot.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from ..._arrays import on_device
from .._dexel.stock import Rays, Stock
from .hermite import inside_nodes

# Rays and ends this close, in spacings, are the same: the grid of a mesh from a file is
# off by the rounding of its vertices.
_SAME_SPACINGS = 1e-3
# Rays of a slab, about, and how many around it know what its borders hide.
_SLAB_LINES, _BESIDE = 30_000, 8


class SurfaceMeasures(eqx.Module):
    """Figures of a surface error, walls and floors apart; NaN where there is none.

    Attributes:
        wall_mean: Mean signed error of the walls [m], positive: material left.
        wall_rms: Root mean square error of the walls [m].
        wall_p95: 95 % of the walls' points are closer to the ideal surface [m].
        floor_mean: Mean signed error of the floors [m].
        floor_rms: Root mean square error of the floors [m].
        floor_p95: 95 % of the floors' points are closer to the ideal surface [m].
        deepest: Largest depth of the cut into the ideal part [m], at least 0.
    """

    wall_mean: float
    wall_rms: float
    wall_p95: float
    floor_mean: float
    floor_rms: float
    floor_p95: float
    deepest: float


class SurfaceError(eqx.Module):
    """Signed distance of a machined surface from the ideal one, on the host.

    Attributes:
        points: Points on the machined surface [m], shape (n, 3).
        error: Distance to the ideal surface [m], positive where material was left
            standing, negative where too much was cut, shape (n,).
        normal: Outward unit normal of the ideal surface at its nearest place,
            shape (n, 3).
        is_floor: True if that normal is within 45 degrees of the z axis (floors, tops
            and undersides), else a wall, shape (n,).
        is_cut: True if a tool pose cut the point; False on raw faces, shape (n,).
        family: Axis of the ray on which the point lies, shape (n,).
    """

    points: Float[np.ndarray, "n 3"]
    error: Float[np.ndarray, " n"]
    normal: Float[np.ndarray, "n 3"]
    is_floor: Bool[np.ndarray, " n"]
    is_cut: Bool[np.ndarray, " n"]
    family: Int[np.ndarray, " n"]

    @staticmethod
    def of_stock(
        machined: Stock, ideal: Stock, *, leaves_out_raw: bool = False
    ) -> "SurfaceError":
        """Distance of every ray end of a machined stock from the ideal surface.

        Args:
            machined: The stock as it was cut.
            ideal: The stock as it should be, for example cut by the desired path, or
                from a mesh of the part; its grid may be another one.
            leaves_out_raw: True to leave out points that no tool cut, and that the
                ideal stock has too.

        Returns:
            One row for each end of each ray of all three families, but for rays that
            lie in a wall of the ideal stock; none if the machined stock holds no
            material. Against planes the distance is exact to rounding.
            Where the ideal surface is curved with radius r, its mesh is off by up to
            about 0.4 spacing^2 / r, and along sharp edges oblique to all axes by a part
            of the spacing.

        Raises:
            ValueError: The ideal stock has no material.
        """
        (error,) = SurfaceError.of_stocks(
            [machined], ideal, leaves_out_raw=leaves_out_raw
        )
        return error

    @staticmethod
    def of_stocks(
        machined: Sequence[Stock], ideal: Stock, *, leaves_out_raw: bool = False
    ) -> "list[SurfaceError]":
        """Surface errors of some stocks against one ideal, meshed once.

        Args:
            machined: The stocks as they were cut.
            ideal: The stock as it should be, see `of_stock`.
            leaves_out_raw: True to leave out points that no tool cut, and that the
                ideal stock has too.

        Raises:
            ValueError: The ideal stock has no material.
        """
        if not bool(ideal.volume() > 0):
            raise ValueError("Argument `ideal` must hold material, but is empty.")
        surface = _IdealSurface(ideal)
        clouds = [surface.cloud(stock, leaves_out_raw) for stock in machined]
        return surface.errors(clouds)

    @property
    def area_share(self) -> Float[np.ndarray, " n"]:
        """Share of the surface that each point represents [-], shape (n,).

        A plane is met by |n_x| + |n_y| + |n_z| rays per square of the spacing.
        """
        share = 1 / np.abs(self.normal).sum(axis=1)
        return share / share.sum()

    @property
    def is_across(self) -> Bool[np.ndarray, " n"]:
        """True if a ray meets the face at its end from the front, shape (n,).

        Upright rays measure floors, lying ones walls. Beside a wall that stands out a
        lying ray ends near the floor, but does not measure it.
        """
        return (self.family == 2) == self.is_floor

    @property
    def deepest_at(self) -> Float[np.ndarray, " 3"]:
        """Place of the deepest cut into the part [m], shape (3,).

        NaN where it did not cut into it.
        """
        error = np.where(self.is_cut, self.error, 0)
        if not error.min(initial=0.0) < 0:
            return np.full(3, np.nan)
        return np.asarray(self.points[np.argmin(error)], np.float64)

    def measures(self) -> SurfaceMeasures:
        """Figures of the points that a tool cut."""
        error = self.error[self.is_cut]
        wall, floor = (
            self.error[self.is_cut & self.is_across & kind]
            for kind in (~self.is_floor, self.is_floor)
        )
        return SurfaceMeasures(
            wall_mean=_mean(wall),
            wall_rms=math.sqrt(_mean(wall**2)),
            wall_p95=_p95(wall),
            floor_mean=_mean(floor),
            floor_rms=math.sqrt(_mean(floor**2)),
            floor_p95=_p95(floor),
            deepest=float(max(0.0, -error.min(initial=0.0))),
        )


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else math.nan


def _p95(values: np.ndarray) -> float:
    return float(np.percentile(np.abs(values), 95)) if values.size else math.nan


class _Cloud(NamedTuple):
    """Ends of the rays of a machined stock.

    Attributes:
        points: The ends [m], shape (end, 3).
        is_cut: True if a tool cut the end, shape (end,).
        family: Axis of its ray, shape (end,).
        bound: Distance to the nearest end of the ideal stock [m], shape (end,).
    """

    points: Float[np.ndarray, "end 3"]
    is_cut: Bool[np.ndarray, " end"]
    family: Int[np.ndarray, " end"]
    bound: Float[np.ndarray, " end"]

    def where(self, counts: Bool[np.ndarray, " end"]) -> "_Cloud":
        """Those of the ends that count."""
        return _Cloud(*(rows[counts] for rows in self))


class _IdealSurface:
    """Surface of the stock that others are compared with.

    Its mesh takes some hundred times the memory of its rays: it is made of one slab of
    the stock after the other, each with as much around it as its points are away.
    """

    def __init__(self, ideal: Stock):
        from scipy.spatial import KDTree

        self._ends = KDTree(
            np.concatenate([ideal.ray_ends(f).points for f in range(3)])
        )
        self._ideal = ideal
        self._origin = np.asarray(ideal.origin, np.float64)
        self._rays = [np.asarray(rays.ends) for rays in ideal.families]
        self._spacing = float(ideal.spacing)

    def cloud(self, machined: Stock, leaves_out_raw: bool) -> _Cloud:
        """Ends of the rays of a stock that are compared."""
        families = [machined.ray_ends(f) for f in range(3)]
        points = np.concatenate([ends.points for ends in families])
        is_cut = np.concatenate([ends.is_cut for ends in families])
        family = np.repeat(np.arange(3), [len(ends.points) for ends in families])
        # A film thinner than the spacing, as a cut along the border leaves it, is lost
        # in the mesh; its ends still say where it is, which bounds the distance.
        bound = np.asarray(self._ends.query(points)[0], np.float64)
        cloud = _Cloud(points, is_cut, family, bound)
        if not leaves_out_raw:
            return cloud
        return cloud.where(is_cut | (bound > _SAME_SPACINGS * self._spacing))

    def errors(self, clouds: Sequence[_Cloud]) -> list[SurfaceError]:
        """Distances of points from the surface."""
        found = [(np.empty(len(x.bound)), np.empty_like(x.points)) for x in clouds]
        axis = int(np.argmax(self._ideal.grid_shape))
        lines = [
            (x.points[:, axis] - self._origin[axis]) / self._spacing for x in clouds
        ]
        for first, last in self._slabs(axis):
            parts = [(first <= x) & (x < last) for x in lines]
            near = [
                cloud.where(part) for cloud, part in zip(clouds, parts, strict=True)
            ]
            distances = self._distances(near, axis, first, last)
            for (error, normal), part, of_part in zip(
                found, parts, distances, strict=True
            ):
                error[part], normal[part] = of_part
        return [
            self._error(cloud, *rows) for cloud, rows in zip(clouds, found, strict=True)
        ]

    def _slabs(self, axis: int) -> list[tuple[float, float]]:
        """First and last grid line of each slab; the outermost have no end."""
        counts = self._ideal.grid_shape
        across = max(c for a, c in enumerate(counts) if a != axis)
        count = max(1, counts[axis] * across // _SLAB_LINES)
        inner = np.linspace(0, counts[axis], count + 1).round()[1:-1]
        return list(itertools.pairwise([-math.inf, *map(float, inner), math.inf]))

    def _distances(
        self, clouds: Sequence[_Cloud], axis: int, first: float, last: float
    ) -> list[tuple[Float[np.ndarray, " end"], Float[np.ndarray, "end 3"]]]:
        """Distances of points in a slab from the whole surface, and normals."""
        largest = lambda rows: max(np.abs(x).max(initial=0.0) for x in rows)
        if not sum(len(cloud.bound) for cloud in clouds):
            return [(cloud.bound, cloud.points) for cloud in clouds]
        reach = largest(cloud.bound for cloud in clouds) / self._spacing + 1
        while True:
            beside = reach + _BESIDE
            slab = _slab(self._ideal, axis, first - beside, last + beside)
            if slab is self._ideal or inside_nodes(slab).any():
                distance = slab.to_mesh().signed_distance()
                found = [distance(cloud.points) for cloud in clouds]
                # Faces of the slab itself are farther away than that.
                is_found = largest(error for error, _ in found) < reach * self._spacing
                if slab is self._ideal or is_found:
                    return found
            reach *= 2

    def _error(
        self,
        cloud: _Cloud,
        error: Float[np.ndarray, " end"],
        normal: Float[np.ndarray, "end 3"],
    ) -> SurfaceError:
        """Surface error, less that of ends that measure nothing."""
        error = np.copysign(np.minimum(np.abs(error), cloud.bound), error)
        counts = ~self._runs_along(cloud.points, cloud.family, error)
        cloud, error, normal = cloud.where(counts), error[counts], normal[counts]
        return SurfaceError(
            points=cloud.points,
            error=error,
            normal=normal,
            is_floor=np.abs(normal[:, 2]) > np.sqrt(0.5),
            is_cut=cloud.is_cut,
            family=cloud.family,
        )

    def _runs_along(
        self,
        points: Float[np.ndarray, "end 3"],
        family: Int[np.ndarray, " end"],
        error: Float[np.ndarray, " end"],
    ) -> Bool[np.ndarray, " end"]:
        """True for ends of rays that lie in a wall, and do not measure it.

        Such a ray is cut or not by chance, by nanometres, and the mesh has the wall on
        one side of it: its end is near the surface, but far from any end that the ideal
        stock has on that ray.
        """
        away = np.concatenate(
            [self._away_on_ray(points[family == f], f) for f in range(3)]
        )
        return (away > 2 * self._spacing) & (np.abs(error) < self._spacing)

    def _away_on_ray(
        self, points: Float[np.ndarray, "end 3"], family: int
    ) -> Float[np.ndarray, " end"]:
        """Distance of the ideal's nearest end on the same ray [m].

        Zero where it has none, and on another grid: nothing is known then.
        """
        rays = self._rays[family]
        place = ((points - self._origin) / self._spacing)[
            :, [(family + 1) % 3, (family + 2) % 3]
        ]
        line = np.rint(place).astype(np.int64)
        is_same = np.abs(place - line) < _SAME_SPACINGS
        is_same &= (line >= 0) & (line < rays.shape[:2])
        at = np.flatnonzero(is_same.all(axis=1))
        u, v = line[at].T
        ends = rays[u, v]
        off = np.abs(ends - points[at, family][:, None, None])
        off = np.where(ends[:, 1:] > ends[:, :1], off, np.inf).min(axis=(1, 2))
        away = np.zeros(len(points))
        away[at] = np.where(np.isfinite(off), off, 0)
        return away


def _slab(stock: Stock, axis: int, first: float, last: float) -> Stock:
    """Part of a stock between two of the grid lines of an axis; all of it as it is."""
    count = stock.grid_shape[axis]
    start, stop = (int(np.clip(x, 0, count)) for x in (first, last))
    if stop - start == count:
        return stock
    origin = np.array(stock.origin)
    low, high = origin[axis] + stock.spacing * np.array([start, stop - 1])
    origin[axis] = low

    def cut(family: int, rays: Rays) -> Rays:
        ends, poses = np.asarray(rays.ends), np.asarray(rays.poses)
        if family == axis:
            # An interval outside ends where it begins, and is none.
            return Rays(on_device(np.clip(ends, low, high)), rays.poses)
        part = [slice(None), slice(None)]
        part[(axis - family - 1) % 3] = slice(start, stop)
        return Rays(on_device(ends[tuple(part)]), on_device(poses[tuple(part)]))

    x, y, z = (cut(family, rays) for family, rays in enumerate(stock.families))
    return dataclasses.replace(stock, families=(x, y, z), origin=on_device(origin))
