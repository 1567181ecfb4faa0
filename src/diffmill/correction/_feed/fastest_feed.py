"""The largest feed of a whole program within a tolerance and limits of the drives."""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job
from ..._result import SimulationFailed
from ...sim import JobKinematics, Solution, simulate
from ...toolpath import Path, PathFeed, retime
from .._job.correct import correct
from .._job.correction_problem import NEVER_CUTS, NothingToCorrect
from .trade_off_curve import OnShare

if TYPE_CHECKING:
    import xarray

# Share within which the override is found, and by which one is raised until it fails.
_SHARE, _RAISE = 0.02, 1.5


class TriedFeed(NamedTuple):
    """An override that was tried.

    Attributes:
        override: Factor of the feed of the whole program; of one that varies along the
            path the mean.
        cycle_time: Time of the program [s].
        error: Largest contour error where the tool cuts [m].
        force: Largest force, as the mean of a tooth period [N].
        power: Largest power of the spindle, as the mean of a tooth period [W].
        joint_speed: Largest speed of a joint over what it can; 0 without a limit.
        broken: Limit that it breaks: "tolerance", "force", "power" or "joint speed";
            empty for none, and "run" where the simulation fails.
    """

    override: float
    cycle_time: float
    error: float
    force: float
    power: float
    joint_speed: float
    broken: str


class FastestFeed(eqx.Module):
    """The largest feed that keeps all limits.

    Attributes:
        tried: All overrides that were tried, in this order.
        best: The largest one that breaks nothing; None if none does.
        limited_by: What the next larger one breaks; empty if the largest that was
            allowed breaks nothing.
        path: The path with the best override; None without one.
        along: The best override at knots equally spaced over the length of the path,
            shape (knot,); None where it is one for the whole program.
        commanded: Corrected command of that path, which kept the limits [m], shape
            (step, 3); None where the path itself did.
    """

    tried: tuple[TriedFeed, ...]
    best: TriedFeed | None
    limited_by: str
    path: Path | None
    along: Float[np.ndarray, " knot"] | None = None
    commanded: Float[np.ndarray, "step 3"] | None = None

    def to_dataset(self) -> "xarray.Dataset":
        """Overrides that were tried on the dimension `trial`."""
        import xarray

        about = {
            "override": "1",
            "cycle_time": "s",
            "error": "m",
            "force": "N",
            "power": "W",
            "joint_speed": "1",
        }
        columns = {
            name: ("trial", np.array([getattr(x, name) for x in self.tried]))
            for name in about
        }
        return xarray.Dataset(
            {
                name: (*column, {"units": about[name]})
                for name, column in columns.items()
            },
            coords={"broken": ("trial", [one.broken for one in self.tried])},
        )


def fastest_feed(
    job: Job,
    tolerance: float,
    *,
    max_force: float = np.inf,
    max_power: float = np.inf,
    corrects: bool = False,
    lowest: float = 0.2,
    highest: float = 3.0,
    knots: int = 0,
    on_progress: OnShare | None = None,
) -> FastestFeed:
    """Find the largest override of a program that keeps tolerance, loads and drives.

    The error grows with the feed where the tool cuts; the override is found within 2 %
    by bisection, each trial a simulation, or a correction. An override that varies
    along the path then goes beyond it where the error leaves room,

        o(s) = o_best (1 + share (min(tolerance / e(s), highest / o_best) - 1)),

    with e(s) the largest error of the best one about s; the largest share of four
    trials that breaks no limit is taken.

    Args:
        job: The job; its machine must not be rigid.
        tolerance: Largest contour error that is allowed [m].
        max_force: Largest force, as the mean of a tooth period [N].
        max_power: Largest power of the spindle, likewise [W].
        corrects: Whether the error is that of the corrected program.
        lowest: Smallest override that is tried.
        highest: Largest one.
        knots: Knots of an override that varies along the path, at least 2; 0 for one
            override of the whole program.
        on_progress: Called with a message and the share done.

    Returns:
        The override, and all that were tried.

    Raises:
        NothingToCorrect: The program never cuts; a `ValueError`.
        InfeasibleLimit, UnsuitableSettings: As `correct`, for one of the feeds.
        ValueError: The machine is rigid, or a bound is not positive.

    Differentiability: runs on the host, not traceable.
    """
    if job.is_rigid:
        raise ValueError("Argument `job` must have a soft machine, but it is rigid.")
    limits = {
        "tolerance": tolerance,
        "max_force": max_force,
        "max_power": max_power,
        "lowest": lowest,
    }
    for name, limit in limits.items():
        if not limit > 0:
            raise ValueError(f"Argument `{name}` must be positive, but is {limit:g}.")
    if highest < lowest:
        raise ValueError(
            f"Argument `highest` must not be below `lowest`, but they are {highest:g} "
            f"and {lowest:g}."
        )
    if knots == 1 or knots < 0:
        raise ValueError(f"Argument `knots` must be 0 or at least 2, but is {knots}.")
    report = on_progress or (lambda message, share: None)
    search = _Search(job, tolerance, max_force, max_power, corrects)
    good, bad, override = 0.0, np.inf, min(max(1.0, lowest), highest)
    trials: list[_Trial] = []

    def attempt(
        name: str, share: float, override: "float | Float[np.ndarray, ' knot']"
    ) -> None:
        report(name, share)
        tell = lambda message, rms: report(f"{name}: {message}", share)
        trials.append(search.trial(override, tell))

    while True:
        attempt(f"override {override:.3g}", min(len(trials) / 12, 1.0), override)
        if trials[-1].feed.broken:
            bad = override
        else:
            good = override
        is_found = np.isfinite(bad) and bad - good <= _SHARE * bad
        if good == highest or bad == lowest or is_found:
            break
        if not np.isfinite(bad):
            override = min(good * _RAISE, highest)
        else:
            override = (bad + good) / 2 if good else max(bad / _RAISE, lowest)
    kept = [one for one in trials if not one.feed.broken]
    best = max(kept, key=lambda one: one.feed.override, default=None)
    broken = [one.feed for one in trials if one.feed.broken]
    first = min(broken, key=lambda one: one.override, default=None)
    limited_by = "" if first is None else first.broken
    if best is None:
        return FastestFeed(tuple(one.feed for one in trials), None, limited_by, None)
    along = None
    if knots and best.feed.override < highest:
        even = best.feed.override
        room = search.room(even, knots, highest)
        for number, share in enumerate((1.0, 0.7, 0.4, 0.2)):
            override = even * (1 + share * (room - 1))
            name = f"override along the path, share {share:g}"
            attempt(name, 0.8 + 0.05 * number, override)
            if not trials[-1].feed.broken:
                best, along = trials[-1], override
                break
    path = retime(job.path, best.feed.override if along is None else along)
    return FastestFeed(
        tuple(one.feed for one in trials),
        best.feed,
        limited_by,
        path,
        along,
        best.commanded,
    )


class _Trial(NamedTuple):
    """Trial of a feed.

    Attributes:
        feed: Its figures.
        commanded: Its corrected command [m]; None without one.
    """

    feed: TriedFeed
    commanded: Float[np.ndarray, "step 3"] | None = None


class _Search(NamedTuple):
    """Limits that a feed has to keep."""

    job: Job
    tolerance: float
    max_force: float
    max_power: float
    corrects: bool

    def room(
        self, override: float, knots: int, highest: float
    ) -> Float[np.ndarray, " knot"]:
        """Factors by which the feed may rise at the knots, if the error grows with it.

        Args:
            override: The override of the whole program.
            knots: Number of knots.
            highest: Largest override.
        """
        job = self._with(override)
        run = self._run(job, lambda message, rms: None)
        steps = np.linalg.norm(np.diff(job.path.positions, axis=0), axis=1)
        place = np.concatenate([[0.0], np.cumsum(steps)])
        place *= (knots - 1) / max(float(place[-1]), 1e-12)
        error = np.abs(np.asarray(run.contour_error)) * np.asarray(run.is_cutting)
        # A knot counts up to the next one on either side.
        largest = np.array(
            [error[np.abs(place - k) <= 1].max(initial=0.0) for k in range(knots)]
        )
        most = highest / override
        return np.clip(self.tolerance / np.maximum(largest, 1e-12), 1.0, most)

    def trial(
        self,
        override: "float | Float[np.ndarray, ' knot']",
        on_progress: Callable[[str, float], None],
    ) -> _Trial:
        """Trial of an override, of the whole program or at knots along the path.

        Args:
            override: The override.
            on_progress: Called as by `correct`, if the program is corrected.
        """
        time = PathFeed.of_path(self.job.path).cycle_time(override)
        job, mean = self._with(override), float(np.mean(override))
        try:
            run = self._run(job, on_progress)
        except SimulationFailed:
            none = np.nan
            return _Trial(TriedFeed(mean, time, none, none, none, none, "run"))
        cuts = np.asarray(run.is_cutting)
        if not cuts.any():
            raise NothingToCorrect(NEVER_CUTS)
        error = float(run.contour.max)
        force = float(np.linalg.norm(np.asarray(run.force)[cuts], axis=1).max())
        torque = float(np.asarray(run.spindle_torque)[cuts].max())
        power = torque * float(job.spindle_speed)
        speed = _joint_speed(job, run.commanded)
        limits = {
            "tolerance": error > self.tolerance,
            "force": force > self.max_force,
            "power": power > self.max_power,
            "joint speed": speed > 1,
        }
        broken = next((name for name, is_broken in limits.items() if is_broken), "")
        feed = TriedFeed(mean, time, error, force, power, speed, broken)
        return _Trial(feed, np.asarray(run.commanded, float) if self.corrects else None)

    def _with(self, override: "float | Float[np.ndarray, ' knot']") -> Job:
        """Job whose path has an override."""
        path = retime(self.job.path, override)
        return eqx.tree_at(lambda j: j.path, self.job, path)

    def _run(self, job: Job, on_progress: Callable[[str, float], None]) -> Solution:
        """Run of a job, corrected if that was asked for.

        Raises:
            SimulationFailed: It fails.
        """
        if self.corrects:
            run = correct(job, on_progress=on_progress).after
        else:
            run = simulate(job)
        run.raise_unless_successful(job)
        return run


def _joint_speed(job: Job, commanded: Float[Array, "step 3"]) -> float:
    """Largest speed of a joint over what it can, of a command [m]; 0 without."""
    if job.robot is None or job.robot.joint_speed is None:
        return 0.0
    motors, _ = JobKinematics(job).motors(jnp.asarray(commanded))
    rate = np.abs(np.diff(np.asarray(motors), axis=0)) / float(job.tooth_period)
    share = rate / np.asarray(job.robot.joint_speed)
    return float(np.max(share, initial=0.0, where=np.isfinite(share)))
