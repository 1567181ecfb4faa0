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
cut without bound and no balance exists: the result is not meaningful there. Gears with
a gap need more than two steps (`bend.py`).

What a real arm adds is left out: swinging at corners, forced vibration and chatter.
Derivatives are those of the balance, whatever the steps to it.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._padding import if_valid
from ..._types import Transform
from ...process import Process
from ...robot import ArmTerms, Robot, loaded_equilibrium
from ...workpiece import Pose
from .bend import StaticDeflection, StaticEquilibrium, balance_with_gaps
from .compliant import AbstractCompliant, CommandRow, PeriodMotion
from .elastic import in_work, jacobian_in_work
from .machine import (
    LoadedSubsteps,
    Period,
    PeriodRow,
    RunState,
    StockAccess,
)
from .rigid import period_wrench, substep_ranges

_NEWTON_STEPS = 2


class QuasiStaticArm(AbstractCompliant):
    """A robot without inertia, which bends under its weight and the cut.

    Its command are its motors' positions; time does not matter.

    Attributes:
        robot: The robot with its tool; its damping is not used.
        T_base_work: Pose of the workpiece frame in the robot's base, shape (4, 4).
    """

    robot: Robot
    T_base_work: Transform

    def begin(
        self, process: Process, command: Float[Array, "step joint"]
    ) -> StaticEquilibrium:
        """Return the balance with gravity at the first instant."""
        q = loaded_equilibrium(self.robot, self.transmitted(command[:1])[0])
        pose, jacobian, _ = self._linear(process, q)
        return StaticEquilibrium(q, pose, jnp.zeros(len(jacobian), command.dtype))

    def transmitted(
        self, command: Float[Array, "step joint"]
    ) -> Float[Array, "step joint"]:
        """Positions of the gears' output without load [rad or m]."""
        return jax.vmap(self.robot.transmitted)(command)

    def pose(self, process: Process, state: StaticEquilibrium) -> Pose:
        """Return the tool's pose in `work`."""
        del process
        return state.pose

    def joint_positions(self, state: StaticEquilibrium) -> Float[Array, " joint"]:
        """Return the joint positions [rad or m]."""
        return state.q

    @property
    def load_count(self) -> int:
        """Numbers of a load: on a bending tool the height counts at which it acts."""
        return 6 if self.robot.fast_joints else 3

    def period(
        self,
        process: Process,
        state: RunState,
        row: PeriodRow,
        access: StockAccess = StockAccess(),
    ) -> tuple[RunState, Period]:
        """State after one tooth period, and its outputs."""
        start, dtype = state.machine, row.command.stop.dtype
        bend = self._deflection(process, start, row.command)
        middles, last = process.substep_middles(dtype), process.substep_ends(dtype)
        predicted = bend.expected(start.load, middles)
        cutting, removed = access.remove(
            process, state.process, row.period - 1, start.pose
        )
        cut = access.engage(process, cutting, row, predicted)
        size, recent = start.load.size, cutting.recent
        eye = jnp.eye(size, dtype=dtype)

        def mean_load(poses: Pose) -> Array:
            return jnp.mean(period_wrench(process, cut, poses, recent), 0)[:size]

        def excess(F: Array) -> Array:
            return mean_load(bend.poses(F, middles)) - F

        def newton(F: Array, _: None) -> tuple[Array, None]:
            # One pass gives value and slope: the force beside each column is the same.
            value_and_slope = lambda way: jax.jvp(excess, (F,), (way,))
            found, columns = jax.vmap(value_and_slope)(eye)
            return F - jnp.linalg.solve(columns.T, found[0]), None

        def root() -> Array:
            return jax.lax.custom_root(
                excess,
                start.load,
                lambda _, F: jax.lax.scan(newton, F, length=_NEWTON_STEPS)[0],
                lambda slope, F: jnp.linalg.solve(jax.vmap(slope)(eye).T, F),
            )

        def balance() -> StaticEquilibrium:
            if self.robot.backlash is None:
                return bend.balance(root())
            return balance_with_gaps(
                bend, lambda tip: mean_load(bend.poses_to(tip, middles))
            )

        end = if_valid(row.is_live, balance, start)
        tips, ends = bend.reached(end, middles), bend.reached(end, last)
        cutting = cutting.ended(tips, ends)
        loads = jnp.broadcast_to(end.load[None], (middles.size, size))

        def recorded() -> tuple[Array, Array]:
            wrench = jax.lax.stop_gradient(period_wrench(process, cut, tips, recent))
            torque = jnp.mean(wrench[:, 6].reshape(middles.size, -1), axis=1)
            return substep_ranges(wrench, middles.size), torque

        moved = LoadedSubsteps(
            predicted.tip, tips.tip, ends.tip, loads, *if_valid(row.is_live, recorded)
        )
        return RunState(cutting, end, state.period_count), Period(
            tip=start.pose.tip,
            ends=ends.tip,
            force=end.load[:3],
            force_range=moved.whole_range(),
            spindle_torque=jnp.mean(moved.spindle_torque),
            joint_positions=start.q,
            removed=removed,
            has_failed=cutting.has_failed,
            substeps=moved,
            engagement=cut,
        )

    def motion(
        self,
        process: Process,
        state: StaticEquilibrium,
        row: CommandRow,
        loads: Float[Array, "substep load"],
    ) -> PeriodMotion:
        """Return the motion in a period, from its loads."""
        bend, load = self._deflection(process, state, row), jnp.mean(loads, axis=0)
        middles = process.substep_middles(load.dtype)
        return PeriodMotion(
            end=bend.balance(load),
            pose=state.pose,
            middles=bend.poses(load, middles),
            ends=bend.poses(load, process.substep_ends(load.dtype)).tip,
            predicted=bend.expected(state.load, middles),
        )

    def _deflection(
        self, process: Process, start: StaticEquilibrium, row: CommandRow
    ) -> StaticDeflection:
        """Deflection of the arm in a period, from its start and the motors."""
        # The end is near to the start moved along with the motors: linear from there.
        near = start.q + row.stop - row.start
        linear = self._linear(process, near)
        return StaticDeflection(self.robot, start.pose.tip, near, row.stop, *linear)

    def _linear(
        self, process: Process, q: Float[Array, " joint"]
    ) -> tuple[Pose, Float[Array, "load joint"], Float[Array, " joint"]]:
        """Pose of the tool in `work`, Jacobian of its tip there, torques of gravity."""
        terms = ArmTerms.of_state(self.robot, q, jnp.zeros_like(q))
        J = jacobian_in_work(self.T_base_work, terms.jacobian)
        is_upright = process.engagement.is_upright
        pose = in_work(self.T_base_work, terms.T_base_tool, is_upright)
        # Only on a bending tool the height at which a force acts counts for anything.
        return pose, J[: self.load_count], terms.bias_forces
