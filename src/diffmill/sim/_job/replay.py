"""The process of a solution once more, for whoever looks closer at a few periods.

Where the tool was and how it leaned, how finely the process is computed and the laws of
both edges are those of the run. Only the robot is left out: between the tooth instants
the tool goes along a smooth curve through them.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..._job import Job
from ...process import EdgeElementsInSpace, FrozenStock, Process
from ...workpiece import Pose
from .._analysis.stability import joint_poses
from .._machine.machine import Run
from .._machine.rigid import Rigid, recorded_periods
from .simulate import Solution, job_process, rigid_cut

# A sample so near to the border of two angles counts as beyond it [samples].
_NEAR_BORDER = 1e-6


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
    """A process that ran once more, along poses that are known, up to some row.

    Attributes:
        process: The process.
        path: Poses at the tooth instants in `work`, shape (step, 3).
        chip_row: Row of the path at which the periods end that are kept: a revolution,
            and at least six.
        run: What the process did up to there; check `.result`.
    """

    process: Process
    path: Pose
    chip_row: int = eqx.field(static=True)
    run: Run

    @classmethod
    def of_solution(cls, job: Job, solution: Solution, chip_row: int = 1) -> "Replay":
        """Run the process of a solution along its actual poses.

        Args:
            job: The job.
            solution: Its solution.
            chip_row: As of `along`.

        Returns:
            What it did, by the program of the rigid cut.

        Raises:
            ValueError: If there is no such row.
        """
        job = job.with_precision()
        path = _actual_poses(job, solution)
        _check_row(chip_row, path)
        run = rigid_cut(job, FrozenStock(), along=path, chip_row=chip_row)
        return cls(job_process(job, FrozenStock()), path, chip_row, run)

    @classmethod
    def along(cls, process: Process, path: Pose, chip_row: int) -> "Replay":
        """Run a process along a path.

        Args:
            process: The process.
            path: Poses at the tooth instants in `work`, shape (step, 3).
            chip_row: Row of the path at which the revolution ends whose chips are
                kept, from 1; near the start the revolution is not whole.

        Raises:
            ValueError: If there is no such row.
        """
        _check_row(chip_row, path)
        machine = Rigid(chip_row=jnp.asarray(chip_row, jnp.int32))
        return cls(process, path, chip_row, machine.run(process, path))

    @property
    def rows(self) -> range:
        """Rows at which the periods end that are kept."""
        kept = recorded_periods(self.process)
        return range(max(1, self.chip_row + 1 - kept), self.chip_row + 1)

    def forces(self) -> Float[np.ndarray, "row sample 3"]:
        """Force on the tool at every angle of the periods before `rows` [N].

        Sample j of n is that at the share (j + 1/2) / n of the period.
        """
        assert self.run.chips is not None
        at = np.array(self.rows) % recorded_periods(self.process)
        return np.asarray(self.run.chips.force)[at]

    def tooth_chip(self) -> ToothChip:
        """Return the chip that one tooth met in the revolution that is kept.

        It is the tooth that stands behind the tool when the revolution begins, and so
        cuts in one go: what the others met is of two passes.

        Returns:
            The chip on the edge, without the flat end of the tool. Angles of a helical
            cutter are true to half a sample.
        """
        # Rows that are taken on the host compile nothing.
        part = jax.tree.map(np.asarray, self.path)[: self.chip_row + 1]
        engagement = self.process.engagement
        teeth, kept = self.process.cutter.flute_count, self.run.chips
        assert kept is not None
        last = np.arange(max(1, self.chip_row + 1 - teeth), self.chip_row + 1)
        angle, tooth, chip, weight = (
            np.asarray(x, np.float64)[last % recorded_periods(self.process)]
            for x in (kept.angle, kept.tooth, kept.chip, kept.weight)
        )
        shape = weight.shape
        is_row = isinstance(engagement, EdgeElementsInSpace)
        first = engagement.profile.bottom if is_row else 0
        flat = lambda x: np.broadcast_to(x, shape).reshape(-1, shape[-1])[:, first:]
        heights = eqx.filter_jit(engagement.element_heights)
        height = heights(self.process.cutter, part.tip.dtype)
        height = np.asarray(height, np.float64)[first:]
        left = _feed_normal_angle(part)
        starts = 2 * np.pi / teeth * (np.arange(teeth) + last[0] - 1) - left
        behind = int(np.argmin(np.sin(starts)))
        columns, is_of_tooth = engagement.angles, flat(tooth) == behind
        # A helix may hold samples back by half of one: chance must not part them.
        turns = flat(angle) / (2 * np.pi)
        slot = np.floor(turns * columns + _NEAR_BORDER).astype(np.int64)
        element = np.broadcast_to(np.arange(height.size), slot.shape)
        at = (element[is_of_tooth], slot[is_of_tooth] % columns)
        chart, share = np.zeros((2, height.size, columns))
        chart[at] = flat(chip)[is_of_tooth]
        share[at] = flat(weight)[is_of_tooth]
        turn = 2 * np.pi * (np.arange(columns) + 0.5) / columns - left
        turn = (turn + np.pi / 2) % (2 * np.pi) - np.pi / 2
        order = np.argsort(turn)
        return ToothChip(turn[order], height, chart[:, order], share[:, order])


def _check_row(chip_row: int, path: Pose) -> None:
    rows = path.tip.shape[0]
    if not 1 <= chip_row < rows:
        raise ValueError(
            f"Argument `chip_row` must lie between 1 and {rows - 1}, but is {chip_row}."
        )


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


def _feed_normal_angle(path: Pose) -> float:
    """Return the immersion angle on the left of the feed at the end of a path [rad]."""
    feed = np.asarray(path.tip[-1] - path.tip[-2], np.float64)
    if path.axis is not None:
        feed = feed @ np.asarray(Pose.frame(path.axis[-1]), np.float64)
    return float(np.arctan2(feed[0], feed[1])) - np.pi / 2
