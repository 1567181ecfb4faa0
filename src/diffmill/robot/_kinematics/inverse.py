"""Inverse kinematics by damped Newton steps, for one pose and for a path.

The search runs without derivatives. A last Newton step with a constant inverse of
the Jacobian then carries the derivative of the implicit function, exactly and at the
price of one forward kinematics. Virtual joints stay at 0.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int

from ..._arrays import first_rows, is_traced, on_device
from ..._padding import (
    LONGEST,
    live_rows,
    map_rows,
    pad_rows,
    padded_count,
    scan_rows,
)
from ..._types import Transform
from ...numerics import CachedJit, small_inverse
from .._model.robot import JointVector, Robot, joint_vector
from .forward import joint_frames
from .pose_error import (
    ToolRotation,
    choice_slope,
    chosen_step,
    damped_step,
    has_choice,
    pose_task,
)

# Numbers of Newton steps: of a search, along a path, and at its end.
_POSE_STEPS = 60
_PATH_STEPS = 4
_POLISH_STEPS = 2
# Largest number of searches for a pose.
_ATTEMPTS = 32
# Longest step of the search [rad or m]: beyond it the linear picture misleads.
_LONGEST_STEP = 0.3
# Squared error below which the linear picture holds [m^2 + rad^2].
_LINEAR_ERROR = 1e-6
# Squared error at which the Jacobian is that of the pose to ten digits [m^2 + rad^2].
_JACOBIAN_ERROR = 1e-20
# Longest Newton step to the middle of the ranges [rad or m]: a longer one along a path
# leads away from a middle that has ceased to be one.
_LONGEST_NEWTON_STEP = 0.1
# Newton step below which the arm is at the middle but for rounding [rad or m].
_SETTLED_STEP = 1e-2
# Share of the step to the middle of the ranges that is safe far from it.
_PULL_SHARE = 0.3


class JointSolution(eqx.Module):
    """The joint positions of one pose, or of every pose of a path.

    Attributes:
        q: Joint positions [rad or m], shape (*step, joint).
        converged: True if the tool is at the pose, shape (*step,).
        position_residual: Distance of the tool's origin to the pose [m], (*step,).
        rotation_residual: Angle from the tool to the pose; with a free rotation that
            of the tool axis [rad], shape (*step,).
        within_limits: True if all joints are within their limits, shape (*step,).
        limit_excess: Excess of each joint over its limits [rad or m], shape
            (*step, joint).
        midway_error: Distance of the tip from the middle between two poses when every
            joint is half way between them [m], shape (*step,); 0 in row 0 and for one
            pose. Of the order of (step length)^2 / arm length, but where the arm
            changes its configuration between two rows.
    """

    q: Float[Array, "*step joint"]
    converged: Bool[Array, "*step"]
    position_residual: Float[Array, "*step"]
    rotation_residual: Float[Array, "*step"]
    within_limits: Bool[Array, "*step"]
    limit_excess: Float[Array, "*step joint"]
    midway_error: Float[Array, "*step"]


def inverse_kinematics(
    robot: Robot,
    T_base_tool: Transform,
    q_start: JointVector,
    *,
    tool_rotation: ToolRotation = "fixed",
    attempts: int = _ATTEMPTS,
) -> JointSolution:
    """Joint positions that bring the tool to a pose.

    Args:
        robot: The robot.
        T_base_tool: The pose, shape (4, 4).
        q_start: Start of the search [rad or m], shape (joint,). Its end is the
            solution, unless it misses the pose or is beyond the limits.
        tool_rotation: "fixed", or "free": of the pose's rotation only the tool axis
            counts. A joint more than the pose needs is near the middle of its
            range, or near home if it has no limits.
        attempts: Searches at most: after the first from elsewhere, until the pose is
            reached within limits. With 1 the solution is that of `q_start`. With 0
            there is no search, which need not be compiled then: `q_start` reaches the
            pose but for rounding, and one Newton step carries the derivative.

    Returns:
        The solution; check `converged` and `within_limits`.

    **Differentiability**: in the pose and the robot, first derivatives by the
    implicit function; none in `q_start`. Finite, but not meaningful, where the
    search did not converge or the pose is singular.
    """
    start = joint_vector(robot, q_start, "q_start")
    T = jnp.asarray(T_base_tool, dtype=robot.dtype)
    if attempts == 0:
        return _finish(robot, T, start, tool_rotation)
    return _solve_pose(robot, T, start, tool_rotation, attempts)


def inverse_kinematics_path(
    robot: Robot,
    Ts_base_tool: Float[Array, "step 4 4"] | Float[np.ndarray, "step 4 4"],
    q_start: JointVector,
    *,
    tool_rotation: ToolRotation = "fixed",
    attempts: int = _ATTEMPTS,
) -> JointSolution:
    """Joint positions along a path; the search of a pose starts from the one before.

    Args:
        robot: The robot.
        Ts_base_tool: The poses, each near to the one before, shape (step, 4, 4).
        q_start: Start of the search of the first pose [rad or m], (joint,).
        tool_rotation: As for `inverse_kinematics`.
        attempts: As for `inverse_kinematics`, for the first pose.

    Returns:
        The solution; check `converged`, `within_limits` and, where the poses may be
        far apart, `midway_error`. Batches by `vmap`.

    **Differentiability**: as `inverse_kinematics`, pose by pose.
    """
    start = joint_vector(robot, q_start, "q_start")
    if is_traced((robot, Ts_base_tool, start)):
        Ts = jnp.asarray(Ts_base_tool, dtype=robot.dtype)
        return _solve_path(robot, Ts, start, tool_rotation, attempts, None)
    Ts = np.asarray(Ts_base_tool, robot.dtype)
    total, pieces = min(padded_count(len(Ts)), LONGEST), []
    # Each piece begins with the last pose of the one before, whose joints are known.
    for first in range(0, max(1, len(Ts) - 1), total - 1):
        rows = Ts[first : first + total]
        found = _solve_path(
            robot,
            on_device(pad_rows(rows, total)),
            start,
            tool_rotation,
            attempts,
            on_device(np.asarray(len(rows), np.int32)),
            is_begun=on_device(np.asarray(first > 0)),
        )
        found = jax.device_get(first_rows(found, len(rows)))
        start = on_device(found.q[-1])
        pieces.append(jax.tree.map(lambda x, k=min(first, 1): x[k:], found))
    return jax.tree.map(lambda *x: on_device(np.concatenate(x)), *pieces)


@CachedJit
def _solve_pose(
    robot: Robot,
    T: Float[Array, "4 4"],
    q_start: Float[Array, " joint"],
    tool_rotation: ToolRotation,
    attempts: int,
) -> JointSolution:
    start = _unloaded_virtual(robot, q_start)
    q = _first_pose(robot, T, start, tool_rotation, attempts)
    return _finish(robot, T, q, tool_rotation)


@CachedJit
def _solve_path(
    robot: Robot,
    Ts: Float[Array, "step 4 4"],
    q_start: Float[Array, " joint"],
    tool_rotation: ToolRotation,
    attempts: int,
    row_count: Int[Array, ""] | None,
    *,
    is_begun: Bool[Array, ""] | None = None,
) -> JointSolution:
    def follow(q, T, _):
        if not has_choice(robot, tool_rotation):
            q = _approach(robot, T, q, tool_rotation)
            return q, q
        q = _search(robot, T, q, _PATH_STEPS, tool_rotation)
        # Where the middle of the ranges that was followed ends, the arm slides to the
        # next one.
        q = _search(robot, T, q, _PATH_STEPS, tool_rotation, chooses=False)
        return q, q

    def search() -> Float[Array, " joint"]:
        start = _unloaded_virtual(robot, q_start)
        return _first_pose(robot, Ts[0], start, tool_rotation, attempts)

    if is_begun is None:
        first = search()
    else:
        first = lax.cond(is_begun, lambda: lax.stop_gradient(q_start), search)
    index = jnp.arange(Ts.shape[0], dtype=jnp.int32)
    is_live = live_rows(index, row_count)
    _, qs = scan_rows(follow, first, lax.stop_gradient(Ts), is_live)
    finish = lambda T, q: _finish(robot, T, q, tool_rotation)
    solution = map_rows(finish, is_live, Ts, qs)
    error = _midway_error(robot, Ts, solution.q, is_live)
    return dataclasses.replace(solution, midway_error=error)


def _unloaded_virtual(
    robot: Robot, q: Float[Array, " joint"]
) -> Float[Array, " joint"]:
    return jnp.where(robot.motor_mask(), q, 0.0)


def _midway_error(
    robot: Robot,
    Ts: Float[Array, "step 4 4"],
    qs: Float[Array, "step joint"],
    is_live: Bool[Array, " step"] | None,
) -> Float[Array, " step"]:
    """Distance of the tip, with joints half way, from the middle of two poses [m]."""
    robot, Ts, qs = lax.stop_gradient((robot, Ts, qs))
    tip = lambda q: joint_frames(robot, q).tool_position
    ends = None if is_live is None else is_live[1:]
    tips = map_rows(tip, ends, (qs[1:] + qs[:-1]) / 2)
    away = tips - (Ts[1:, :3, 3] + Ts[:-1, :3, 3]) / 2
    return jnp.concatenate([jnp.zeros(1, qs.dtype), jnp.linalg.norm(away, axis=1)])


def _search(
    robot: Robot,
    T: Float[Array, "4 4"],
    q: Float[Array, " joint"],
    steps: int,
    tool_rotation: ToolRotation,
    *,
    lower: Float[Array, " joint"] | None = None,
    upper: Float[Array, " joint"] | None = None,
    chooses: bool = True,
) -> Float[Array, " joint"]:
    """End of a fixed number of damped Newton steps, without derivative [rad or m].

    Where the pose leaves a choice they make it, unless `chooses` is False.
    """
    robot, T, q = lax.stop_gradient((robot, T, q))

    def take(q):
        task = pose_task(robot, T, q, tool_rotation)
        # Damping by the squared error keeps the quadratic convergence.
        size = jnp.sum(task.error**2)
        if chooses and has_choice(robot, tool_rotation):
            is_newton = steps == _PATH_STEPS
            return _choice_search_step(
                robot, T, q, tool_rotation, size, is_newton=is_newton
            )
        return damped_step(task.jacobian, task.error, 1e-2 * size)

    def step(q, _):
        q = _moved(q, take(q))
        if lower is None or upper is None:
            return q, None
        return jnp.clip(q, lower, upper), None

    q, _ = lax.scan(step, q, length=steps)
    return q


def _approach(
    robot: Robot,
    T: Float[Array, "4 4"],
    q: Float[Array, " joint"],
    tool_rotation: ToolRotation,
) -> Float[Array, " joint"]:
    """Joints at the pose, to the error at which the Jacobian is right [rad or m].

    The steps are those of `_search` along a path where the pose leaves no choice, but
    they end at that error.
    """
    robot, T, q = lax.stop_gradient((robot, T, q))
    task_at = lambda q: pose_task(robot, T, q, tool_rotation)
    # Single precision does not come so close.
    close = max(_JACOBIAN_ERROR, float(4 * jnp.finfo(q.dtype).eps) ** 2)

    def step(state):
        count, q, task = state
        size = jnp.sum(task.error**2)
        q = _moved(q, damped_step(task.jacobian, task.error, 1e-2 * size))
        return count + 1, q, task_at(q)

    def is_away(state):
        count, _, task = state
        return (count < _PATH_STEPS) & (jnp.sum(task.error**2) > close)

    return lax.while_loop(is_away, step, (jnp.zeros((), jnp.int32), q, task_at(q)))[1]


def _moved(
    q: Float[Array, " joint"], dq: Float[Array, " joint"]
) -> Float[Array, " joint"]:
    """Joints after a step, which is cut where it is too long [rad or m]."""
    longest = jnp.max(jnp.abs(dq))
    return q + dq * jnp.minimum(1.0, _LONGEST_STEP / (longest + 1e-12))


def motor_limits(robot: Robot) -> tuple[Float[Array, " joint"], Float[Array, " joint"]]:
    """Limits of the motors [rad or m], infinite for virtual joints, which stay at 0."""
    motors = robot.motor_mask()
    return (
        jnp.where(motors, robot.joint_lower, -jnp.inf),
        jnp.where(motors, robot.joint_upper, jnp.inf),
    )


def _choice_search_step(
    robot: Robot,
    T: Float[Array, "4 4"],
    q: Float[Array, " joint"],
    tool_rotation: ToolRotation,
    size: Float[Array, ""],
    *,
    is_newton: bool,
) -> Float[Array, " joint"]:
    """Step where the pose leaves a choice; a Newton step only along a path [rad or m].

    The self-motion curves, so that a whole plain step along it may go too far, and a
    Newton step from afar may end where the joints are farthest from the middle.
    """
    plain = chosen_step(robot, T, q, tool_rotation, 1e-2 * size, _PULL_SHARE)
    if not is_newton:
        return plain
    newton, is_short = _choice_newton_step(
        robot, T, q, tool_rotation, _LONGEST_NEWTON_STEP
    )
    return jnp.where(is_short & (size < _LINEAR_ERROR), newton, plain)


def _choice_newton_step(
    robot: Robot,
    T: Float[Array, "4 4"],
    q: Float[Array, " joint"],
    tool_rotation: ToolRotation,
    longest: float,
) -> tuple[Float[Array, " joint"], Bool[Array, ""]]:
    """Newton step to the zero of the undamped `chosen_step` [rad or m]; True if short.

    Only the step carries the derivative, not its slope. It is short where no joint
    moves by more than `longest`.
    """
    frozen, T_frozen, q_frozen = lax.stop_gradient((robot, T, q))
    slope = choice_slope(frozen, T_frozen, q_frozen, tool_rotation)
    inverse = small_inverse(slope)
    residual = -chosen_step(robot, T, q, tool_rotation, None)
    is_short = jnp.max(jnp.abs(inverse @ lax.stop_gradient(residual))) < longest
    # A singular slope must not spoil derivatives either.
    return jnp.where(is_short, inverse, 0.0) @ residual, is_short


def _first_pose(
    robot: Robot,
    T: Float[Array, "4 4"],
    q_start: Float[Array, " joint"],
    tool_rotation: ToolRotation,
    attempts: int,
) -> Float[Array, " joint"]:
    """End of a search, and of further ones from other starts if it failed [rad or m].

    A solution within limits ends the search. Else the first solution counts, and
    without any the joints that are nearest to the pose.
    """
    robot, T, q_start = lax.stop_gradient((robot, T, q_start))
    tolerance = _tolerance(q_start.dtype)

    def attempt(state):
        count, q, error, _ = state
        start = start_elsewhere(robot, q_start, count, attempts)
        # The search from the start may leave the limits, for the branch it is on.
        lower, upper = (
            jnp.where(count == 0, sign * jnp.inf, limit)
            for sign, limit in zip((-1, 1), motor_limits(robot), strict=True)
        )
        new = _search(
            robot, T, start, _POSE_STEPS, tool_rotation, lower=lower, upper=upper
        )
        new = unwound(robot, _polished(robot, T, new, tool_rotation), q_start)
        new_error = jnp.max(jnp.abs(pose_task(robot, T, new, tool_rotation).error))
        lower, upper = motor_limits(robot)
        is_good = (new_error < tolerance) & jnp.all((new >= lower) & (new <= upper))
        # Of solutions beyond the limits the first one counts.
        is_better = is_good | ((error >= tolerance) & (new_error < error))
        q = jnp.where(is_better, new, q)
        return count + 1, q, jnp.where(is_better, new_error, error), is_good

    state = (
        jnp.zeros((), jnp.int32),
        q_start,
        jnp.full((), jnp.inf, q_start.dtype),
        jnp.zeros((), bool),
    )
    if attempts == 1:
        return attempt(state)[1]
    return lax.while_loop(lambda s: ~s[3] & (s[0] < attempts), attempt, state)[1]


def start_elsewhere(
    robot: Robot,
    q_start: Float[Array, " joint"],
    count: Int[Array, ""],
    attempts: int,
) -> Float[Array, " joint"]:
    """Start of a further search: the later, the farther from the first [rad or m]."""
    rng = np.random.default_rng(0)
    shares = jnp.asarray(rng.random((attempts, q_start.shape[0])), q_start.dtype)
    slides = jnp.asarray(robot.joint_prismatic_mask())
    half = jnp.where(slides, 1.0, jnp.pi).astype(q_start.dtype)
    lower, upper = motor_limits(robot)
    lower = jnp.maximum(lower, q_start - half)
    upper = jnp.minimum(upper, q_start + half)
    somewhere = lower + shares[count] * (upper - lower)
    far = jnp.minimum(2.0 * count.astype(q_start.dtype) / attempts, 1.0)
    return _unloaded_virtual(robot, q_start + far * (somewhere - q_start))


def unwound(
    robot: Robot, q: Float[Array, " joint"], q_start: Float[Array, " joint"]
) -> Float[Array, " joint"]:
    """Joints of the same pose without whole turns, near the start and in limits."""
    if robot.has_mimics:
        # A follower need not turn by whole turns.
        return q
    turn = 2 * jnp.pi
    turns = jnp.asarray(~robot.joint_prismatic_mask())
    lower, upper = motor_limits(robot)
    near = q - turn * jnp.round((q - q_start) / turn)
    down = near - turn * jnp.ceil(jnp.maximum(near - upper, 0.0) / turn)
    up = near + turn * jnp.ceil(jnp.maximum(lower - near, 0.0) / turn)
    is_down = (near > upper) & (down >= lower)
    is_up = (near < lower) & (up <= upper)
    near = jnp.where(is_down, down, jnp.where(is_up, up, near))
    return jnp.where(turns, near, q)


def _polished(
    robot: Robot,
    T: Float[Array, "4 4"],
    q: Float[Array, " joint"],
    tool_rotation: ToolRotation,
) -> Float[Array, " joint"]:
    """Joints exactly at the pose, for joints near to it, without derivative."""
    robot, T, q = lax.stop_gradient((robot, T, q))
    for _ in range(_POLISH_STEPS):
        task = pose_task(robot, T, q, tool_rotation)
        step = damped_step(task.jacobian, task.error, None)
        q = q + jnp.where(jnp.sum(task.error**2) < _LINEAR_ERROR, step, 0.0)
    return q


def _tolerance(dtype: DTypeLike) -> Float[Array, ""]:
    """Residual below which the tool is at the pose [m or rad]."""
    return jnp.asarray(100.0 * jnp.finfo(dtype).eps ** 0.75, dtype)


def _finish(
    robot: Robot,
    T: Float[Array, "4 4"],
    q: Float[Array, " joint"],
    tool_rotation: ToolRotation,
) -> JointSolution:
    """Solution after the step that carries the derivative."""
    q = lax.stop_gradient(q)
    task = pose_task(robot, T, q, tool_rotation)
    J = lax.stop_gradient(task.jacobian)
    # Where the search failed, a full step might go anywhere: keep its value out.
    is_near = jnp.sum(lax.stop_gradient(task.error) ** 2) < _LINEAR_ERROR
    step = damped_step(J, task.error, None)
    if has_choice(robot, tool_rotation):
        newton, is_short = _choice_newton_step(
            robot, T, q, tool_rotation, _SETTLED_STEP
        )
        step = jnp.where(is_short, newton, step)
    value = jnp.where(is_near, lax.stop_gradient(step), 0.0)
    q = q + value
    if has_choice(robot, tool_rotation):
        # The self-motion curves: a step along it leaves the pose a little.
        q = _polished(robot, T, q, tool_rotation)
    q = q + (step - lax.stop_gradient(step))
    residual = lax.stop_gradient(pose_task(robot, T, q, tool_rotation).error)
    # A rotation's residual is 2 sin(angle / 2) times its axis.
    half_sine = jnp.minimum(0.5 * jnp.linalg.norm(residual[3:]), 1.0)
    excess = jnp.maximum(robot.joint_lower - q, q - robot.joint_upper)
    return JointSolution(
        q=q,
        converged=jnp.max(jnp.abs(residual)) < _tolerance(q.dtype),
        position_residual=jnp.linalg.norm(residual[:3]),
        rotation_residual=2.0 * jnp.arcsin(half_sine),
        within_limits=jnp.all((q >= robot.joint_lower) & (q <= robot.joint_upper)),
        limit_excess=lax.stop_gradient(jnp.maximum(excess, 0.0)),
        midway_error=jnp.zeros((), q.dtype),
    )
