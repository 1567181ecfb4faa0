"""The machined surface, differentiable, for a flat tool along +z.

The rigid tool leaves a stock whose ray ends are points on the surface as it should be:
walls, which the side of the tool cut, and floors, which its bottom cut. At such a point
the machined surface is the deepest of the surfaces that all passes leave there:

    wall:   min over k of  n.(a_k - p) - sqrt(R^2 - (t.(a_k - p))^2)
    floor:  min over k of  a_kz - p_z

with a_k the actual tips when they cut the point, p the point, n its normal out of the
material and t across it; of a floor those tips count whose bottom covers the point.
The passes that may be the deepest are listed once from the desired path, so that
an evaluation is a gather and a minimum. Unlike the tip's deviation it sees that a pass
is cut again by a later one, and which of two neighbouring poses decides.
"""

import dataclasses
from types import ModuleType
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._types import FloatRows3, RealScalarLike
from ...workpiece import Rays, Stock

# Where a pose does not reach a point, it leaves material this far out [m].
_OUT_OF_REACH = 1.0
# Points of a kind, and pairs of a point and a pose, at most; further points are left
# out evenly.
_MAX_POINTS, _MAX_PAIRS = 2000, 2_000_000
# Slope of the material that a bottom leaves over the distance of a point from its rim.
# It leaves all there, but so a pose that ends a little short has a slope back to it.
_RIM_SLOPE = 10.0
# Poses that differ by less leave a point together [m].
SAME_DEPTH = 1e-6
# A pose that is no further out of a point could spoil it [m].
_TOUCHING_DEPTH = 1e-4


class CutInstants(eqx.Module):
    """When the poses over the points of a surface cut them.

    The deviation of a row is taken at the instant at which a tooth looks at a right
    angle to the feed. Around a corner the tool cuts in other directions too, and on a
    helix higher points are cut later. Between rows the deviation is taken as linear:
    what vibrates within a period is not seen.

    Attributes:
        late: How much later than its row's deviation a pose cuts the point, over the
            time from row to row, shape (point, pose).
        ahead: From the row to where the path is then [m], less what the slope of the
            rows takes for it, shape (point, pose, 3).
    """

    late: Float[np.ndarray, "point pose"] | Float[Array, "point pose"]
    ahead: Float[np.ndarray, "point pose 3"] | Float[Array, "point pose 3"]

    @classmethod
    def of(
        cls,
        cut_by: Float[np.ndarray, " point"],
        poses: Int[np.ndarray, "point pose"],
        desired: Float[np.ndarray, "step 3"],
        shares: Float[np.ndarray, " step"],
    ) -> "CutInstants":
        """Instants of points that were cut at some times.

        Args:
            cut_by: When the points were cut [tooth period], shape (point,); NaN where a
                pose cuts at the instant of its row.
            poses: Rows of the poses over them, shape (point, pose).
            desired: The path [m], shape (step, 3).
            shares: When in its period each row's deviation is taken, shape (step,).
        """
        # The instant in a period is that of the rigid cut: teeth come again.
        phase = (cut_by - np.ceil(cut_by) + 1)[:, None]
        own = np.isnan(phase)
        # Slopes are taken by rows, whose instants are not a period apart where the
        # feed turns.
        apart = np.gradient(np.arange(len(shares)) + shares)
        late = np.where(own, 0.0, (phase - shares[poses]) / apart[poses])
        back = np.where(own, 0.0, phase - 1)[..., None]
        step = np.diff(desired, axis=0, prepend=desired[:1])
        taken = late[..., None] * np.gradient(desired, axis=0)[poses]
        return cls(late, back * step[poses] - taken)


class FinishedSurface(eqx.Module):
    """Points of the ideal surface and the poses that may cut there.

    Attributes:
        points: Points p [m], shape (point, 3).
        normals: Unit normals n out of the material, shape (point, 3).
        is_wall: Whether the point is on a wall, else on a floor, shape (point,).
        poses: Rows of the path that may be the deepest; a row may stand more than
            once, shape (point, pose).
        radius: Radius of the tool R [m].
        instants: When the poses cut; with their rows if None.
    """

    points: Float[np.ndarray, "point 3"] | Float[Array, "point 3"]
    normals: Float[np.ndarray, "point 3"] | Float[Array, "point 3"]
    is_wall: Bool[np.ndarray, " point"] | Bool[Array, " point"]
    poses: Int[np.ndarray, "point pose"] | Int[Array, "point pose"]
    radius: RealScalarLike
    instants: CutInstants | None = None

    def errors(self, actual: FloatRows3) -> Float[Array, " point"]:
        """Errors of the machined surface along the normals [m], shape (point,).

        Positive where material was left, negative where too much was cut.

        Args:
            actual: Actual tips [m], shape (step, 3).

        **Differentiability**: kink where another pose becomes the deepest.
        """
        # The choice is held fixed: `min` would share a tie's derivative among all.
        best = jnp.argmin(self.depths(jax.lax.stop_gradient(actual)), axis=1)
        return self._depths(actual, best[:, None])[:, 0]

    def depths(self, actual: FloatRows3) -> Float[Array, "point pose"]:
        """Distances out of the ideal surface at which poses cut [m], (point, pose).

        Args:
            actual: Actual tips [m], shape (step, 3).

        **Differentiability**: smooth where the pose cuts.
        """
        return self._depths(actual)

    def host_depths(self, desired: FloatRows3) -> Float[np.ndarray, "point pose"]:
        """Distances of `depths` as NumPy arrays [m], shape (point, pose)."""
        return _depths(np, self, np.asarray(desired, np.float64))

    @eqx.filter_jit
    def _depths(
        self, actual: FloatRows3, chosen: Int[Array, "point some"] | None = None
    ) -> Float[Array, "point some"]:
        """Distances of chosen poses [m], shape (point, some), by a compiled program."""
        return _depths(jnp, self, jnp.asarray(actual), chosen)

    @classmethod
    def from_cut(
        cls,
        stock: Stock,
        desired: FloatRows3,
        radius: float,
        *,
        reach: float = 5e-4,
        shares: Float[np.ndarray, " step"] | None = None,
    ) -> "FinishedSurface":
        """Surface that a rigid flat tool along +z leaves.

        At most 2000 points of walls and of floors each.

        Args:
            stock: The stock after the rigid cut; its ends know the poses that cut them.
            desired: The path of that cut [m], shape (step, 3).
            radius: Radius of the tool [m].
            reach: A pose may decide a point if the desired one stays at most this far
                out of it [m]: twice the largest error that is to be seen right.
            shares: When in the tooth period before each row the actual tips are taken,
                see `Solution.wall_share`, shape (step,); None for tips at the rows.

        Raises:
            ValueError: No end was cut by a pose.

        **Differentiability**: none, a host function.
        """
        tips = np.asarray(desired, np.float64)
        walls = _wall_points(stock, tips, radius).decimated().settled(tips, radius)
        floors = _floor_points(stock, tips, radius, reach).decimated()
        # Poses that may cut each point deepest.
        poses = [
            [
                np.flatnonzero(wall_depths(p, n, tips, radius) < reach)
                for p, n in zip(walls.points, walls.normals, strict=True)
            ],
            _floor_poses(floors.points, tips, radius, reach),
        ]
        is_seen = [np.array([rows.size > 0 for rows in kind], bool) for kind in poses]
        if not any(seen.any() for seen in is_seen):
            raise ValueError(
                "Argument `stock` must have been cut by a pose, but was not."
            )
        width = max(rows.size for kind in poses for rows in kind)
        chosen = [
            _evenly_chosen(np.flatnonzero(seen), _MAX_PAIRS // (2 * width))
            for seen in is_seen
        ]
        walls, floors = walls.subset(chosen[0]), floors.subset(chosen[1])
        # Rows of one width, each pose about as often as the others, in their order.
        rows = np.stack(
            [
                kind[i][np.arange(width) * kind[i].size // width].astype(np.int32)
                for kind, some in zip(poses, chosen, strict=True)
                for i in some
            ]
        )
        instants = None
        if shares is not None:
            cut_by = np.concatenate([walls.cut_by, floors.cut_by])
            instants = CutInstants.of(cut_by, rows, tips, np.asarray(shares))
        return cls(
            points=np.concatenate([walls.points, floors.points]),
            normals=np.concatenate([walls.normals, floors.normals]),
            is_wall=np.repeat([True, False], [chosen[0].size, chosen[1].size]),
            poses=rows,
            radius=np.asarray(radius, np.float64),
            instants=instants,
        )

    def host_slopes(self, actual: FloatRows3) -> Float[np.ndarray, "3 point pose"]:
        """Derivatives of `depths` by the axes of the poses' tips, (3, point, pose).

        That the tips beside tell where a tip is at another instant than its row's is
        left out.

        Args:
            actual: Actual tips [m], shape (step, 3).

        **Differentiability**: none, a host function.
        """
        apart = _apart(np, self, np.asarray(actual, np.float64))
        n = np.asarray(self.normals)[:, None]
        across = apart[..., 1] * n[..., 0] - apart[..., 0] * n[..., 1]
        R = float(self.radius)
        is_under = R**2 - across**2 > (0.01 * R) ** 2
        lean = across / np.sqrt(np.where(is_under, R**2 - across**2, 1.0))
        is_wall = np.asarray(self.is_wall)[:, None]
        off = np.linalg.norm(apart[..., :2], axis=2)
        rim = np.where(off > R, _RIM_SLOPE / np.maximum(off, R), 0.0)
        across_wall = (n[..., 0] - lean * n[..., 1], n[..., 1] + lean * n[..., 0])
        slopes = [
            np.where(is_wall, is_under * side, rim * apart[..., axis])
            for axis, side in enumerate(across_wall)
        ]
        return np.stack([*slopes, np.where(is_wall, 0.0, np.ones_like(off))])

    def point_shares(
        self,
        desired: FloatRows3,
        weights: Float[np.ndarray, " step"],
    ) -> Float[np.ndarray, " point"]:
        """Weights of the points, from those of the rows that leave them, (point,).

        The largest weight of the rows that are the deepest at the point on the desired
        path, to a micrometre.

        Args:
            desired: The desired path [m], shape (step, 3).
            weights: Weight of every row, shape (step,).

        **Differentiability**: none, a host function.
        """
        depth = self.host_depths(desired)
        is_deepest = depth <= depth.min(axis=1, keepdims=True) + SAME_DEPTH
        each = np.asarray(weights, np.float64)[np.asarray(self.poses)]
        return np.max(np.where(is_deepest, each, 0.0), axis=1)

    def touching_rows(self, desired: FloatRows3) -> Bool[np.ndarray, " step"]:
        """True at rows that come so near to the surface that they could spoil it.

        At most 0.1 mm out of a point. More rows than those that cut: also those that
        pass over what has been cut before.

        Args:
            desired: The desired path [m], shape (step, 3).

        **Differentiability**: none, a host function.
        """
        is_near = self.host_depths(desired) <= _TOUCHING_DEPTH
        touches = np.zeros(len(np.asarray(desired)), bool)
        touches[np.unique(np.asarray(self.poses)[is_near])] = True
        return touches


def _apart(
    xp: ModuleType, surface: FinishedSurface, tips: Any, chosen: Any = None
) -> Any:
    """Vectors from points to poses that cut them, all or chosen ones [m]."""
    poses, instants = xp.asarray(surface.poses), surface.instants
    rows = poses if chosen is None else xp.take_along_axis(poses, chosen, axis=1)
    places = tips[rows]
    if instants is not None:
        late, ahead = (
            xp.asarray(x, tips.dtype) for x in (instants.late, instants.ahead)
        )
        if chosen is not None:
            index = (xp.arange(len(chosen))[:, None], chosen)
            late, ahead = late[index], ahead[index]
        places = places + late[..., None] * xp.gradient(tips, axis=0)[rows] + ahead
    return places - xp.asarray(surface.points, tips.dtype)[:, None]


def _depths(
    xp: ModuleType, surface: FinishedSurface, tips: Any, chosen: Any = None
) -> Any:
    """Distances out of a surface at which poses cut [m], in NumPy or JAX.

    On the host a program would serve one number of points alone.
    """
    n = xp.asarray(surface.normals, tips.dtype)
    apart = _apart(xp, surface, tips, chosen)
    out = xp.sum(apart * n[:, None], axis=2)
    across = apart[..., 1] * n[:, None, 0] - apart[..., 0] * n[:, None, 1]
    R, far = (xp.asarray(x, tips.dtype) for x in (surface.radius, _OUT_OF_REACH))
    square = R**2 - across**2
    is_under = square > (0.01 * R) ** 2
    wall = out - xp.sqrt(xp.where(is_under, square, 1.0))
    wall = xp.where(is_under, wall, far)
    beside = apart[..., 0] ** 2 + apart[..., 1] ** 2
    is_beside = beside > R**2
    beside = xp.sqrt(xp.where(is_beside, beside, R**2)) - R
    floor = out + xp.asarray(_RIM_SLOPE, tips.dtype) * beside
    return xp.where(xp.asarray(surface.is_wall)[:, None], wall, floor)


def _surface_ends(
    stock: Stock, family: int, sides: tuple[int, ...]
) -> tuple[Float[np.ndarray, "end 3"], Float[np.ndarray, " end"]]:
    """Ends of a family that a pose cut, and upright ones from before.

    Returns:
        Places of the ends [m], shape (end, 3), and times of their cut [tooth period],
        shape (end,); negative for those that were there before.
    """
    rays = stock.families[family]
    ends, cut_by = np.asarray(rays.ends, np.float64), np.asarray(rays.poses)
    is_kept = (cut_by >= 0) | (family == 2)
    is_kept &= (ends[:, :, 1] > ends[:, :, 0])[:, :, None]
    is_kept &= np.isin(np.arange(2), sides)[None, None, :, None]
    u, v, side, slot = np.nonzero(is_kept)
    points = np.empty((len(u), 3))
    origin = np.asarray(stock.origin, np.float64)
    points[:, family] = ends[u, v, side, slot]
    for axis, line in (((family + 1) % 3, u), ((family + 2) % 3, v)):
        points[:, axis] = origin[axis] + line * stock.spacing
    return points, cut_by[u, v, side, slot] / Rays.TICKS


class _SurfacePoints(eqx.Module):
    """Points of a surface.

    Attributes:
        points: Places [m], shape (point, 3).
        normals: Unit normals, shape (point, 3).
        cut_by: Times of their cut [tooth period], shape (point,); NaN where that makes
            no difference.
        rise: Height above them that may be surface too [m], shape (point,).
    """

    points: Float[np.ndarray, "point 3"]
    normals: Float[np.ndarray, "point 3"]
    cut_by: Float[np.ndarray, " point"]
    rise: Float[np.ndarray, " point"]

    def decimated(self) -> "_SurfacePoints":
        """As many of the points as a surface has of a kind."""
        return self.subset(_evenly_chosen(np.arange(len(self.points)), _MAX_POINTS))

    def subset(self, chosen: Int[np.ndarray, " chosen"]) -> "_SurfacePoints":
        """Some of the points."""
        return jax.tree.map(lambda x: x[chosen], self)

    def settled(
        self, tips: Float[np.ndarray, "step 3"], radius: float
    ) -> "_SurfacePoints":
        """Points risen, but for those over which the desired path cuts."""
        risen = self.points.copy()
        for p, n, rise in zip(risen, self.normals, self.rise, strict=True):
            p[2] += rise
            if np.any(wall_depths(p, n, tips, radius) < -_TOUCHING_DEPTH):
                p[2] -= rise
        return dataclasses.replace(self, points=risen)


def _wall_points(
    stock: Stock, tips: Float[np.ndarray, "step 3"], radius: float
) -> _SurfacePoints:
    """Points that the tool's side cut.

    Of points above each other on a wall an upright tool leaves the highest the deepest
    cut, by all passes, and the lowest the least, by those that go down to it: the two
    stand for all. The lowest is half a spacing above the tip, so that a tip that lifts
    still cuts it.
    """
    ends = [_surface_ends(stock, family, (0, 1)) for family in (0, 1)]
    points, cut_by = (np.concatenate(each) for each in zip(*ends, strict=True))
    rows = np.arange(len(tips))
    cutting = np.stack([np.interp(cut_by, rows, tips[:, i]) for i in range(3)], axis=1)
    normals = (cutting - points) / radius
    above = points[:, 2] - cutting[:, 2]
    normals[:, 2] = 0.0
    length = np.linalg.norm(normals, axis=1)
    # Points that the rim of the bottom cut have no wall's normal.
    is_side = (np.abs(length - 1) < 1e-3) & (above > 0.5 * stock.spacing)
    points, normals = points[is_side], normals[is_side] / length[is_side, None]
    cut_by = cut_by[is_side]
    order = np.argsort(points[:, 2], kind="stable")
    key = np.round(points[order, :2] / (1e-3 * stock.spacing))
    _, lowest = np.unique(key, axis=0, return_index=True)
    _, highest = np.unique(key[::-1], axis=0, return_index=True)
    both = order[np.concatenate([lowest, len(order) - 1 - highest])]
    # A wall ends between its highest ray and the next.
    rise = np.repeat([0.0, 0.5 * stock.spacing], [len(lowest), len(highest)])
    return _SurfacePoints(points[both], normals[both], cut_by[both], rise)


def _floor_points(
    stock: Stock, tips: Float[np.ndarray, "step 3"], radius: float, reach: float
) -> _SurfacePoints:
    """Points that the tool's bottom cut, or could cut.

    The surface that an earlier job has left counts, too, where the tool passes over it.
    """
    from scipy.spatial import KDTree

    points, cut_by = _surface_ends(stock, 2, (1,))
    # A reach above a point is as far as a radius beside it.
    scale = np.array([1.0, 1.0, radius / reach])
    near, _ = KDTree(tips * scale).query(points * scale, distance_upper_bound=radius)
    points = points[(cut_by >= 0) | np.isfinite(near)]
    upward = np.tile(np.array([0.0, 0.0, 1.0]), (len(points), 1))
    # The bottom is as deep at any instant, but for what lifts in a period.
    any_time = np.full(len(points), np.nan)
    return _SurfacePoints(points, upward, any_time, np.zeros(len(points)))


def _evenly_chosen(
    places: Int[np.ndarray, " many"], most: int
) -> Int[np.ndarray, " few"]:
    """Evenly chosen places, at most so many and at least one."""
    if len(places) <= most:
        return places
    return places[np.linspace(0, len(places) - 1, max(1, most)).astype(int)]


def wall_depths(
    p: Float[np.ndarray, " 3"],
    n: Float[np.ndarray, " 3"],
    tips: Float[np.ndarray, "step 3"],
    radius: float,
) -> Float[np.ndarray, " step"]:
    """Distance out of a wall point at which each pose cuts [m], infinite if it cannot.

    Args:
        p: The point [m].
        n: Unit normal of the wall there.
        tips: Tips of the poses [m], shape (step, 3).
        radius: Radius of the tool [m].
    """
    apart = tips - p
    out = apart @ n
    across = apart[:, 1] * n[0] - apart[:, 0] * n[1]
    square = radius**2 - across**2
    # A tool behind the wall cuts another one.
    is_near = (square > (0.1 * radius) ** 2) & (tips[:, 2] < p[2]) & (out > 0)
    return np.where(is_near, out - np.sqrt(np.clip(square, 0, None)), np.inf)


def _floor_poses(
    points: Float[np.ndarray, "point 3"],
    tips: Float[np.ndarray, "step 3"],
    radius: float,
    reach: float,
) -> list[Int[np.ndarray, " pose"]]:
    """Poses whose bottom covers each point or may, if one is sure to.

    A pose that stands beside a point and would reach far below it cuts a deeper step:
    its wall there is another point.
    """
    poses = []
    for p in points:
        off = np.hypot(tips[:, 0] - p[0], tips[:, 1] - p[1])
        up = tips[:, 2] - p[2]
        is_sure = np.any((up < reach) & (off < radius - reach))
        may = (off < radius) | (up + _RIM_SLOPE * (off - radius) > -SAME_DEPTH)
        poses.append(
            np.flatnonzero(is_sure & may & (up < reach) & (off < radius + reach))
        )
    return poses
