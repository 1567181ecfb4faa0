"""Jobs whose path is long, run in segments."""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, PyTree

from ..._arrays import is_traced, on_device
from ..._padding import LONGEST, whole_parts
from ..._types import FloatRows, FloatRows3
from ...numerics import CachedJit
from ...robot import Controller
from ...toolpath import Path
from ...workpiece import Pose, Stock
from .._machine.machine import AbstractMachine, Run, RunSegment
from .._machine.rigid import PathPiece, Rigid
from .segments import MoreSlots, PathSegment, SegmentedRun, Segments, run_in_segments
from .walls import WallRows, Walls

if TYPE_CHECKING:
    from .simulate import MachiningProblem


class Followed(NamedTuple):
    """Run of a command, its walls, and the motion of its motors.

    Attributes:
        run: The run.
        walls: Its walls.
        motors: As `Solution.motor_positions`.
    """

    run: Run
    walls: Walls
    motors: FloatRows | None


class SegmentPlan(NamedTuple):
    """Plan of a run in segments, for a path that is long.

    Attributes:
        periods: Tooth periods of a segment, in whole parts of `scan_rows`; a path of at
            most so many rows is run whole.
        on_rows: Called after each segment with the number of rows done.
        more_slots: As of `run_in_segments`.
    """

    periods: int = LONGEST
    on_rows: Callable[[int], None] = lambda count: None
    more_slots: MoreSlots = lambda counts: None

    def suits(self, path: Path, given: object) -> bool:
        """True if a path is run in segments: a long one, of which nothing is traced.

        Args:
            path: The path.
            given: All that its run depends on.
        """
        is_padded = path.row_count is not None
        return path.step_count > self.periods and not (is_padded or is_traced(given))


class LongRun(NamedTuple):
    """A problem that is run in segments.

    Attributes:
        problem: The problem, its path as long as it is.
        plan: How it is run.
    """

    problem: "MachiningProblem"
    plan: SegmentPlan

    def cut(self, tips: FloatRows3, chip_row: int = 0) -> Run:
        """Run of a rigid machine, whose tips are kept at the tooth instants alone.

        Args:
            tips: Tips at the rows of the path, or at its first rows [m], shape (step,
                3).
            chip_row: Row at which the revolution ends whose chips are kept.
        """
        machine = Rigid(chip_row=on_device(np.asarray(chip_row, np.int32)))
        tips, axes = np.asarray(tips), self.problem.axes
        axes = None if axes is None else np.asarray(axes)
        force, force_range = _no_force(tips)
        ran = self._run(
            machine,
            len(tips),
            lambda segment: _path_piece(tips, axes, segment),
            lambda segment, ran: segment.put(
                (force, force_range), (ran.force, ran.force_range)
            ),
        )
        return self._whole(ran, (tips, tips[:, None], force, force_range, None))

    def follow(
        self, finished: Stock, tips: FloatRows3, motors: FloatRows | None
    ) -> Followed:
        """Run of a command against what a rigid cut leaves.

        Args:
            finished: Stock that the rigid cut leaves.
            tips: Commanded tips [m], shape (step, 3).
            motors: The motors' positions for them; None for a rigid machine.
        """
        problem, tips = self.problem, np.asarray(tips)
        if problem.machine is None:
            run, told = self.cut(tips), None
        else:
            assert motors is not None and problem.kinematics is not None
            told, is_arm = np.array(motors), problem.kinematics.arm is not None
            commands = _commands(problem, np.asarray(motors))
            substeps = problem.process.engagement.substeps
            rows = (
                np.zeros_like(tips),
                np.zeros((len(tips), substeps, 3), tips.dtype),
                *_no_force(tips),
                np.zeros_like(told) if is_arm else None,
            )

            def command(segment: PathSegment) -> Float[Array, "row axis"]:
                segment.put(told, command := commands(segment))
                return command

            def take(segment: PathSegment, ran: RunSegment) -> None:
                force = ran.force, ran.force_range
                segment.put(rows, (ran.actual, ran.ends, *force, ran.joint_positions))

            ran = self._run(problem.machine, len(tips), command, take)
            run = self._whole(ran, rows)
            told = told if is_arm else None
        path = problem.path
        walls = WallRows(path.positions, problem.axes, path.disturbance, run.ends)
        walls = walls.long_walls(
            problem.process.cutter, finished, self._segments(len(tips))
        )
        return Followed(run, walls, told)

    def _segments(self, row_count: int) -> Segments:
        """Segments of a path of so many rows."""
        return Segments(row_count, whole_parts(self.plan.periods) + 1)

    def _run(
        self,
        machine: AbstractMachine,
        row_count: int,
        command: Callable[[PathSegment], PyTree],
        take: Callable[[PathSegment, RunSegment], None],
    ) -> SegmentedRun:
        """Run of a machine in the segments, as `run_in_segments`."""

        def took(segment: PathSegment, ran: RunSegment) -> None:
            take(segment, ran)
            self.plan.on_rows(segment.first + segment.row_count)

        process, segments = self.problem.process, self._segments(row_count)
        more_slots = self.plan.more_slots
        return run_in_segments(machine, process, segments, command, took, more_slots)

    def _whole(self, ran: SegmentedRun, rows: PyTree) -> Run:
        """The run with its rows: tips, ends, forces, their range, and joints."""
        actual, ends, force, force_range, joints = jax.tree.map(on_device, rows)
        period = float(self.problem.process.tooth_period)
        return Run(
            time=on_device(period * np.arange(len(actual), dtype=actual.dtype)),
            actual=actual,
            ends=ends,
            force=force,
            force_range=force_range,
            joint_positions=joints,
            initial_overlap_volume=ran.initial_overlap_volume,
            removal=ran.removal,
            chips=ran.chips,
        )


def _no_force(
    tips: Float[np.ndarray, "step 3"],
) -> tuple[Float[np.ndarray, "step 3"], Float[np.ndarray, "step 2 3"]]:
    """Mean forces and their range in all rows, before they are known."""
    return np.zeros_like(tips), np.zeros((len(tips), 2, 3), tips.dtype)


def _path_piece(
    tips: FloatRows3, axes: FloatRows3 | None, segment: PathSegment
) -> PathPiece:
    """Poses of a segment, with those beside it."""

    def rows(path: FloatRows3) -> Float[Array, "row 3"]:
        found = path[segment.rows(1, 1)]
        if segment.first == 0:
            found[0] = 2 * found[1] - found[2]
        return on_device(found)

    goes_on = segment.first + segment.length < segment.total
    count = segment.length + 2 if goes_on else segment.row_count + 1
    number = lambda x: on_device(np.asarray(x, np.int32))
    poses = Pose(rows(tips), None if axes is None else rows(axes))
    return PathPiece(poses, number(count), number(segment.first))


def _commands(
    problem: "MachiningProblem", motors: Float[np.ndarray, "step axis"]
) -> Callable[[PathSegment], Float[Array, "row axis"]]:
    """Motors of one segment after the other, as the controller lets them move."""
    controller = problem.controller
    if controller is None:
        return lambda segment: on_device(motors[segment.rows()])
    T = on_device(np.asarray(problem.process.tooth_period))
    span, state = controller.span(T), None

    def follow(segment: PathSegment) -> Float[Array, "row axis"]:
        nonlocal state
        rows = on_device(motors[segment.rows(behind=span.ahead)])
        if state is None:
            state = _begin_control(controller, rows, T, span.before, span.ahead)
        followed, state = _control(controller, rows, T, state)
        return followed

    return follow


@CachedJit
def _begin_control(
    controller: Controller,
    commands: Float[Array, "told axis"],
    period: Float[Array, ""],
    before: int,
    ahead: int,
) -> PyTree:
    return controller.begin(commands, period, before, ahead)


@CachedJit
def _control(
    controller: Controller,
    commands: Float[Array, "told axis"],
    period: Float[Array, ""],
    state: PyTree,
) -> tuple[Float[Array, "row axis"], PyTree]:
    followed = controller.follow(commands, period, state)
    return followed.motors, followed.state
