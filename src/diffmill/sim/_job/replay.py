"""The process of a solution once more, for whoever looks at it closer.

Where the tool was and how it leaned, how finely the process is computed and the laws of
both edges are those of the run. Only the robot is left out: between the tooth instants
the tool goes along a smooth curve through them.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._arrays import on_device
from ..._job import Job
from ..._live_rows import padded_count
from ...numerics import CompiledOnce
from ...process import (
    EdgeElementsInSpace,
    Engagement,
    Process,
    ProcessState,
    ThroughRays,
)
from ...workpiece import Pose
from .._analysis.stability import joint_poses
from .._machine.machine import Run
from .simulate import Solution, job_process, rigid_cut


class ToothChip(eqx.Module):
    """The chip that one tooth meets in a revolution, on the host.

    Attributes:
        immersion_angle: Angle phi in the feed frame, clockwise from the left of the
            feed [rad], equally spaced, shape (angle,).
        height: Height of each edge element above the tip [m], shape (element,).
        chip_thickness: Chip thickness h in the stock [m], shape (element, angle).
        weight: Fraction of the sample that is in stock, from 0 to 1, shape
            (element, angle).
    """

    immersion_angle: Float[np.ndarray, " angle"]
    height: Float[np.ndarray, " element"]
    chip_thickness: Float[np.ndarray, "element angle"]
    weight: Float[np.ndarray, "element angle"]


class Replay(eqx.Module):
    """A process along poses that are known.

    Attributes:
        process: The process.
        path: Poses at the tooth instants in `work`, shape (step, 3).
    """

    process: Process
    path: Pose

    @classmethod
    def of_solution(cls, job: Job, solution: Solution) -> "Replay":
        """Return the process of a solution, along its actual poses.

        Args:
            job: The job.
            solution: Its solution.
        """
        job = job.with_precision()
        return cls(job_process(job, ThroughRays()), _actual_poses(job, solution))

    @classmethod
    def prepare(cls, job: Job) -> None:
        """Compile in the background what replaying a solution of a job will run."""
        job = job.with_precision()
        tips = on_device(np.asarray(job.path.positions))
        poses = Pose.along(tips, job.tool_axes)
        replay = cls(job_process(job, ThroughRays()), poses)
        _last_periods.prepare(replay.process, *replay._until(tips.shape[0] - 1))

    @staticmethod
    def run(job: Job, solution: Solution) -> Run:
        """Return the process along the poses of a solution; check `.result`.

        Args:
            job: The job.
            solution: Its solution.

        Returns:
            The run, by the program of the rigid cut, with the force at every angle
            sample.
        """
        job = job.with_precision()
        return rigid_cut(job, ThroughRays(), along=_actual_poses(job, solution))

    def tooth_chip(self, step: int) -> ToothChip:
        """Return the chip that tooth 0 meets in the revolution that ends at a step.

        The process runs along the path up to there, without forces.

        Args:
            step: Row of the path at which the revolution ends, from 1; near the start
                of the path the revolution is not whole.

        Returns:
            The chip on the edge, without the flat end of the tool. Angles of a helical
            cutter are true to half a sample.

        Raises:
            ValueError: If there is no such step.
        """
        rows = self.path.tip.shape[0]
        if not 1 <= step < rows:
            raise ValueError(
                f"Argument `step` must lie between 1 and {rows - 1}, but is {step}."
            )
        part = self.path[: step + 1]
        engagement, cutter = self.process.engagement, self.process.cutter
        found = _last_periods(self.process, *self._until(step))
        angle, tooth, chip, weight = (np.asarray(x, np.float64) for x in found)
        shape = weight.shape
        is_row = isinstance(engagement, EdgeElementsInSpace)
        first = engagement.profile.bottom if is_row else 0
        flat = lambda x: np.broadcast_to(x, shape).reshape(-1, shape[-1])[:, first:]
        height = engagement.element_heights(cutter, part.tip.dtype)
        height = np.asarray(height, np.float64)[first:]
        columns, is_of_tooth = engagement.angles, flat(tooth) == 0
        slot = np.round(flat(angle) / (2 * np.pi) * columns - 0.5).astype(np.int64)
        element = np.broadcast_to(np.arange(height.size), slot.shape)
        at = (element[is_of_tooth], slot[is_of_tooth] % columns)
        chart, share = np.zeros((2, height.size, columns))
        chart[at] = flat(chip)[is_of_tooth]
        share[at] = flat(weight)[is_of_tooth]
        turn = 2 * np.pi * (np.arange(columns) + 0.5) / columns - _left_of_feed(part)
        turn = (turn + np.pi / 2) % (2 * np.pi) - np.pi / 2
        order = np.argsort(turn)
        return ToothChip(turn[order], height, chart[:, order], share[:, order])

    def _until(self, step: int) -> tuple[Pose, Int[Array, " period"], int]:
        """Return the path up to a step, of one of few lengths, for one program.

        Before its first pose the tool stands there, in periods that are not run.

        Returns:
            The path, the number of each of its periods, and how many of the last ones
            make a revolution.
        """
        total = padded_count(self.path.tip.shape[0])
        rows = np.arange(total) - (total - 1 - step)
        at = np.maximum(rows, 0)
        path = jax.tree.map(lambda x: on_device(np.asarray(x)[at]), self.path)
        count = min(self.process.cutter.flute_count, step)
        return path, on_device(rows[1:].astype(np.int32)), count


def _actual_poses(job: Job, solution: Solution) -> Pose:
    """Return the poses at the tooth instants, without an axis where it is always +z."""
    tips = jnp.asarray(solution.actual)
    if job.robot is None or solution.joint_positions is None:
        return Pose.along(tips, job.tool_axes)
    if not job.simulation.axes:
        return Pose(tips)
    frame = jnp.asarray(job.T_base_work, tips.dtype)
    joints = jnp.asarray(solution.joint_positions)
    return Pose(tips, joint_poses(job.robot, frame, joints, False).axis)


def _left_of_feed(path: Pose) -> float:
    """Return the immersion angle on the left of the feed at the end of a path [rad]."""
    frame = np.asarray(Pose.frame(path[-1].direction()), np.float64)
    feed = (np.asarray(path.tip[-1] - path.tip[-2], np.float64)) @ frame
    return float(np.arctan2(feed[0], feed[1])) - np.pi / 2


@CompiledOnce
def _last_periods(
    process: Process, path: Pose, index: Int[Array, " all"], count: int
) -> tuple[
    Float[Array, "period substep angle kept disc"],
    Int[Array, "period substep angle kept disc"],
    Float[Array, "period substep angle kept element"],
    Float[Array, "period substep angle kept element"],
]:
    """Return angle, tooth, chip in the stock and occupancy in the last periods."""
    engagement, rows = process.engagement, path.tip.shape[0]
    state, _ = process.begin(path[0], rows)

    def period(
        state: ProcessState, x: tuple[Array, Pose, Pose, Pose]
    ) -> tuple[ProcessState, tuple[Engagement, Array]]:
        index, start, poses, ends = x
        state, cut, _ = process.advance(state, index, start, poses)
        chip = jax.vmap(
            lambda samples, pose, earlier: engagement.chip(
                process, samples, pose, earlier, cut.thinned
            ),
            in_axes=(0, 0, 1),
        )(cut.samples, poses, state.recent)
        chip = jnp.clip(chip, 0, process.cutter.diameter / 2) * cut.samples.chip_share
        return state.ended(poses, ends), (cut, chip)

    within = process.poses_within(path)
    xs = (index, path[:-1], within.middles, within.ends)
    at = lambda row: jax.tree.map(lambda x: x[row], xs)
    empty = jax.tree.map(
        lambda x: jnp.zeros((count, *x.shape), x.dtype),
        eqx.filter_eval_shape(lambda: period(state, at(0))[1]),
    )

    # One body for all periods, the last ones too, is compiled once.
    def run(row: Int[Array, ""], carry: Any) -> Any:
        state, kept = carry
        state, found = period(state, at(row))
        return state, jax.tree.map(
            lambda rows, x: rows.at[jnp.mod(row, count)].set(x), kept, found
        )

    # A period ends at its number: those up to 0 end where the tool stands at first.
    standing = jnp.sum(index < 1).astype(jnp.int32)
    end = jnp.asarray(index.shape[0], jnp.int32)
    _, kept = jax.lax.fori_loop(standing, end, run, (state, empty))
    oldest = index.shape[0] % count
    cut, chip = jax.tree.map(lambda x: jnp.roll(x, -oldest, axis=0), kept)
    samples = cut.samples
    return samples.angle, samples.tooth, chip, samples.occupancy
