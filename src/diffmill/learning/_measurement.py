"""What was measured of a part: tip, joints and forces on its way, points of walls."""

import abc
import dataclasses
from collections.abc import Sequence
from typing import ClassVar, Literal, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from .._job import Job
from .._types import FloatRows, FloatRows3, FloatSteps, RealScalarLike
from ..robot import forward_kinematics, jacobian
from ..sim import Solution

Values = Float[np.ndarray, " observation"]
Observed: TypeAlias = Literal["tip", "wall", "arm", "force"]
# No instrument is better [m].
_LEAST_NOISE = 1e-8
# Spacings of points, in time, within which a row cuts the wall that they lie on.
_WALL_SPACINGS = 3.0
# A sample at the end of a period belongs to it [s].
_ROUNDING = 1e-9


class Observables(NamedTuple):
    """Quantities that can be seen of a run, at its rows.

    Attributes:
        tip: Deviation of the tip at the wall instants [m], shape (step, 3, ...).
        wall: The same with the wall that the cutter makes: where its radius is off the
            tip stands in for it, farther along the normal.
        arm: That of the tip as encoders on the links see it: the work where it was
            before anything was learnt, and without what errors of links leave.
        force: Mean force on the tool over the period before [N], same shape.
    """

    tip: Float[np.ndarray, "step 3 *more"]
    wall: Float[np.ndarray, "step 3 *more"]
    arm: Float[np.ndarray, "step 3 *more"]
    force: Float[np.ndarray, "step 3 *more"]


class Seen(eqx.Module):
    """Scalar observations of one of the observables of a run.

    Observation i sees d_i . ((1 - a_i) e[k_i] + a_i e[k_i + 1]), e the observable.

    Attributes:
        observed: Which observable e is.
        time: When, along the path [s], shape (observation,).
        row: k, shape (observation,).
        share: a, shape (observation,).
        direction: d, unit vectors, shape (observation, 3).
        variance: Of the instrument's noise [m^2 or N^2], shape (observation,).
        value: What was seen [m or N], shape (observation,).
        nuisance: Slopes in what the set-up of the measurement leaves open, in units of
            its priors, shape (observation, nuisance).
        is_tracked: Whether all axes are seen in each row, so that each may have a
            process of its own.
    """

    observed: Observed = eqx.field(static=True)
    time: Values
    row: Int[np.ndarray, " observation"]
    share: Values
    direction: Float[np.ndarray, "observation 3"]
    variance: Values
    value: Values
    nuisance: Float[np.ndarray, "observation nuisance"]
    is_tracked: bool = eqx.field(static=True)

    def of(self, run: Observables) -> np.ndarray:
        """Observations of a run, or of its slopes, shape (observation, ...)."""
        rows = getattr(run, self.observed)
        lower, upper = rows[self.row], rows[np.minimum(self.row + 1, len(rows) - 1)]
        share = self.share.reshape(-1, *[1] * (rows.ndim - 1))
        between = (1 - share) * lower + share * upper
        return np.einsum("ia,ia...->i...", self.direction, between)


class AbstractMeasurement(eqx.Module):
    """A measurement of a part that was cut.

    Attributes:
        sees_motion: Whether it sees the tip or the joints on their way, in all axes.
    """

    sees_motion: eqx.AbstractClassVar[bool]

    @abc.abstractmethod
    def seen(self, job: Job, rigid: Solution) -> Seen:
        """Scalar observations of the tip's deviation.

        Args:
            job: The job that was cut.
            rigid: Solution of its program.
        """


def wall_times(rigid: Solution) -> Values:
    """Instants at which the walls of the rows are made [s], shape (step,)."""
    time = np.asarray(rigid.time, np.float64)
    period = time[1] - time[0]
    return time + period * (np.asarray(rigid.wall_share, np.float64) - 1)


class TrackedTips(AbstractMeasurement):
    """The tip over time, as a tracker sees it.

    Attributes:
        tips: Tips in `work` [m], shape (sample, 3); without times one for each row: the
            desired tip with the deviation that was measured when its wall was made, as
            `Solution.desired + Solution.surface_deviation`.
        time: Since the program began [s], shape (sample,); None for a tip for each row.
        noise: Standard deviation of each coordinate [m].
        offset: That of where the tracker takes the work to be, along each axis [m].
        turn: That of how it takes it to be turned, about each axis [rad].
        delay: That of its clock against the program's [s].
    """

    sees_motion: ClassVar[bool] = True
    tips: FloatRows3
    noise: RealScalarLike
    time: FloatSteps | None = None
    offset: RealScalarLike = 0.0
    turn: RealScalarLike = 0.0
    delay: RealScalarLike = 0.0

    def seen(self, job: Job, rigid: Solution) -> Seen:
        """Scalar observations, three for each sample within the program."""
        instants = wall_times(rigid)
        desired = np.asarray(rigid.desired, np.float64)
        program = np.asarray(rigid.time, np.float64)
        tips = np.asarray(self.tips, np.float64)
        at = lambda t, rows: np.stack(
            [np.interp(t, program, rows[:, a]) for a in range(3)], axis=1
        )
        if self.time is None:
            if tips.shape != desired.shape:
                raise ValueError(
                    f"Argument `tips` must have shape {desired.shape}, a row for each "
                    f"of the path's, or a `time`, but has {tips.shape}."
                )
            time, away = instants, tips - desired
            row, share = np.arange(len(tips)), np.zeros(len(tips))
        else:
            time = np.asarray(self.time, np.float64)
            if tips.shape != (len(time), 3) or not np.all(np.diff(time) > 0):
                raise ValueError(
                    "Arguments `time` and `tips` must have the same rows, in the order "
                    f"of time, but have shapes {time.shape} and {tips.shape}."
                )
            # Before the first wall and after the last nothing is predicted.
            inside = (time >= instants[1]) & (time <= instants[-1])
            time, away = time[inside], tips[inside] - at(time[inside], desired)
            row = np.clip(np.searchsorted(instants, time) - 1, 0, len(instants) - 2)
            share = (time - instants[row]) / (instants[row + 1] - instants[row])
        place = at(time, desired)
        velocity = at(time, np.gradient(desired, program, axis=0))
        count = len(time)
        arm = place - place.mean(axis=0)
        nuisance = np.zeros((count, 3, 7))
        for a in range(3):
            nuisance[:, a, a] = float(self.offset)
            axis = np.eye(3)[a]
            nuisance[:, :, 3 + a] = float(self.turn) * np.cross(axis, arm)
        nuisance[:, :, 6] = float(self.delay) * velocity
        used = nuisance.any(axis=(0, 1))
        return Seen(
            observed="tip",
            time=np.repeat(time, 3),
            row=np.repeat(row, 3),
            share=np.repeat(share, 3),
            direction=np.tile(np.eye(3), (count, 1)),
            variance=np.full(3 * count, float(self.noise) ** 2),
            value=away.reshape(-1),
            nuisance=nuisance.reshape(3 * count, 7)[:, used],
            is_tracked=True,
        )


class LinkEncoders(AbstractMeasurement):
    """Joints over time, by encoders on the links, behind the gears.

    Encoders on the motors do not see what springs and gaps do: `identify` with
    `kind = "controller"` or "reversal" takes their records.

    Attributes:
        joints: Joint positions [rad or m], shape (sample, joint).
        noise: Standard deviation of each [rad or m].
        time: Since the program began [s], shape (sample,).
        offset: That of the zero of each encoder [rad or m].
        delay: That of their clock against the program's [s].
    """

    sees_motion: ClassVar[bool] = True
    joints: FloatRows
    noise: RealScalarLike
    time: FloatSteps
    offset: RealScalarLike = 0.0
    delay: RealScalarLike = 0.0

    def seen(self, job: Job, rigid: Solution) -> Seen:
        """Three scalar observations for each sample: of the tip as the joints place it.

        Raises:
            ValueError: The record has another number of joints, or its rows are not in
                the order of time.
        """
        robot = job.robot
        q = np.asarray(self.joints, np.float64)
        if robot is None or q.ndim != 2 or q.shape[1] != robot.joint_count:
            count = 0 if robot is None else robot.joint_count
            raise ValueError(
                f"Argument `joints` must have {count} columns, one for each joint, but "
                f"has shape {q.shape}."
            )
        T = np.asarray(job.T_base_work, np.float64)
        tips = np.asarray(jax.vmap(lambda q: forward_kinematics(robot, q)[:3, 3])(q))
        tips = (tips - T[:3, 3]) @ T[:3, :3]
        # As a tracker that would see each coordinate to one metre.
        tracked = TrackedTips(tips, 1.0, self.time, delay=self.delay)
        seen = tracked.seen(job, rigid)
        count = len(seen.time) // 3
        own = np.asarray(self.time, np.float64)
        inside = np.searchsorted(own, seen.time[::3])
        J = np.asarray(jax.vmap(lambda q: jacobian(robot, q)[:3])(q[inside]))
        J = np.einsum("ba,kbj->kaj", T[:3, :3], J)
        variance, axes = np.linalg.eigh(
            float(self.noise) ** 2 * np.einsum("kaj,kbj->kab", J, J)
        )
        # Along these directions the noise of the encoders is not correlated.
        direction = np.swapaxes(axes, 1, 2)
        turned = lambda rows: np.einsum(
            "kia,ka...->ki...", direction, rows.reshape(count, 3, *rows.shape[1:])
        ).reshape(rows.shape)
        zeros = float(self.offset) * np.einsum("kia,kaj->kij", direction, J)
        nuisance = np.concatenate(
            [turned(seen.nuisance), zeros.reshape(3 * count, -1)], axis=1
        )
        return dataclasses.replace(
            seen,
            observed="arm",
            direction=direction.reshape(-1, 3),
            # A pose in which no joint moves the tip along a direction tells nothing.
            variance=np.maximum(variance.reshape(-1), _LEAST_NOISE**2),
            value=turned(seen.value),
            nuisance=nuisance[:, nuisance.any(axis=0)],
            is_tracked=False,
        )


class MeasuredForces(AbstractMeasurement):
    """Forces on the tool over time, by a dynamometer or a sensor in the flange.

    Attributes:
        force: Forces on the tool, along the axes of `work` [N], shape (sample, 3).
        noise: Standard deviation of each sample [N].
        time: Since the program began [s], shape (sample,).
        offset: That of each axis of the instrument [N].
    """

    sees_motion: ClassVar[bool] = False
    force: FloatRows3
    noise: RealScalarLike
    time: FloatSteps
    offset: RealScalarLike = 0.0

    def seen(self, job: Job, rigid: Solution) -> Seen:
        """Three scalar observations for each tooth period that has a sample.

        Raises:
            ValueError: The rows are not in the order of time, or none is within the
                program.
        """
        time, force = np.asarray(self.time, np.float64), np.asarray(self.force)
        if force.shape != (len(time), 3) or not np.all(np.diff(time) > 0):
            raise ValueError(
                "Arguments `time` and `force` must have the same rows, in the order of "
                f"time, but have shapes {time.shape} and {force.shape}."
            )
        ends = np.asarray(rigid.time, np.float64)
        row = np.searchsorted(ends, time - _ROUNDING)
        inside = (row > 0) & (row < len(ends))
        if not inside.any():
            raise ValueError(
                f"Argument `time` must have instants within the program's "
                f"{ends[-1]:.3g} s, but ends at {time[-1]:.3g} s."
            )
        row, counts = np.unique(row[inside], return_counts=True)
        first = np.r_[0, np.cumsum(counts)[:-1]]
        mean = np.add.reduceat(force[inside], first, axis=0) / counts[:, None]
        count = len(row)
        nuisance = float(self.offset) * np.tile(np.eye(3), (count, 1))
        has_offset = float(self.offset) > 0
        return Seen(
            observed="force",
            time=np.repeat(ends[row], 3),
            row=np.repeat(row, 3),
            share=np.zeros(3 * count),
            direction=np.tile(np.eye(3), (count, 1)),
            variance=np.repeat(float(self.noise) ** 2 / counts, 3),
            value=mean.reshape(-1),
            nuisance=nuisance[:, : 3 * has_offset],
            is_tracked=True,
        )


class WallPoints(AbstractMeasurement):
    """Points of a finished part with the normals of its walls and floors.

    A point has no time: its row is the one at which the tool, touching the ideal
    surface, is nearest to it.

    Attributes:
        points: Measured points in `work` [m], shape (point, 3).
        normals: Unit normals out of the material, shape (point, 3).
        noise: Standard deviation of each distance along the normal [m].
        offset: That of where the instrument takes the work to be, along each axis [m].
    """

    sees_motion: ClassVar[bool] = False
    points: FloatRows3
    normals: FloatRows3
    noise: RealScalarLike
    offset: RealScalarLike = 0.0

    def seen(self, job: Job, rigid: Solution) -> Seen:
        """One scalar observation for each point of a wall or floor.

        Raises:
            ValueError: The cutter is not flat or leans, nothing is cut, or a point lies
                beside what is cut.
        """
        if float(job.cutter.corner_radius) > 0 or job.simulation.axes:
            raise ValueError(
                "Argument `job` must have a flat cutter along +z for points of walls, "
                "which its axis passes at a radius, but has another one."
            )
        points = np.asarray(self.points, np.float64)
        normals = np.asarray(self.normals, np.float64)
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        desired = np.asarray(rigid.desired, np.float64)
        cuts = np.flatnonzero(np.asarray(rigid.is_cutting))
        segments = cuts[cuts + 1 < len(desired)]
        if not len(segments):
            raise ValueError("Argument `job` must have a program that cuts.")
        radius = float(job.cutter.nominal_radius)
        # The tip of a tool that touches the point: beside a wall, above a floor.
        side = normals.copy()
        side[:, 2] = 0.0
        length = np.linalg.norm(side, axis=1, keepdims=True)
        is_wall = length[:, 0] > 0.5
        tip = points + np.where(
            is_wall[:, None], radius * side / np.maximum(length, 1e-12), 0.0
        )
        start, way = desired[segments], desired[segments + 1] - desired[segments]
        square = np.maximum(np.sum(way**2, axis=1), 1e-30)
        rows, shares, values = [], [], []
        for k, p in enumerate(tip):
            # Along a wall the height does not tell the row, on a floor the place does.
            weight = np.array([1.0, 1.0, 0.0]) if is_wall[k] else np.ones(3)
            along = np.clip(np.sum((p - start) * way * weight, axis=1) / square, 0, 1)
            near = start + along[:, None] * way
            away = np.sum(((p - near) * weight) ** 2, axis=1)
            if is_wall[k]:
                # The pose that cut the point last reaches down to it.
                away = away + np.where(near[:, 2] > points[k, 2] + 1e-6, np.inf, 0.0)
            i = int(np.argmin(away))
            if not np.sqrt(away[i]) < radius:
                raise ValueError(
                    f"Argument `points` must lie on what the program cuts, but point "
                    f"{k} is {1e3 * np.sqrt(away[i]):.2f} mm beside it."
                )
            rows.append(segments[i])
            shares.append(along[i])
            values.append(np.dot(p - near[i], normals[k]))
        row, share = np.array(rows), np.array(shares)
        instants = wall_times(rigid)
        time = (1 - share) * instants[row] + share * instants[row + 1]
        order = np.argsort(time, kind="stable")
        has_offset = float(self.offset) > 0
        return Seen(
            observed="wall",
            time=time[order],
            row=row[order],
            share=share[order],
            direction=normals[order],
            variance=np.full(len(order), float(self.noise) ** 2),
            value=np.array(values)[order],
            nuisance=(float(self.offset) * normals[order])[:, : 3 * has_offset],
            is_tracked=False,
        )


def wall_normals(rigid: Solution, seen: Sequence[Seen]) -> FloatRows3:
    """Normals out of the walls that points were measured on, of each row.

    The side of the path on which a wall lies is that of the point which was cut nearest
    in time, its normal across the path.

    Args:
        rigid: Solution of the program.
        seen: What was seen, of points and of all else.

    Returns:
        Horizontal unit vectors, shape (step, 3); zero where nothing is cut, and far
        from all points.
    """
    desired = np.asarray(rigid.desired, np.float64)
    points = [one for one in seen if one.observed == "wall"]
    found = np.zeros_like(desired)
    if not points:
        return found
    time = np.concatenate([one.time for one in points])
    normal = np.concatenate([one.direction for one in points])
    is_wall = np.hypot(normal[:, 0], normal[:, 1]) > 0.5
    order = np.flatnonzero(is_wall)[np.argsort(time[is_wall], kind="stable")]
    time, normal = time[order], normal[order]
    way = np.gradient(desired[:, :2], axis=0)
    size = np.linalg.norm(way, axis=1)
    if len(time) < 2:
        return found
    instants = wall_times(rigid)
    last = np.clip(np.searchsorted(time, instants), 1, len(time) - 1)
    nearest = last - (instants - time[last - 1] < time[last] - instants)
    reach = _WALL_SPACINGS * float(np.median(np.diff(time)))
    is_near = np.abs(instants - time[nearest]) <= reach
    rows = np.flatnonzero(is_near & np.asarray(rigid.is_cutting) & (size > 1e-12))
    left = np.stack([-way[rows, 1], way[rows, 0]], axis=1) / size[rows, None]
    side = np.sign(np.sum(left * normal[nearest[rows], :2], axis=1))
    found[rows, :2] = side[:, None] * left
    return found


class Part(eqx.Module):
    """A part that was cut and measured.

    Attributes:
        commanded: Tips that were commanded [m], shape (step, 3).
        measured: What was measured of it, by one instrument or several.
    """

    commanded: FloatRows3
    measured: AbstractMeasurement | tuple[AbstractMeasurement, ...]

    @property
    def measurements(self) -> tuple[AbstractMeasurement, ...]:
        """Measurements by instrument."""
        own = self.measured
        return own if isinstance(own, tuple) else (own,)

    def __post_init__(self):
        object.__setattr__(self, "commanded", jnp.asarray(self.commanded))
