"""What a controller knows of its machine, and where a probe then finds the work."""

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import Transform
from ...settings.fields import fix_a_frame
from .._algebra.rotations import rotation_matrix
from .._dynamics.rnea import gravity_forces
from .._kinematics.forward import forward_kinematics
from .._model.robot import Robot

# Steps of the rigid fit, each of which leaves the cube of a small rotation's error.
_FIT_STEPS = 3
# Passes in which joints settle on their springs.
_BALANCE_STEPS = 6


class NominalRobot(eqx.Module):
    """Robot and work as a controller knows them, where the machine is another one.

    The controller turns tips into motor positions by this robot. The work has been
    touched off with the machine: its frame is where that finds the probed points.

    Attributes:
        robot: The robot, with the tool that is set; it has the machine's motors.
        T_base_work: Workpiece frame that is set, in the robot's base, shape (4, 4).
        probes: Points of the work that are touched [m], shape (probe, 3).
        probe_motors: Motor positions at which the controller takes the tip to be at
            them [rad or m], shape (probe, joint of `robot`).
    """

    robot: Robot
    T_base_work: Transform
    probes: Float[Array, "probe 3"]
    probe_motors: Float[Array, "probe joint"]

    def __check_init__(self):
        if isinstance(self.probes, jax.core.Tracer):
            return
        points = np.asarray(self.probes)
        if not fix_a_frame(points.tolist()):
            raise ValueError(
                "Argument `probes` must have three points or more that are not on a "
                f"line, but has {points.tolist()}."
            )

    def motor_places(self, machine: Robot) -> tuple[int, ...]:
        """Joint of the nominal robot whose motor moves each joint of a machine.

        Args:
            machine: The machine; it has as many motors.

        Returns:
            One index per joint of the machine; -1 for a virtual joint.

        Raises:
            ValueError: The machine has another number of motors.
        """
        own, others = self.robot.motor_joints, machine.motor_joints
        if len(own) != len(others):
            raise ValueError(
                f"Argument `machine` must have {len(own)} motors, as the robot that "
                f"its controller knows, but has {len(others)}."
            )
        places = dict(zip(others, own, strict=True))
        return tuple(places.get(k, -1) for k in range(machine.joint_count))

    def touch_off(self, machine: Robot) -> Float[Array, "4 4"]:
        """Workpiece frame in the base of a machine, where its probe finds the work.

        The best rigid fit of the points to the tips at rest. Each point is touched
        from both sides, so that friction and gaps of joints without load cancel.

        Args:
            machine: The machine, with the probe's tip where the tool's is.

        Returns:
            The frame, shape (4, 4).

        **Differentiability**: smooth in the machine, but for gears that carry nothing.
        """
        found = self._probed_tips(machine)
        return _rigid_fit(self.T_base_work, jnp.asarray(self.probes), found)

    def probe_errors(self, machine: Robot) -> Float[Array, " probe"]:
        """Distances of the probed points from the frame that fits them [m].

        What no frame takes away: errors of links, springs and weight.

        Args:
            machine: The machine.

        **Differentiability**: as `touch_off`, but where a distance is 0.
        """
        found, frame = self._probed_tips(machine), self.touch_off(machine)
        fitted = jnp.asarray(self.probes) @ frame[:3, :3].T + frame[None, :3, 3]
        return jnp.linalg.norm(found - fitted, axis=1)

    def _probed_tips(self, machine: Robot) -> Float[Array, "probe 3"]:
        """Tips of a machine whose controller takes them to be at the probes [m]."""
        motors = placed_motors(self.motor_places(machine), self.probe_motors)
        motors = jax.vmap(machine.transmitted)(motors)
        hold = jnp.zeros(machine.joint_count, machine.dtype)
        if machine.friction is not None:
            hold = jnp.asarray(machine.friction.coulomb)

        def tip(
            theta: Float[Array, " joint"], side: Float[Array, ""]
        ) -> Float[Array, " 3"]:
            def balance(
                q: Float[Array, " joint"], _: None
            ) -> tuple[Float[Array, " joint"], None]:
                load = side * hold - gravity_forces(machine, q)
                return theta + machine.drive_deflection(load), None

            # Springs are much stiffer than the weight changes with the pose: each pass
            # takes a hundredth of what the one before has left.
            q, _ = jax.lax.scan(balance, theta, length=_BALANCE_STEPS)
            return forward_kinematics(machine, q)[:3, 3]

        sides = jnp.asarray([1.0, -1.0], machine.dtype)
        both = jax.vmap(jax.vmap(tip, (None, 0)), (0, None))(motors, sides)
        return both.mean(1)


def _rigid_fit(
    T: Transform, points: Float[Array, "point 3"], found: Float[Array, "point 3"]
) -> Float[Array, "4 4"]:
    """Frame near a given one in which points are closest to where they were found.

    Newton's steps for the rotation: unlike a singular value decomposition they have
    derivatives for points of any symmetry.
    """
    R = jnp.asarray(T, found.dtype)[:3, :3]
    points = points.astype(found.dtype)
    center, place = points.mean(0), found.mean(0)
    for _ in range(_FIT_STEPS):
        arms = (points - center[None]) @ R.T
        away = found - place[None] - arms
        inertia = jnp.sum(arms**2) * jnp.eye(3, dtype=R.dtype) - arms.T @ arms
        turn = jnp.linalg.solve(inertia, jnp.sum(jnp.cross(arms, away), axis=0))
        R = rotation_matrix(turn) @ R
    frame = jnp.eye(4, dtype=R.dtype).at[:3, :3].set(R)
    return frame.at[:3, 3].set(place - R @ center)


def placed_motors(
    places: tuple[int, ...], motors: Float[Array, "row joint *more"]
) -> Float[Array, "row machine_joint *more"]:
    """Rows of a nominal robot's joints at those of a machine; 0 for virtual joints.

    Args:
        places: `NominalRobot.motor_places`.
        motors: Positions, or their slopes, shape (row, joint, ...).
    """
    if places == tuple(range(motors.shape[1])):
        return motors
    rows = jnp.asarray(motors)[:, np.array(places)]
    is_virtual = np.array(places) < 0
    return jnp.where(is_virtual.reshape(1, -1, *[1] * (rows.ndim - 2)), 0.0, rows)
