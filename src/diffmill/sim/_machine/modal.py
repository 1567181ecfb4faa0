"""A machine that is known by its modes at the tool tip, as a hammer test shows them.

    r = r_c + Phi q,   q'' + 2 zeta omega q' + omega^2 q = Phi^T F - Gamma r_c''

r_c is where the program says that the tip is: the drives follow it ideally, and carry
the structure along. Like the motors of an arm they move evenly within a tooth period,
so that Gamma r_c'' are jumps of q' at the tooth instants. The force is held over each
sub-step, for which the modes are exact: with g = Phi^T F / omega^2

    q - g, q'  turn and decay as a free vibration of the mode,

stable at any sub-step. The tool's axis is the program's.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...process import Process
from ...robot import TipModes
from ...workpiece import Pose
from .compliant import AbstractInertialMachine, CommandRow, start_rate
from .coupled_period import AbstractPeriodDynamics


class ModalState(eqx.Module):
    """State of a machine of modes between sub-steps.

    Attributes:
        command: Where the program says that the tool is: the tip [m] and, where the
            tool tilts, its axis, shape (axis,).
        rate: How fast that moves [m/s], shape (axis,).
        amplitudes: q [m kg^1/2], shape (mode,).
        velocities: q' [m kg^1/2 / s], shape (mode,).
        load: The force of the last sub-step [N], shape (3,).
    """

    command: Float[Array, " axis"]
    rate: Float[Array, " axis"]
    amplitudes: Float[Array, " mode"]
    velocities: Float[Array, " mode"]
    load: Float[Array, " 3"]


class ModalPeriod(AbstractPeriodDynamics):
    """The machine in one period, ready for its sub-steps.

    Attributes:
        modes: The modes.
        pose: At the start.
        start: The command there, shape (axis,).
        rate: Of the command in the period, shape (axis,).
        substep: Length of a sub-step [s], shape ().
    """

    modes: TipModes
    pose: Pose
    start: Float[Array, " axis"]
    rate: Float[Array, " axis"]
    substep: Float[Array, ""]

    def middle(self, state: ModalState, time: Float[Array, ""]) -> Float[Array, " 3"]:
        """Return the tip in the middle of a sub-step, the last force held on [m]."""
        return self.tip(self._moved(state, time, state.load, self.substep / 2))

    def step(
        self, state: ModalState, time: Float[Array, ""], load: Float[Array, " 3"]
    ) -> ModalState:
        """Return the state at the end of a sub-step."""
        return self._moved(state, time + self.substep / 2, load, self.substep)

    def tip(self, state: ModalState) -> Float[Array, " 3"]:
        """Return the tip in a state of the period [m]."""
        return tip_of(self.modes, state)

    def _moved(
        self,
        state: ModalState,
        time: Float[Array, ""],
        load: Float[Array, " 3"],
        step: Float[Array, ""],
    ) -> ModalState:
        """Return the state at some time of the period, one step after another."""
        # symbols: w omega, w_d that of the damped mode, g deflection that F holds
        modes = self.modes
        w = 2 * jnp.pi * jnp.asarray(modes.frequencies)
        zeta = jnp.asarray(modes.damping_ratios)
        w_d = w * jnp.sqrt(1 - zeta**2)
        jump = (self.rate - state.rate)[:3]
        v = state.velocities - jnp.asarray(modes.participation) @ jump
        g = jnp.asarray(modes.shapes) @ load / w**2
        x = state.amplitudes - g
        decay = jnp.exp(-zeta * w * step)
        cos, sin = decay * jnp.cos(w_d * step), decay * jnp.sin(w_d * step) / w_d
        return ModalState(
            command=self.start + time * self.rate,
            rate=self.rate,
            amplitudes=g + cos * x + sin * (v + zeta * w * x),
            velocities=cos * v - sin * (zeta * w * v + w**2 * x),
            load=load,
        )


class ModalMachine(AbstractInertialMachine):
    """A machine given by modes at its tool tip; its command is the tool's path.

    A command has the tip positions [m], shape (step, 3), or where the tool is not
    upright tips and axes, shape (step, 6). The run starts in equilibrium, moving
    with the command.

    Attributes:
        modes: The modes, in the axes of the work.
    """

    modes: TipModes

    @property
    def load_count(self) -> int:
        """Numbers of a load: a force at the tip, where the modes are known."""
        return 3

    def begin(self, process: Process, command: Float[Array, "step axis"]) -> ModalState:
        """Return the state that moves with the command."""
        rate = start_rate(command, process.tooth_period)
        still = jnp.zeros(self.modes.frequencies.shape, command.dtype)
        none = jnp.zeros(3, command.dtype)
        return ModalState(command[0], rate, still, still, none)

    def pose(self, process: Process, state: ModalState) -> Pose:
        """Return the tool's pose in `work`."""
        is_upright = process.engagement.is_upright
        return Pose(
            tip_of(self.modes, state), None if is_upright else state.command[3:]
        )

    def joint_positions(self, state: ModalState) -> None:
        """Return None: it has no joints."""
        del state

    def dynamics(
        self, process: Process, state: ModalState, row: CommandRow
    ) -> ModalPeriod:
        """Return the machine in a period, from its state and the command."""
        T = process.tooth_period
        return ModalPeriod(
            modes=self.modes,
            pose=self.pose(process, state),
            start=row.start,
            rate=(row.stop - row.start) / T,
            substep=T / process.engagement.substeps,
        )


def tip_of(modes: TipModes, state: ModalState) -> Float[Array, " 3"]:
    """Return the tip [m]."""
    return state.command[:3] + jnp.asarray(modes.shapes).T @ state.amplitudes
