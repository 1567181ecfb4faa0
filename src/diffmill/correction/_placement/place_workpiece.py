"""Placement of the workpiece and rotation of the tool where the arm deflects least.

The best of a few spread-out places and the job's own are starts of bounded
Levenberg-Marquardt steps; joints stay within their ranges as constraints, and a place
that the arm cannot reach, or reaches nearly singular, is refused. The result is
then judged on the whole path.
"""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job
from ..._types import FloatRows3
from ...optimise import (
    AbstractProblem,
    LevenbergMarquardt,
    OutputConstraints,
    QuadraticModel,
    least_squares,
)
from ...process import FrozenStock
from ...sim import JobKinematics, rigid_cut
from .._job.correction_problem import NothingToCorrect
from .._spline.command_limits import InfeasibleLimit
from .objective import (
    UNKNOWNS,
    PlacementTask,
    least_singular_of,
    moved_work,
    path_tangents,
    placement_residual,
    turned_tool,
    whole_path,
)
from .result import Placement, rms_across

# Share of its range that a joint may use.
_JOINT_RANGE = 0.98
# A pose that is nearer to a singular one than this is refused, unless the job's own
# place is as near: for a wrist it is some 4 degrees from straight.
_LEAST_SINGULAR = 0.05
# A step that promises less of the square of the errors than this ends the descent.
_COST_RTOL = 1e-9
# An unknown this near to a bound stands there, as a share of its unit.
_AT_BOUND = 1e-3


def place_workpiece(
    job: Job,
    *,
    shift_bounds: Sequence[Sequence[float]],
    angle_bounds: Sequence[float] = (0.0, 0.0),
    rotation_bounds: Sequence[float] = (0.0, 0.0),
    rows: int = 64,
    starts: int = 32,
    max_steps: int = 20,
    force: FloatRows3 | None = None,
) -> Placement:
    """Place in the cell at which a part is cut with the least predicted deviation.

    What becomes small is the rms over the rows that cut of the deviation across the
    path, J K^-1 J^T F with the force of the rigid cut: springs only, and that the chip
    changes with the deviation is left out. Nothing is known of what stands around the
    arm.

    Args:
        job: The job; its machine must be a robot.
        shift_bounds: Least and largest shift of the workpiece from the job's place
            along x, y and z of the base [m]; equal ones fix it.
        angle_bounds: Likewise its turn about z of the base, about the middle of the
            cut [rad].
        rotation_bounds: Likewise one turn of the flange about the tool axis, the same
            for the whole path [rad].
        rows: Rows that cut and count, evenly chosen; the ends of the path along x, y
            and z have to be reached besides.
        starts: Places that are tried, spread over the bounds, before the steps.
        max_steps: Steps of the optimiser at most, from each of two starts.
        force: Force on the tool in `work` [N], shape (step, 3); the rigid cut's if not
            given.

    Returns:
        The place; never worse than the job's own, if that is within the bounds.

    Raises:
        ValueError: The job has no robot, or bounds make no sense.
        NothingToCorrect: The program never cuts.
        InfeasibleLimit: No place within the bounds can be reached.

    **Differentiability**: runs on the host, not traceable; the steps use the exact
    derivative, the inverse kinematics' by the implicit function.
    """
    lower, upper = _bounds(job, shift_bounds, angle_bounds, rotation_bounds)
    job = job.with_precision()
    if force is None:
        force = rigid_cut(job, FrozenStock()).force
    force = jnp.asarray(force, job.simulation.precision)
    if not np.any(np.asarray(force) != 0):
        raise NothingToCorrect("The program never cuts, so that any place will do.")
    # Infinite where the job's own place is refused.
    before = rms_across(job, force)
    task = _task(job, force, before, lower, upper, rows)
    tried = _search(task, lower, upper, starts)
    descended = _descend(task, lower, upper, tried, max_steps)
    best, place = np.inf, None
    for values in descended:
        candidate = _place(job, task, values)
        rms = rms_across(candidate.moved(job), force)
        if rms < best:
            best, place = rms, dataclasses.replace(candidate, rms_after=rms)
    if place is None:
        raise InfeasibleLimit(
            "Arguments `shift_bounds`, `angle_bounds` and `rotation_bounds` must leave "
            f"a place that the arm reaches along the whole path, but all {len(tried)} "
            "places tried are out of reach, beyond a joint's limit or nearly singular."
        )
    values = np.array([*place.shift, place.angle, place.rotation])
    near = np.minimum(values - lower, upper - values) <= _AT_BOUND * _widths(
        lower, upper
    )
    stuck = near & (upper > lower)
    names = tuple(
        name for name, is_near in zip(UNKNOWNS, stuck, strict=True) if is_near
    )
    return dataclasses.replace(
        place,
        rms_before=before if np.isfinite(before) else float("nan"),
        searched=len(tried),
        refused=sum(not np.isfinite(entry.error) for entry in tried),
        at_bound=names,
    )


def _bounds(
    job: Job,
    shift: Sequence[Sequence[float]],
    angle: Sequence[float],
    rotation: Sequence[float],
) -> tuple[Float[np.ndarray, " 5"], Float[np.ndarray, " 5"]]:
    """Lower and upper bounds of all unknowns."""
    if job.robot is None:
        raise ValueError("Argument `job` must have a robot, but its machine is rigid.")
    pairs = np.array([*shift, angle, rotation], np.float64)
    if pairs.shape != (5, 2):
        raise ValueError(
            "Argument `shift_bounds` must have a pair for each of x, y and z, but has "
            f"{len(shift)} entries."
        )
    if not (np.all(np.isfinite(pairs)) and np.all(pairs[:, 0] <= pairs[:, 1])):
        raise ValueError(
            "Bounds must be finite pairs of a least and a largest value, but are "
            f"{pairs.tolist()}."
        )
    if np.all(pairs[:, 0] == pairs[:, 1]):
        raise ValueError(
            "Bounds must leave something free, but all are pairs of equal values."
        )
    if job.tool_rotation == "free" and np.any(pairs[4] != 0):
        raise ValueError(
            "Argument `rotation_bounds` must be (0, 0) for a job whose tool_rotation "
            f'is "free", which turns it as it suits the joints, but is {rotation}.'
        )
    return pairs[:, 0], pairs[:, 1]


def _task(
    job: Job,
    force: Float[Array, "step 3"],
    before: float,
    lower: Float[np.ndarray, " 5"],
    upper: Float[np.ndarray, " 5"],
    rows: int,
) -> PlacementTask:
    """Task, its errors in units of that at the job's own place."""
    robot = job.robot
    assert robot is not None
    dtype = robot.dtype
    tips = np.asarray(job.path.positions, np.float64)
    cutting = np.flatnonzero(np.any(np.asarray(force) != 0, axis=1))
    even = np.round(np.linspace(0, cutting.size - 1, min(rows, cutting.size)))
    ends = [0, *np.argmin(tips, axis=0), *np.argmax(tips, axis=0)]
    chosen = np.array([*ends, *cutting[even.astype(int)]], np.int32)
    reference = before if 0 < before < np.inf else 1e-4
    weights = np.full(len(chosen), 1 / (reference * np.sqrt(len(even))))
    weights[: len(ends)] = 0.0
    T = np.asarray(job.T_base_work, np.float64)
    poses = np.asarray(
        JobKinematics(job).poses(jnp.asarray(job.path.positions)), np.float64
    )
    poses = np.linalg.inv(T)[None] @ poses[chosen]
    middle = 0.5 * (tips[cutting].min(axis=0) + tips[cutting].max(axis=0))
    lows, highs = np.asarray(robot.joint_lower), np.asarray(robot.joint_upper)
    has_limits = np.isfinite(lows) & np.isfinite(highs) & robot.motor_mask()
    least = _LEAST_SINGULAR
    if np.isfinite(before):
        q = whole_path(job, force).joints[chosen]
        least = min(least, 0.999 * least_singular_of(robot, q, job.tool_rotation))
    start = robot.home if job.joint_start is None else job.joint_start
    number = lambda value: jnp.asarray(value, dtype)
    return PlacementTask(
        robot=robot,
        T_base_work=number(T),
        Ts_work_tool=number(poses),
        q_start=number(start),
        force=number(force[chosen]),
        along=number(path_tangents(tips)[chosen]),
        weights=number(weights),
        center=number(T[:3, :3] @ middle + T[:3, 3]),
        widths=number(_widths(lower, upper)),
        least_singular=number(least),
        limited=tuple(int(i) for i in np.flatnonzero(has_limits)),
        tool_rotation=job.tool_rotation,
    )


def _widths(
    lower: Float[np.ndarray, " 5"], upper: Float[np.ndarray, " 5"]
) -> Float[np.ndarray, " 5"]:
    """Units in which the unknowns are of the order of 1."""
    widths = np.maximum(np.abs(lower), np.abs(upper))
    return np.where(widths > 0, widths, 1.0)


class _TriedPlace(eqx.Module):
    """A place of the search, and its error.

    Attributes:
        error: Half the square of its errors; infinite where it is refused.
        place: The unknowns in widths of their bounds, shape (5,).
    """

    error: float
    place: Float[np.ndarray, " 5"]


def _search(
    task: PlacementTask,
    lower: Float[np.ndarray, " 5"],
    upper: Float[np.ndarray, " 5"],
    starts: int,
) -> list[_TriedPlace]:
    """Places that are spread over the bounds, the job's own first."""
    low, high = lower / _widths(lower, upper), upper / _widths(lower, upper)
    # Unknowns that are fixed take no part in the spreading.
    is_free = high > low
    count = int(is_free.sum())
    # Multiples of the powers of a root of g^(n + 1) = g + 1 modulo 1 spread evenly:
    # the n-dimensional golden ratio.
    ratio = 2.0
    for _ in range(60):
        ratio = (1.0 + ratio) ** (1.0 / (count + 1))
    steps = np.zeros(len(low))
    steps[is_free] = ratio ** -np.arange(1.0, count + 1)
    places = [np.clip(np.zeros(len(low)), low, high)]
    places += [low + (high - low) * ((0.5 + k * steps) % 1.0) for k in range(starts)]
    problem = _Problem(task)
    return [_TriedPlace(problem.error(place), place) for place in places]


class _Problem(AbstractProblem):
    """Residual of a place, its joints in their ranges as constraints.

    As long as a joint is out of its range the steps first bring it back: what is
    outside counts many times over. Once all are within, no step may leave the ranges.
    """

    task: PlacementTask

    def evaluate(
        self, x: Float[np.ndarray, " 5"]
    ) -> Float[np.ndarray, " entry"] | None:
        """Residual; None where the place is refused."""
        unit = jnp.asarray(x, self.task.widths.dtype)
        entries = np.asarray(_residual(unit, self.task), np.float64)
        return entries if np.all(np.isfinite(entries)) else None

    def model(
        self, x: Float[np.ndarray, " 5"], value: Float[np.ndarray, " entry"]
    ) -> QuadraticModel:
        """Model of half the square of the errors."""
        unit = jnp.asarray(x, self.task.widths.dtype)
        J = np.asarray(_slopes(unit, self.task), np.float64)
        error, ranges = self.parts(value)
        J_error, J_ranges = self.parts(J)
        limits = OutputConstraints(
            np.full(len(ranges), -_JOINT_RANGE), np.full(len(ranges), _JOINT_RANGE)
        )
        is_hard = limits.is_within(ranges)
        rows = limits.rows(ranges, J_ranges)

        def cost(there: Float[np.ndarray, " 5"], at: np.ndarray) -> float:
            error, ranges = self.parts(at)
            return 0.5 * float(error @ error) + limits.cost(ranges, is_hard=is_hard)

        return QuadraticModel(cost, J_error.T @ error, J_error.T @ J_error, (rows,))

    def parts(
        self, entries: Float[np.ndarray, "..."]
    ) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
        """Errors and the joints in their ranges among the entries."""
        count = 3 * self.task.Ts_work_tool.shape[0]
        return entries[:count], entries[count:]

    def error(self, x: Float[np.ndarray, " 5"]) -> float:
        """Half the square of the errors; infinite where a place is refused."""
        entries = self.evaluate(x)
        if entries is None or np.any(np.abs(self.parts(entries)[1]) > _JOINT_RANGE):
            return np.inf
        error, _ = self.parts(entries)
        return 0.5 * float(error @ error)


_residual = eqx.filter_jit(placement_residual)
_slopes = eqx.filter_jit(jax.jacfwd(placement_residual))


def _descend(
    task: PlacementTask,
    lower: Float[np.ndarray, " 5"],
    upper: Float[np.ndarray, " 5"],
    tried: list[_TriedPlace],
    max_steps: int,
) -> list[Float[np.ndarray, " 5"]]:
    """Unknowns of the ends of two descents, and of their starts."""
    widths, problem = _widths(lower, upper), _Problem(task)
    own = tried[0]
    best = min(tried[1:], key=lambda entry: entry.error, default=own)
    places = []
    for start in [own.place] if best is own else [own.place, best.place]:
        places.append(start)
        if problem.evaluate(start) is not None:
            solution = least_squares(
                problem,
                start,
                LevenbergMarquardt(max_steps=max_steps, cost_rtol=_COST_RTOL),
                lower=lower / widths,
                upper=upper / widths,
            )
            places.append(solution.x)
    return [unit * widths for unit in places]


def _place(job: Job, task: PlacementTask, values: Float[np.ndarray, " 5"]) -> Placement:
    """Place whose errors are not known yet."""
    all_values = jnp.asarray(values, task.widths.dtype)
    robot = task.robot
    turned = turned_tool(robot.T_flange_tool, all_values[4])
    return Placement(
        T_base_work=np.asarray(moved_work(task.T_base_work, task.center, all_values)),
        T_flange_tool=np.asarray(turned),
        shift=values[:3],
        angle=float(values[3]),
        rotation=float(values[4]),
        rms_before=float("nan"),
        rms_after=float("nan"),
        searched=0,
        refused=0,
        at_bound=(),
    )
