"""Jobs whose path is long, run in segments."""

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, PyTree

from ..._arrays import on_device
from ..._types import FloatRows, FloatRows3, FloatSteps
from ...numerics import CachedJit
from ...robot import Controller
from ...workpiece import Pose, Stock
from .._machine.machine import AbstractMachine, EngagementUpdates, Run, RunSegment
from .._machine.rigid import PathPiece, Rigid
from .path_segments import PathSegment
from .segments import PathRows, SegmentedRun, SegmentPlan, run_in_segments
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
        none = _no_loads(tips)
        rows = PathRows(
            lambda segment, _: (_path_piece(tips, axes, segment), None),
            none,
            lambda told, ran: _loads(ran),
            tips,
        )
        ran = self._run(machine, len(tips), rows)
        return self._whole(ran, (tips, tips[:, None], *none, None))

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
            is_arm = problem.kinematics.arm is not None
            substeps = problem.process.engagement.substeps
            rows = (
                np.zeros_like(tips),
                np.zeros((len(tips), substeps, 3), tips.dtype),
                *_no_loads(tips),
                np.zeros_like(motors) if is_arm else None,
            )
            told, updates = np.array(motors), None
            if self.plan.is_adaptive:
                updates = EngagementUpdates.none(len(tips), tips.dtype)

            def of_segment(command: PyTree, ran: RunSegment) -> PyTree:
                out = ran.actual, ran.ends, *_loads(ran), ran.joint_positions
                return out, command, ran.engagement_updates

            command = _commands(problem, np.asarray(motors))
            path_rows = PathRows(command, (rows, told, updates), of_segment, tips)
            run = self._whole(self._run(problem.machine, len(tips), path_rows), rows)
            run = dataclasses.replace(run, engagement_updates=updates)
            told = told if is_arm else None
        path = problem.path
        walls = WallRows(path.positions, problem.axes, path.disturbance, run.ends)
        walls = walls.long_walls(
            problem.process.cutter, finished, self.plan.segments(len(tips))
        )
        return Followed(run, walls, told)

    def _run(
        self, machine: AbstractMachine, row_count: int, rows: PathRows
    ) -> SegmentedRun:
        """Run of a machine in the segments, as `run_in_segments`."""
        segments = self.plan.segments(row_count)
        return run_in_segments(machine, self.problem.process, segments, rows, self.plan)

    def _whole(self, ran: SegmentedRun, rows: PyTree) -> Run:
        """The run with its rows: tips, ends, `_loads`, and joints."""
        rows = jax.tree.map(on_device, rows)
        actual, ends, force, force_range, torque, joints = rows
        period = float(self.problem.process.tooth_period)
        return Run(
            time=on_device(period * np.arange(len(actual), dtype=actual.dtype)),
            actual=actual,
            ends=ends,
            force=force,
            force_range=force_range,
            spindle_torque=torque,
            joint_positions=joints,
            initial_overlap_volume=ran.initial_overlap_volume,
            removal=ran.removal,
            chips=ran.chips,
        )


class _Loads(NamedTuple):
    """Loads of the tool in some rows, as of `Run`."""

    force: FloatRows3
    force_range: Float[Array, "step 2 3"] | Float[np.ndarray, "step 2 3"]
    spindle_torque: FloatSteps


def _loads(ran: RunSegment) -> _Loads:
    """Loads in the rows of a segment."""
    return _Loads(ran.force, ran.force_range, ran.spindle_torque)


def _no_loads(tips: Float[np.ndarray, "step 3"]) -> _Loads:
    """Loads in all rows, before they are known."""
    ranges = np.zeros((len(tips), 2, 3), tips.dtype)
    return _Loads(np.zeros_like(tips), ranges, np.zeros(len(tips), tips.dtype))


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
) -> Callable[[PathSegment, PyTree], tuple[Float[Array, "row axis"], PyTree]]:
    """Motors in a segment and the controller's state behind it, from that before."""
    controller = problem.controller
    if controller is None:
        return lambda segment, _: (on_device(motors[segment.rows()]), None)
    T = on_device(np.asarray(problem.process.tooth_period))
    span = controller.span(T)

    def follow(
        segment: PathSegment, state: PyTree
    ) -> tuple[Float[Array, "row axis"], PyTree]:
        rows = on_device(motors[segment.rows(behind=span.ahead)])
        if state is None:
            state = _begin_control(controller, rows, T, span.before, span.ahead)
        return _control(controller, rows, T, state)

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
