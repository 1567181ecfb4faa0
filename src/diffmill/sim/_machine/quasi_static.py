"""The robot without inertia: in every tooth period springs balance the mean force.

    K (theta - q) = G(q) - J^T F,    F = mean force of the period on the tip path,

where the tip moves evenly from the balance at the start to the balance at the end.
The force depends on the tip by the chip, so F solves F = f(F); with f' = A C (A slope
of the mean force over the tip, C compliance of the tip) the Newton step

    (I - A C) dF = f(F) - F

is taken twice from the force of the period before: the second is at rounding unless a
chip begins or ends. A plain iteration F <- f(F) would diverge for |A C| > 1, a deep cut
with a soft arm. A cut resists its tool, so -A C has eigenvalues with positive real part
and the step exists; from period to period a disturbance then dies out. Where the
coupling of the directions brings an eigenvalue of A C to 1, the arm is dragged into the
cut without bound and no balance exists: the result is not meaningful there.

What a real arm adds is left out: swinging at corners, forced vibration and chatter.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..._live_rows import when_live
from ..._types import IntScalar, Transform
from ...process import (
    Process,
)
from ...robot import ArmTerms, Robot, loaded_equilibrium
from ...workpiece import Pose
from .elastic import in_work, jacobian_in_work
from .machine import AbstractMachine, Period, RunState
from .rigid import period_wrench
from .substeps import CommandRow, along

_NEWTON_STEPS = 2


class Balance(eqx.Module):
    """The arm at one instant: joints, pose in `work`, and load on the tool."""

    q: Float[Array, " joint"]
    pose: Pose
    load: Float[Array, " load"]


class QuasiStaticArm(AbstractMachine):
    """A robot without inertia, which bends under its weight and the cut.

    Its command are its motors' positions; time does not matter.

    Attributes:
        robot: The robot with its tool; its damping is not used.
        T_base_work: Pose of the workpiece frame in the robot's base, shape (4, 4).
    """

    robot: Robot
    T_base_work: Transform

    def begin(self, process: Process, command: Float[Array, "step joint"]) -> Balance:
        """Return the balance with gravity at the first instant."""
        q = loaded_equilibrium(self.robot, command[0])
        pose, J, _ = self._linear(process, q)
        return Balance(q, pose, jnp.zeros(J.shape[0], command.dtype))

    def rows(
        self,
        process: Process,
        command: Float[Array, "step joint"],
        row_count: IntScalar | None,
    ) -> CommandRow:
        """Return the motors at both ends of every period."""
        del process, row_count
        return CommandRow(command[:-1], command[1:])

    def pose(self, process: Process, state: Balance) -> Pose:
        """Return the tool's pose in `work`."""
        del process
        return state.pose

    def joint_positions(self, state: Balance) -> Float[Array, " joint"]:
        """Return the joint positions [rad or m]."""
        return state.q

    def period(
        self,
        process: Process,
        state: RunState,
        index: Int[Array, ""],
        row: CommandRow,
        is_live: Bool[Array, ""] | None,
    ) -> tuple[RunState, Period]:
        """Return the state after one tooth period, and its outputs."""
        start, stop, dtype = state.machine, row.stop, row.stop.dtype
        # The end is near to the start moved along with the motors: linear from there.
        near = start.q + stop - row.start
        pose, jacobian, gravity = self._linear(process, near)
        joints = lambda F: stop - self.robot.drive_deflection(gravity - jacobian.T @ F)
        tip = lambda F: pose.tip + jacobian[:3] @ (joints(F) - near)

        middles, last = process.substep_middles(dtype), process.substep_ends(dtype)

        def tips(F: Array, places: Array) -> Array:
            shares = places[:, None]
            return start.pose.tip[None] * (1 - shares) + tip(F)[None] * shares

        predicted = along(pose, tips(start.load, middles))
        cutting, cut, removed = process.advance(
            state.process, index, start.pose, predicted, is_live
        )
        size, recent = start.load.size, cutting.recent
        eye = jnp.eye(size, dtype=dtype)

        def mean(F: Array) -> Array:
            found = period_wrench(process, cut, along(pose, tips(F, middles)), recent)
            return jnp.mean(found, axis=0)[:size]

        def newton(F: Array, _: None) -> tuple[Array, None]:
            # One pass gives value and slope: the force beside each column is the same.
            value_and_slope = lambda way: jax.jvp(mean, (F,), (way,))
            found, columns = jax.vmap(value_and_slope)(eye)
            return F + jnp.linalg.solve(eye - columns.T, found[0] - F), None

        def balance() -> Balance:
            load, _ = jax.lax.scan(newton, start.load, length=_NEWTON_STEPS)
            return Balance(joints(load), Pose(tip(load), pose.axis), load)

        end = when_live(is_live, balance, start)
        ends = tips(end.load, last)
        cutting = cutting.ended(along(pose, tips(end.load, middles)), along(pose, ends))
        return RunState(cutting, end, state.period_count), Period(
            tip=start.pose.tip,
            ends=ends,
            force=end.load[:3],
            joint_positions=start.q,
            removed=removed,
            has_failed=cutting.has_overflow | cutting.is_beyond,
        )

    def _linear(
        self, process: Process, q: Float[Array, " joint"]
    ) -> tuple[Pose, Float[Array, "load joint"], Float[Array, " joint"]]:
        """Return pose and Jacobian of the tip in `work`, and the torques of gravity."""
        terms = ArmTerms.of_state(self.robot, q, jnp.zeros_like(q))
        J = jacobian_in_work(self.T_base_work, terms.jacobian)
        is_upright = process.engagement.is_upright
        pose = in_work(self.T_base_work, terms.T_base_tool, is_upright)
        # Only on a bending tool the height at which a force acts counts for anything.
        return pose, J if self.robot.fast_joints else J[:3], terms.bias_forces
