"""The process of a solution once more, for whoever looks at it closer.

Where the tool was and how it leaned, how finely the process is computed and the laws of
both edges are those of the run. Only the robot is left out: between the tooth instants
the tool goes along a smooth curve through them.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._job import Job
from ...process import (
    EdgeElementsInSpace,
    Engagement,
    Process,
    ProcessState,
    ThroughRays,
    advance_process,
    initial_state,
    poses_within,
)
from ...workpiece import Pose, tool_frame
from .._analysis.stability import joint_poses
from .._machine.commands import path_axes
from .._machine.machine import Run, run
from .._machine.rigid import Rigid
from .simulate import Solution, job_process, with_precision


def actual_poses(job: Job, solution: Solution) -> Pose:
    """Return the poses of the tool in `work` at the tooth instants, shape (step, 3).

    Args:
        job: The job.
        solution: Its solution.

    Returns:
        The poses; without an axis where the tool stands along +z all the time.
    """
    tips = jnp.asarray(solution.actual)
    if job.robot is None or solution.joint_positions is None:
        return Pose.along(tips, path_axes(job))
    if not job.simulation.axes:
        return Pose(tips)
    frame = jnp.asarray(job.T_base_work, tips.dtype)
    joints = jnp.asarray(solution.joint_positions)
    return Pose(tips, joint_poses(job.robot, frame, joints, False).axis)


def replay_process(job: Job, solution: Solution) -> Run:
    """Return the process of a solution with the force at every angle sample.

    Args:
        job: The job.
        solution: Its solution.

    Returns:
        The process along the actual poses. Check `.result`.
    """
    job = with_precision(job)
    return _replay(job, actual_poses(job, solution))


@eqx.filter_jit
def _replay(job: Job, poses: Pose) -> Run:
    process = job_process(job, ThroughRays())
    return run(Rigid(keeps_instantaneous=True), process, poses)


class ToothChip(eqx.Module):
    """The chip that one tooth meets in a revolution, on the host.

    Attributes:
        angle: Immersion angle of the samples [rad], shape (sample, element).
        chip_thickness: Chip thickness h in the stock [m], same shape.
        weight: Fraction of the sample that is in stock, from 0 to 1, same shape.
        is_of_tooth: Which samples are the tooth's, same shape.
        height: Height of each edge element above the tip [m], shape (element,).
        feed_angle: Direction of the feed, from tool y clockwise [rad].
    """

    angle: Float[np.ndarray, "sample element"]
    chip_thickness: Float[np.ndarray, "sample element"]
    weight: Float[np.ndarray, "sample element"]
    is_of_tooth: Bool[np.ndarray, "sample element"]
    height: Float[np.ndarray, " element"]
    feed_angle: float


def tooth_chip(process: Process, path: Pose, *, step: int) -> ToothChip:
    """Return the chip that tooth 0 meets in the revolution that ends at a step.

    The process runs along the path up to there, without forces.

    Args:
        process: The process.
        path: Poses at the tooth instants in `work`, shape (step, 3).
        step: Row of the path at which the revolution ends, from 1; near the start of
            the path the revolution is not whole.

    Returns:
        The chip on the edge, without the flat end of the tool.

    Raises:
        ValueError: If there is no such step.
    """
    rows = path.tip.shape[0]
    if not 1 <= step < rows:
        raise ValueError(
            f"Argument `step` must lie between 1 and {rows - 1}, but is {step}."
        )
    part = path[: step + 1]
    engagement, cutter = process.engagement, process.cutter
    found = _last_periods(process, part, min(cutter.flute_count, step))
    angle, tooth, chip, weight = (np.asarray(x, np.float64) for x in found)
    shape = weight.shape
    is_row = isinstance(engagement, EdgeElementsInSpace)
    first = engagement.profile.bottom if is_row else 0
    flat = lambda x: np.broadcast_to(x, shape).reshape(-1, shape[-1])[:, first:]
    height = engagement.element_heights(cutter, part.tip.dtype)
    height = np.asarray(height, np.float64)
    frame = np.asarray(tool_frame(part[-1].direction()), np.float64)
    feed = (np.asarray(part.tip[-1] - part.tip[-2], np.float64)) @ frame
    return ToothChip(
        angle=flat(angle),
        chip_thickness=flat(chip),
        weight=flat(weight),
        is_of_tooth=flat(tooth) == 0,
        height=height[first:],
        feed_angle=float(np.arctan2(feed[0], feed[1])),
    )


@eqx.filter_jit
def _last_periods(
    process: Process, path: Pose, count: int
) -> tuple[
    Float[Array, "period substep angle kept disc"],
    Int[Array, "period substep angle kept disc"],
    Float[Array, "period substep angle kept element"],
    Float[Array, "period substep angle kept element"],
]:
    """Return angle, tooth, chip in the stock and occupancy in the last periods."""
    engagement, rows = process.engagement, path.tip.shape[0]
    state, _ = initial_state(process, path[0], rows)

    def period(
        state: ProcessState, x: tuple[Array, Pose, Pose, Pose]
    ) -> tuple[ProcessState, tuple[Engagement, Array]]:
        index, start, poses, ends = x
        state, cut, _ = advance_process(process, state, index, start, poses)
        chip = jax.vmap(
            lambda samples, pose, earlier: engagement.chip(
                process, samples, pose, earlier, cut.thinned
            ),
            in_axes=(0, 0, 1),
        )(cut.samples, poses, state.recent)
        chip = jnp.clip(chip, 0, process.cutter.diameter / 2) * cut.samples.chip_share
        return state.ended(poses, ends), (cut, chip)

    index = jnp.arange(1, rows, dtype=jnp.int32)
    n = engagement.substeps
    within = poses_within(n, path)
    xs = (index, path[:-1], within.middles, within.ends)
    before = jax.tree.map(lambda x: x[:-count], xs)
    last = jax.tree.map(lambda x: x[-count:], xs)
    state, _ = jax.lax.scan(lambda s, x: (period(s, x)[0], None), state, before)
    _, (cut, chip) = jax.lax.scan(period, state, last)
    samples = cut.samples
    return samples.angle, samples.tooth, chip, samples.occupancy
