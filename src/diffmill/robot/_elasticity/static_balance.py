"""Static balance of the drives' springs against gravity and load.

A motor stands at theta, its command; the joint hangs on it by a spring,
tau = K (theta - q). A virtual joint is the same spring with theta = 0.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from .._dynamics.rnea import gravity_forces, gravity_torques
from .._kinematics.forward import joint_frames, link_inertia_rows, tool_jacobian
from .._model.robot import JointVector, Robot, Wrench, joint_vector, wrench_vector

# Step at which Newton's method ends [rad or m], and steps at most. Springs are much
# stiffer than gravity and load change with the pose: from a deflection of 0.1 rad three
# steps reach rounding.
_TOLERANCE, _NEWTON_STEPS = 1e-6, 8


def motor_positions(
    robot: Robot, q: JointVector, *, is_gravity_compensated: bool = True
) -> Float[Array, " joint"]:
    """Motor positions theta that hold the unloaded robot at q.

        theta = q + K^-1 G(q)

    The sag of virtual joints has no motor of its own and stays. A servo's yielding,
    G / K_s, is added too; a gap is not made up for, as the controller does not know
    on which side of it a gear lies.

    Args:
        robot: The robot.
        q: Joint positions wanted [rad or m], shape (joint,).
        is_gravity_compensated: Without it, theta = q.

    Returns:
        Motor positions on the joint side [rad or m], shape (joint,); 0 for virtual
        joints.
    """
    wanted = joint_vector(robot, q, "q")
    if is_gravity_compensated:
        wanted = wanted + robot.gravity_compensation(gravity_forces(robot, wanted))
    return jnp.where(robot.motor_mask(), wanted, 0.0)


def loaded_equilibrium(
    robot: Robot, theta: JointVector, wrench: Wrench | None = None
) -> Float[Array, " joint"]:
    """Equilibrium of the joints: K (theta - q) + J^T F - G(q) = 0.

    With backlash and servos the stretch theta - q is theirs too. Friction holds
    nothing: in its smooth form a loaded joint creeps until the springs carry it.

    Args:
        robot: The robot.
        theta: Motor positions [rad or m], shape (joint,); those of virtual joints
            are taken as 0.
        wrench: External force and moment on the robot at the tool's origin in base
            axes [N, N m], shape (6,); None for none.

    Returns:
        Joint positions [rad or m], shape (joint,).

    **Differentiability**: smooth; derivatives by the implicit function.
    """
    return _loaded_equilibrium(
        robot,
        jnp.where(robot.motor_mask(), joint_vector(robot, theta, "theta"), 0.0),
        wrench_vector(robot, wrench),
    )


@jax.jit
def _loaded_equilibrium(
    robot: Robot, theta: Float[Array, " joint"], wrench: Float[Array, " 6"]
) -> Float[Array, " joint"]:
    # Imported here: it takes a third of a second, and not every job needs it.
    import optimistix as optx

    def residual(q: Float[Array, " joint"], args: PyTree) -> Float[Array, " joint"]:
        robot, theta, wrench = args
        frames = joint_frames(robot, q)
        load = tool_jacobian(robot, frames).T @ wrench - gravity_torques(
            robot, frames, link_inertia_rows(robot, frames)
        )
        # Divided by K, an infinite stiffness is an ordinary number.
        return theta - q + robot.drive_deflection(load)

    return optx.root_find(
        residual,
        optx.Newton(rtol=_TOLERANCE, atol=_TOLERANCE),
        theta,
        (robot, theta, wrench),
        options={"jac": "fwd"},
        max_steps=_NEWTON_STEPS,
        throw=False,
    ).value
