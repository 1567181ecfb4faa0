"""Machines that the loads of the teeth deflect, and those that take sub-steps.

In each sub-step the teeth push with the force F at the tip where the machine is in the
middle of the sub-step. Machines differ in how a tooth period is prepared
(`AbstractInertialMachine.dynamics`) and in how the machine moves in it
(`AbstractPeriodDynamics` of `coupled_period.py`, which takes the sub-steps).
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from ..._padding import if_valid
from ..._types import IntScalar
from ...process import Process
from ...workpiece import Pose
from .coupled_period import AbstractPeriodDynamics, CoupledPeriod, along
from .machine import (
    AbstractMachine,
    Period,
    PeriodRow,
    RunState,
    StockAccess,
)


class CommandRow(eqx.Module):
    """The command in one tooth period, or in all.

    Attributes:
        start: At its start: motors theta [rad or m], or a pose, shape (*period, axis).
        stop: At its end, same shape.
    """

    start: Float[Array, "*period axis"]
    stop: Float[Array, "*period axis"]


class PeriodMotion(eqx.Module):
    """Motion of a machine in a period whose loads are known.

    Attributes:
        end: The machine's state at the end.
        pose: At the start.
        middles: Poses in the middle of the sub-steps, shape (substep, 3).
        ends: Tips at their ends [m], shape (substep, 3).
        predicted: Poses at which the stock is looked up, shape (substep, 3); None where
            they follow from the period before and the tips so far.
    """

    end: PyTree
    pose: Pose
    middles: Pose
    ends: Float[Array, "substep 3"]
    predicted: Pose | None


class AbstractCompliant(AbstractMachine):
    """A machine that the loads of the sub-steps deflect."""

    @property
    @abc.abstractmethod
    def load_count(self) -> int:
        """Numbers of a load: 3 for a force, 6 with its moment."""

    def rows(
        self,
        process: Process,
        command: Float[Array, "step axis"],
        row_count: IntScalar | None,
    ) -> CommandRow:
        """Command at both ends of every period, behind the gears."""
        del process, row_count
        command = self.transmitted(command)
        return CommandRow(command[:-1], command[1:])

    def transmitted(
        self, command: Float[Array, "step axis"]
    ) -> Float[Array, "step axis"]:
        """Command as the gears transmit it without load: as it is."""
        return command

    @abc.abstractmethod
    def motion(
        self,
        process: Process,
        state: PyTree,
        row: CommandRow,
        loads: Float[Array, "substep load"],
    ) -> PeriodMotion:
        """Motion in a period, from its loads.

        Args:
            process: The process, of which tooth period and sub-steps count.
            state: The machine's, at the start.
            row: The command.
            loads: Loads of the sub-steps in `work` [N], [N m], shape (substep, load).
        """


class AbstractInertialMachine(AbstractCompliant):
    """A machine with inertia; it takes sub-steps."""

    @abc.abstractmethod
    def dynamics(
        self, process: Process, state: PyTree, row: CommandRow
    ) -> AbstractPeriodDynamics:
        """The machine in a period, from its state and the command of that.

        Args:
            process: The process, of which tooth period and sub-steps count.
            state: The machine's, at the start.
            row: The command.
        """

    def period(
        self,
        process: Process,
        state: RunState,
        row: PeriodRow,
        access: StockAccess = StockAccess(),
    ) -> tuple[RunState, Period]:
        """State after one tooth period, and its outputs.

            p = pose(x_{k-1})
            S_k = S_{k-1} less the poses that lag behind p
            E_k = engagement of S_k at the predicted poses
            x_k = f(x_{k-1}, theta, F(E_k, tips)), sub-step after sub-step

        # symbols: k period, x machine, p tool at its start, S stock, E engagement of
        the teeth, F load of a sub-step, theta command
        """
        dynamics = self.dynamics(process, state.machine, row.command)
        pose, recent = dynamics.pose, state.process.recent
        # As in the period before: what the teeth do comes again, and drifts are slow.
        drift = (pose.tip - state.process.last_tip)[None]
        predicted = along(pose, recent.tip[0] + drift)
        cutting, removed = access.remove(process, state.process, row.period - 1, pose)
        coupled = CoupledPeriod(process, dynamics, self.load_count)
        times = process.tooth_period * process.substep_middles(predicted.tip.dtype)
        rows, cut = coupled.rows(times, recent), None
        if process.engagement.updates_per_period > 1:
            look_up = lambda recent, predicted, part: process.engage(
                eqx.tree_at(lambda p: p.recent, cutting, recent),
                row.period,
                predicted,
                part,
            )
            move = lambda: coupled.run_with_updates(
                look_up, state.machine, rows, recent, drift
            )
        else:
            cut = access.engage(process, cutting, row, predicted)
            move = lambda: coupled.run(state.machine, rows, predicted, cut)
        still = state.machine, coupled.standstill(predicted)
        end, substeps = if_valid(row.is_live, move, still)
        cutting = cutting.ended(along(pose, substeps.tips), along(pose, substeps.ends))
        return RunState(cutting, end, state.period_count), Period(
            tip=pose.tip,
            ends=substeps.ends,
            force=jnp.mean(substeps.loads[:, :3], axis=0),
            force_range=substeps.whole_range(),
            spindle_torque=jnp.mean(substeps.spindle_torque),
            joint_positions=self.joint_positions(state.machine),
            removed=removed,
            has_failed=cutting.has_failed,
            substeps=substeps,
            engagement=cut,
        )

    def motion(
        self,
        process: Process,
        state: PyTree,
        row: CommandRow,
        loads: Float[Array, "substep load"],
    ) -> PeriodMotion:
        """Motion in a period, from its loads."""
        dynamics = self.dynamics(process, state, row)
        times = process.tooth_period * process.substep_middles(loads.dtype)

        def substep(state, row):
            time, load = row
            middle = dynamics.middle(state, time)
            end = dynamics.step(state, time, load)
            return end, (middle, dynamics.tip(end))

        end, (middles, ends) = jax.lax.scan(substep, state, (times, loads))
        return PeriodMotion(
            end, dynamics.pose, along(dynamics.pose, middles), ends, None
        )


def start_rate(
    command: Float[Array, "step axis"], period: Float[Array, ""]
) -> Float[Array, " axis"]:
    """Rate of a command at the first instant.

    By the parabola through three instants: the mean speed of the first period alone
    would let a machine that starts from rest begin in motion.
    """
    rise = command[1] - command[0]
    if command.shape[0] > 2:
        rise = rise - (command[2] - 2 * command[1] + command[0]) / 2
    return rise / period
