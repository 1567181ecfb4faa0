"""Stability lobes: the depth of cut at which vibrations grow, over the spindle speed.

The arc in which the teeth cut, their feed and the pose of the machine are those of some
places of a program; speed and depth vary. Layers of an edge above those that cut there
are taken to cut as the highest one does, held back by the helix.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from ..._job import Job
from ...cutter import AbstractCutter
from ...process import Process
from ...workpiece import Pose
from .._job.simulate import OnProgress, Solution, simulate
from .._machine.elastic import ElasticArm
from .._machine.modal import ModalMachine
from .monodromy import Regeneration, Step, Vibration, monodromy, strongest
from .quick_force_jacobian import LayerSlopes, layer_slopes, quick_slopes
from .stability import (
    ToolMotion,
    check_vibrates,
    deep_rows,
    fastest_mode,
    job_motion,
    linear_machine,
    needed_steps,
    stability_machine,
    stability_process,
    tool_poses,
)

if TYPE_CHECKING:
    import xarray

# Places that are looked at unless asked for, and how far apart they are, as a share of
# the program.
_PLACES, _APART = 3, 0.1
# Speeds over the program's own, their number, and depths over that of the place.
_SLOWEST, _FASTEST, _SPEEDS, _DEEPEST = 0.6, 1.5, 61, 4.0
# Pieces of a tooth period in which slopes are taken.
_PIECES = 96
# Depths that are tried one after the other, from the largest depth over so much, and
# the share within which a limit is found.
_TRIALS, _RANGE, _SHARE = 16, 50.0, 1e-2
# Share of the largest layer from which one counts as cut all along its arc.
_WHOLE = 0.9
# Limits of two speeds that are alike, a share.
_ALIKE = 0.02


class StabilityLobes(eqx.Module):
    """Depths at which vibrations begin to grow, at some places of a program.

    Attributes:
        row: Rows at whose pose and arc of the cut, shape (place,).
        position: Tool tip there in `work` [m], shape (place, 3).
        depth: Depth that the program cuts there along the axis [m], shape (place,).
        speed: Speeds of the spindle [rad/s], ascending, shape (speed,).
        limit: Depth at which vibrations begin to grow [m]; infinite where they do not
            up to `deepest`, shape (place, speed).
        frequency: Of that vibration [Hz]; NaN where there is none, shape (place,
            speed).
        own_speed: Speed of the program [rad/s].
        deepest: Largest depth that was tried [m].
    """

    row: Int[np.ndarray, " place"]
    position: Float[np.ndarray, "place 3"]
    depth: Float[np.ndarray, " place"]
    speed: Float[np.ndarray, " speed"]
    limit: Float[np.ndarray, "place speed"]
    frequency: Float[np.ndarray, "place speed"]
    own_speed: float
    deepest: float

    @property
    def least(self) -> Float[np.ndarray, " speed"]:
        """Least limit of all places over their depths [-], shape (speed,).

        Below 1 the program chatters at that speed.
        """
        return np.min(self.limit / self.depth[:, None], axis=0)

    def preferred(self, count: int = 3) -> Int[np.ndarray, " chosen"]:
        """Indices of speeds that allow the largest depths around them, the best first.

        Args:
            count: How many at most.
        """
        least = np.minimum(self.least, np.min(self.deepest / self.depth))
        found: list[int] = []
        # The middle of each stretch of equal depths that none beside it exceeds.
        start = 0
        for k in range(1, len(least) + 1):
            if k < len(least) and abs(least[k] - least[start]) <= _ALIKE * least[start]:
                continue
            before = least[start - 1] if start else -np.inf
            after = least[k] if k < len(least) else -np.inf
            if least[start] >= max(before, after):
                found.append((start + k - 1) // 2)
            start = k
        return np.array(sorted(found, key=lambda k: -least[k])[:count], int)

    @property
    def own_column(self) -> int:
        """Index of the speed that is nearest to the program's."""
        return int(np.argmin(np.abs(self.speed - self.own_speed)))

    def to_dataset(self) -> "xarray.Dataset":
        """All of it as an `xarray.Dataset`."""
        import xarray

        both = ("place", "speed")
        return xarray.Dataset(
            {
                "row": ("place", self.row, {"units": "1"}),
                "position": (("place", "axis"), self.position, {"units": "m"}),
                "depth": ("place", self.depth, {"units": "m"}),
                "limit": (both, self.limit, {"units": "m"}),
                "frequency": (both, self.frequency, {"units": "Hz"}),
            },
            coords={
                "speed": ("speed", self.speed, {"units": "rad/s"}),
                "axis": list("xyz"),
            },
            attrs={"own_speed_rad_s": self.own_speed, "deepest_m": self.deepest},
        )

    @staticmethod
    def along(
        arm: ElasticArm | ModalMachine,
        process: Process,
        motor_positions: Float[Array, "step joint"],
        joint_positions: Float[Array, "step joint"],
        rows: Sequence[int] | Int[np.ndarray, " row"],
        speeds: Float[np.ndarray, " speed"],
        *,
        deepest: float | None = None,
        on_progress: OnProgress | None = None,
    ) -> "StabilityLobes":
        """Lobes at some rows of a motion; see `stability_lobes`.

        Args:
            arm: The machine.
            process: The process, with the chip model "near_far".
            motor_positions: As of `Stability.along`.
            joint_positions: As of `Stability.along`.
            rows: The rows, from 1.
            speeds: Speeds of the spindle [rad/s], ascending.
            deepest: Largest depth [m]; if not given four times the depth at the rows.
            on_progress: As of `stability_lobes`.

        Returns:
            The lobes, on the host.

        Raises:
            ValueError: No tooth cuts at a row.

        Differentiability: none, a host function.
        """
        chosen = np.asarray(rows, np.int32)
        upright = process.engagement.is_upright
        path = tool_poses(arm, joint_positions, is_upright=upright)
        tips = path.tip[: len(joint_positions)]
        motion = ToolMotion(motor_positions, joint_positions, tips)
        layers = layer_slopes(process, path, chosen, _PIECES)
        depth = np.array([_depth(one) for one in layers])
        if not depth.all():
            raise ValueError(
                "Argument `rows` must have rows at which a tooth cuts, but none does "
                f"at {chosen[depth == 0].tolist()}."
            )
        most = _DEEPEST * float(depth.max()) if deepest is None else deepest
        arms = linear_machine(arm, motion, chosen, float(process.tooth_period))
        A, G, C = (np.asarray(x, np.float64) for x in (arms.A, arms.G, arms.C))
        tell = on_progress or (lambda message, share: None)
        message = f"depth limits (places: {len(layers)}, speeds: {len(speeds)})"
        found = []
        for k, one in enumerate(layers):
            cut = _Cut.of(process.cutter, one, most)
            place = _Place(process.cutter, A[k], G[k], C[k], cut)
            for speed in speeds:
                tell(message, len(found) / (len(layers) * len(speeds)))
                found.append(place.limit(float(speed)))
        each = np.array(found).reshape(len(layers), len(speeds), 2)
        limit, frequency = np.moveaxis(each, -1, 0)
        return StabilityLobes(
            row=chosen,
            position=np.asarray(path.tip)[chosen],
            depth=depth,
            speed=speeds,
            limit=limit,
            frequency=frequency,
            own_speed=float(process.spindle_speed),
            deepest=most,
        )


def stability_lobes(
    job: Job,
    solution: Solution | None = None,
    *,
    rows: Sequence[int] | Int[np.ndarray, " row"] | None = None,
    speeds: Float[np.ndarray, " speed"] | None = None,
    deepest: float | None = None,
    on_progress: OnProgress | None = None,
) -> StabilityLobes:
    """Depths at which vibrations begin to grow, at the deepest places of a program.

    The feed of a tooth is that of the program at every speed. Process damping, by which
    a flank that rubs calms slow cuts, is not modelled: limits at low speeds are low.

    Args:
        job: The job; its machine must not be rigid.
        solution: Its solution; simulated if not given.
        rows: Rows to examine, from 1; if not given up to three of the largest chips
            that last, apart from each other.
        speeds: Speeds of the spindle [rad/s], ascending; if not given 61 from 0.6 to
            1.5 times the program's.
        deepest: Largest depth [m]; if not given four times that of the program there.
        on_progress: Called with a message and the share of the limits that are found.

    Returns:
        The lobes, on the host.

    Raises:
        ValueError: The machine is rigid, the job is quasi-static, or the tool does not
            cut at the rows.

    Differentiability: none, a host function.
    """
    check_vibrates(job)
    job = job.with_precision()
    solution = simulate(job) if solution is None else solution
    machine, process = stability_machine(job), stability_process(job)
    motion = job_motion(job, solution)
    if rows is None:
        upright = process.engagement.is_upright
        path = tool_poses(machine, motion.joints, is_upright=upright)
        rows = _heaviest(process, path, deep_rows(solution))
    if speeds is None:
        shares = np.linspace(_SLOWEST, _FASTEST, _SPEEDS)
        speeds = float(job.spindle_speed) * shares
    return StabilityLobes.along(
        machine,
        process,
        motion.motors,
        motion.joints,
        rows,
        np.asarray(speeds, np.float64),
        deepest=deepest,
        on_progress=on_progress,
    )


def _heaviest(
    process: Process, path: Pose, rows: Int[np.ndarray, " row"]
) -> Int[np.ndarray, " chosen"]:
    """Return those of some rows whose force grows most with the chip, apart.

    Raises:
        ValueError: The tool cuts at none.
    """
    candidates = np.unique(rows)
    periods = quick_slopes(process, path, candidates) if candidates.size else []
    gains = np.array([max(one.gain() for one in turn) for turn in periods])
    found: list[int] = []
    for k in np.argsort(-gains):
        row = int(candidates[k])
        far = all(abs(row - other) > _APART * len(path.tip) for other in found)
        if gains[k] > 0 and far and len(found) < _PLACES:
            found.append(row)
    if not found:
        raise ValueError("Argument `solution` must cut somewhere, but does not.")
    return np.array(found)


def _depth(layers: LayerSlopes) -> float:
    """Return the height over which teeth cut [m]; 0 if none does."""
    cuts = np.flatnonzero(np.any(layers.slopes != 0, axis=(0, 1, 3, 4)))
    if not cuts.size:
        return 0.0
    spacing = np.diff(layers.height)
    each = float(spacing.mean()) if spacing.size else 0.0
    return float(layers.height[cuts[-1]] - layers.height[cuts[0]]) + each


class _Cut(NamedTuple):
    """Slopes of the force of each tooth over a turn, from the tip up to depths.

    Attributes:
        depth: Depths, ascending from 0 [m], shape (depth,).
        slopes: In the tip now [N/m], shape (depth, piece, tooth, 3, 3).
    """

    depth: Float[np.ndarray, " depth"]
    slopes: Float[np.ndarray, "depth piece tooth 3 3"]

    @classmethod
    def of(cls, cutter: AbstractCutter, layers: LayerSlopes, deepest: float) -> "_Cut":
        """Cut up to a depth, of layers that are cut at a place."""
        cuts = np.flatnonzero(np.any(layers.slopes != 0, axis=(0, 1, 3, 4)))
        each = float(np.diff(layers.height).mean())
        own = layers.slopes[:, :, cuts[0] : cuts[-1] + 1]
        # The highest layer that is cut as long as any is whole.
        size = np.abs(own).sum(axis=(0, 1, 3, 4))
        top = int(np.flatnonzero(size > _WHOLE * size.max())[-1])
        more = math.ceil(deepest / each) - (top + 1)
        parts = [own[:, :, : top + 1]]
        if more > 0:
            rise = layers.lag[cuts[0] + top] - layers.lag[max(cuts[0] + top - 1, 0)]
            turned = np.arange(1, more + 1) * rise
            parts.append(_turned(own[:, :, top], turned))
        slopes = np.moveaxis(np.concatenate(parts, axis=2), 2, 0)
        none = np.zeros_like(slopes[:1])
        total = np.concatenate([none, np.cumsum(slopes, axis=0)])
        return cls(each * np.arange(len(total)), total)

    def at(self, depth: float) -> Float[np.ndarray, "piece tooth 3 3"]:
        """Slopes of a cut of some depth [m]."""
        k = int(np.clip(np.searchsorted(self.depth, depth) - 1, 0, len(self.depth) - 2))
        share = (depth - self.depth[k]) / (self.depth[k + 1] - self.depth[k])
        return (1 - share) * self.slopes[k] + share * self.slopes[k + 1]


def _turned(
    layer: Float[np.ndarray, "piece tooth 3 3"], angles: Float[np.ndarray, " layer"]
) -> Float[np.ndarray, "piece tooth layer 3 3"]:
    """Return a layer as often as it is held back by angles [rad]."""
    pieces = len(layer)
    back = np.arange(pieces)[:, None] - angles / (2 * math.pi) * pieces
    low = np.floor(back).astype(int)
    share = (back - low)[:, None, :, None, None]
    of = lambda at: np.moveaxis(layer[at % pieces], 2, 1)
    return (1 - share) * of(low) + share * of(low + 1)


class _Place(NamedTuple):
    """A machine at a place, and what it cuts there."""

    cutter: AbstractCutter
    A: Float[np.ndarray, "state state"]
    G: Float[np.ndarray, "state 3"]
    C: Float[np.ndarray, "3 state"]
    cut: _Cut

    def limit(self, speed: float) -> tuple[float, float]:
        """Depth at which vibrations begin to grow [m], and their frequency [Hz].

        Args:
            speed: Of the spindle [rad/s].
        """
        deepest = float(self.cut.depth[-1])
        below, above, found = 0.0, math.inf, None
        for depth in deepest * np.geomspace(1 / _RANGE, 1, _TRIALS):
            found = self.vibration(speed, float(depth))
            if found.radius > 1:
                above = float(depth)
                break
            below = float(depth)
        if not math.isfinite(above):
            return math.inf, math.nan
        while above - below > _SHARE * above:
            middle = (above + below) / 2
            trial = self.vibration(speed, middle)
            if trial.radius > 1:
                above, found = middle, trial
            else:
                below = middle
        assert found is not None
        return (above + below) / 2, found.frequency

    def vibration(self, speed: float, depth: float) -> Vibration:
        """The strongest vibration at a speed and a depth."""
        cutter, teeth = self.cutter, self.cutter.flute_count
        T, slopes = 2 * math.pi / (speed * teeth), self.cut.at(depth)
        slopes = slopes.reshape(teeth, -1, *slopes.shape[1:])
        delays = np.ones(1)
        if cutter.has_even_pitch:
            # All teeth are alike, and a period repeats itself.
            slopes = slopes[:1].sum(axis=2, keepdims=True)
        else:
            delays = np.asarray(cutter.delays(np.float64))[0]
        periods = [Regeneration(x.sum(axis=1), -x, delays) for x in slopes]
        gain = max(period.gain() for period in periods)
        steps = needed_steps(T, fastest_mode(self.A, self.G, self.C, gain))
        over_step = Step.of(self.A, self.G, T / steps)
        periods = [period.in_steps(steps) for period in periods]
        return strongest(monodromy(over_step, self.C, periods), T)
