"""The feed of a job: what an override costs in error and gains in time.

`feed_tradeoff` overrides the whole program by stated factors and simulates, and
corrects, each. `tune_feed` looks for the override along the path. Both simulate every
override over as many rows as the slowest needs, the tool standing still at the end of
the faster ones, where it cuts nothing: one compiled program serves all.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job
from ..._moving_rows import step_lengths
from ..._types import RealScalarLike
from ...process import AbstractAdjoint, ThroughPoses
from ...sim import JobKinematics, MachiningProblem, Solution, simulate
from ...toolpath import PathFeed, retime
from .._core.problem import Motion
from .._job.correct import correct
from .._job.correction_problem import NEVER_CUTS, NothingToCorrect, counting_weights
from .._job.plant_segments import wall_motion
from .problem import FeedProblem
from .result import FeedTradeoff, TunedFeed
from .trade_off_curve import FeedPoint, OnShare

_TIME_WEIGHTS = (0.3, 0.1, 0.03)


class FeedPlant(eqx.Module):
    """A job as a plant that is given tips, tool axes and tool x in `work`."""

    job: Job
    adjoint: AbstractAdjoint

    def __call__(
        self,
        desired: Float[Array, "row 3"],
        axes: Float[Array, "row 3"],
        tool_x: Float[Array, "row 3"] | None = None,
    ) -> Motion:
        """Motion that follows the desired path as command."""
        place = lambda job: (job.path.positions, job.path.axes)
        job = eqx.tree_at(place, self.job, (desired, axes))
        if tool_x is not None:
            job = eqx.tree_at(lambda job: job.path.tool_x, job, tool_x)
        motors, _ = JobKinematics(job).motors(desired)
        ran = MachiningProblem.of(job, self.adjoint).run(motors)
        return wall_motion(job, ran.ends, ran.force, None)


def feed_tradeoff(
    job: Job,
    overrides: tuple[float, ...] = (0.5, 0.75, 1.0, 1.25, 1.5),
    *,
    corrects: bool = True,
    acceleration: RealScalarLike | None = None,
    on_progress: OnShare | None = None,
) -> FeedTradeoff:
    """Simulate, and correct, a job at several feeds.

    Args:
        job: The job; its machine must not be rigid.
        overrides: Factors of the feed of the whole program, positive; rapid moves are
            not overridden.
        corrects: Whether each is corrected too, as `[correction]` states.
        acceleration: Largest acceleration of the program [m/s^2]; that of its path if
            not given.
        on_progress: Called with a message and the share done.

    Returns:
        The table. Errors are averaged over the length that is cut, since a slower tool
        takes more rows for it.

    Raises:
        SimulationFailed: A run fails; a feed may be too fast for the window of rays.
        NothingToCorrect: The program never cuts; a `ValueError`.
        InfeasibleLimit, UnsuitableSettings: As `correct`, for one of the feeds.
        ValueError: The machine is rigid, or an override is not positive.
    """
    _check_machine(job)
    feed = PathFeed.of_path(job.path, acceleration=acceleration)
    times = [feed.cycle_time(override) for override in overrides]
    rows = max(feed.row_count(override) for override in overrides)
    report_share = on_progress or (lambda message, share: None)
    runs: list[dict[str, float]] = []
    for done, (override, time) in enumerate(zip(overrides, times, strict=True)):
        share, name = done / len(overrides), f"override {override:g}"
        report_share(name, share)
        path = retime(
            job.path, override, acceleration=feed.acceleration, step_count=rows
        )
        slowed = eqx.tree_at(lambda j: j.path, job, path)
        if corrects:
            report = lambda text, rms, share=share, name=name: report_share(
                f"{name}, {text}: contour error {1e6 * rms:.2f} um rms", share
            )
            correction = correct(slowed, on_progress=report)
            before, after = correction.before, _error(correction.after)
            offset = float(jnp.abs(correction.commanded - before.desired).max())
        else:
            before, after, offset = simulate(slowed), np.nan, np.nan
        steps = _steps(before)
        if not np.any(steps > 0):
            raise NothingToCorrect(NEVER_CUTS)
        runs.append(
            {
                "override": override,
                "cycle_time": time,
                "feed_per_tooth": float(np.median(steps[steps > 0])),
                "uncorrected": _error(before),
                "corrected": after,
                "max_offset": offset,
            }
        )
        report_share(
            f"{name}: {1e6 * _error(before):.2f} um", (done + 1) / len(overrides)
        )
    columns = {name: np.array([run[name] for run in runs], float) for name in runs[0]}
    return FeedTradeoff(**columns)


def tune_feed(
    job: Job,
    *,
    time_weights: tuple[float, ...] = _TIME_WEIGHTS,
    count: int = 8,
    lowest: float = 0.5,
    highest: float = 1.5,
    acceleration: RealScalarLike | None = None,
    max_steps: int = 8,
    on_progress: OnShare | None = None,
) -> TunedFeed:
    """Find the feed override along the path for less error, less time, or both.

    For every weight the sum of half the mean square contour error and of the weight
    times the cycle time becomes small, each over that of the program as it is. At the
    best override 1 % less time would add as much to the mean square error as twice the
    weight in percent. Errors are those of the uncorrected program; a `path` found may
    be corrected afterwards.

    The derivative is that of the coupled simulation. What it holds constant is the
    rows' choice of the nearest segment of the path, and the rays that a pose cuts;
    where the tool cuts is taken from the program as it is, its beginning and end
    smoothed over 8 rows.

    Args:
        job: The job; its machine must not be rigid.
        time_weights: Weights of the time, positive; each starts where the last ended.
        count: Knots of the override, equally spaced over the length of the path.
        lowest: Smallest override.
        highest: Largest override.
        acceleration: Largest acceleration of the program [m/s^2]; that of its path if
            not given.
        max_steps: Gauss-Newton steps for each weight at most.
        on_progress: Called with a message and the share done.

    Returns:
        The curve, its first point being the program as it is.

    Raises:
        SimulationFailed: The run of the program as it is fails.
        NothingToCorrect: The program never cuts, or all that cuts has no weight; a
            `ValueError`.
        ValueError: The machine is rigid, a weight or a bound is not positive, or the
            path never accelerates and no acceleration is given.
    """
    _check_machine(job)
    job = job.with_precision()
    adjoint = ThroughPoses()
    before = simulate(job, adjoint=adjoint)
    job = job.with_intervals(before.stock.interval_counts)
    feed = PathFeed.of_path(job.path, acceleration=acceleration)
    problem = FeedProblem(
        FeedPlant(job, adjoint),
        feed,
        FeedProblem.smoothed(counting_weights(job, before, None)),
        lowest,
        highest,
    )
    points = FeedPoint.curve(
        problem,
        time_weights=time_weights,
        count=count,
        max_steps=max_steps,
        on_progress=on_progress,
    )
    retimed = lambda point: retime(
        job.path, point.override, acceleration=feed.acceleration
    )
    travel = float(feed.travel[-1]) * np.linspace(0.0, 1.0, count)
    return TunedFeed(points, travel, tuple(retimed(point) for point in points))


def _check_machine(job: Job) -> None:
    if job.is_rigid:
        raise ValueError("Argument `job` must have a soft machine, but it is rigid.")


def _steps(solution: Solution) -> Float[np.ndarray, " row"]:
    """Length of the path up to each row that cuts, else zero [m], shape (row,)."""
    cuts = np.asarray(solution.is_cutting)
    return np.where(cuts, step_lengths(solution.desired), 0.0)


def _error(solution: Solution) -> float:
    """Root mean square contour error over the length that is cut [m]."""
    square = np.asarray(solution.contour_error, np.float64) ** 2
    return float(np.sqrt(np.average(square, weights=_steps(solution))))
