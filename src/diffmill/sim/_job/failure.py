"""Messages of runs that did not succeed: fault, row, place and joint."""

from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ..._job import Job
from ..._result import RESULTS
from ...robot import JointSolution, Robot, singularity
from .._machine.commands import JobKinematics

if TYPE_CHECKING:
    from .simulate import Solution

# Farther off its path, over the radius of the cutter, a tool most likely vibrates.
_SWINGING = 0.1
# A joint that takes at least this part in the motion that hardly moves the tool.
_TAKES_PART = 0.4


def troubles_of(solution: "Solution", job: Job | None) -> str:
    """Troubles of a run: kind, time, place and joint of each.

    Args:
        solution: The solution of a run that is not successful.
        job: Its job, in its precision: with it a pose that is not reached is described.
    """
    troubles = []
    is_reached = np.asarray(solution.is_reached)
    if not is_reached.all():
        troubles.append(_unreached(solution, ~is_reached, job))
    if not bool(solution.result == RESULTS.unreachable):
        troubles.append(_failed(solution, job))
    return " ".join(troubles)


def _failed(solution: "Solution", job: Job | None) -> str:
    """Trouble of the cut, and its first place."""
    text = RESULTS[solution.result]
    if bool(solution.result == RESULTS.non_finite):
        numbers = np.concatenate([solution.actual, solution.force], axis=1)
        is_bad = np.asarray(~np.isfinite(numbers).all(axis=1))
        text = f"{text}{_broken_joints(solution, is_bad)}{_no_balance(job)}"
    else:
        is_bad = np.asarray(solution.has_failed)
    text = f"{text} First at {_at(solution, is_bad)}."
    return f"{text}{_vibration_text(solution, is_bad, job)}"


def _vibration_text(
    solution: "Solution", is_bad: Bool[np.ndarray, " step"], job: Job | None
) -> str:
    """Note on a striking deviation of the tool from its path."""
    if job is None or not is_bad.any():
        return ""
    until = np.linalg.norm(solution.deviation, axis=1)[: int(np.argmax(is_bad)) + 1]
    farthest = float(np.nanmax(until, initial=0.0))
    if not farthest > _SWINGING * float(job.cutter.nominal_radius):
        return ""
    return (
        f" The tool is up to {1e3 * farthest:.3g} mm off its path before: if it "
        "vibrates more from tooth to tooth, the cut is unstable (chatter), and less "
        "depth or another speed is the cure."
    )


def _broken_joints(solution: "Solution", is_bad: Bool[np.ndarray, " step"]) -> str:
    """Note on the joints that lost their numbers first, empty without a robot."""
    if solution.joint_positions is None or not is_bad.any():
        return ""
    q = np.asarray(solution.joint_positions)
    rows = np.flatnonzero(~np.isfinite(q).all(axis=1))
    if not rows.size:
        return ""
    names = [
        name
        for name, x in zip(solution.joint_names, q[rows[0]], strict=True)
        if not np.isfinite(x)
    ]
    return f" So did the joints {', '.join(names)}."


def _no_balance(job: Job | None) -> str:
    """Note on numbers lost where an arm with gaps has no inertia."""
    robot = None if job is None else job.robot
    if job is None or robot is None or robot.backlash is None:
        return ""
    if job.simulation.mode.vibrates:
        return ""
    return (
        " Gears with backlash may find no balance with the cut, where the force turns "
        "round in a gap: the dynamic mode follows how the tool goes through it."
    )


def _unreached(
    solution: "Solution", is_bad: Bool[np.ndarray, " step"], job: Job | None
) -> str:
    """Trouble of poses that are not reached, and the arm at the first of them."""
    text = (
        f"The robot does not reach {is_bad.sum()} of the {is_bad.size} poses that are "
        f"commanded. First at {_at(solution, is_bad)}"
    )
    if job is None or job.robot is None:
        return f"{text}."
    found = JobKinematics(job).solve(jnp.asarray(solution.commanded))
    k = int(np.argmax(is_bad))
    away, tilt = float(found.position_residual[k]), float(found.rotation_residual[k])
    return (
        f"{text}: the nearest pose found is {1e3 * away:.3g} mm and "
        f"{np.rad2deg(tilt):.3g} deg away{_limiting_joints(job.robot, job, found, k)}."
    )


def _limiting_joints(robot: Robot, job: Job, found: JointSolution, k: int) -> str:
    """Return the joints that hold the arm back: beyond limits, or stretched."""
    q = np.asarray(found.q)[k]
    excess = np.asarray(found.limit_excess)[k]
    if excess.any():
        i = int(np.argmax(excess))
        at = _position(robot, q, i)
        return f", where joint {robot.joint_names[i]} is beyond its limits at {at}"
    measure = singularity(robot, found.q[k], tool_rotation=job.tool_rotation)
    move = np.abs(np.asarray(measure.joint_direction))
    joints = [
        f"{robot.joint_names[i]} ({_position(robot, q, i)})"
        for i in np.flatnonzero(move > _TAKES_PART).tolist()
    ]
    return f", where the joints {', '.join(joints)} hardly move it any more"


def _position(robot: Robot, q: Float[np.ndarray, " joint"], i: int) -> str:
    is_slide = robot.joint_kinds[i] == "prismatic"
    return f"{1e3 * q[i]:.1f} mm" if is_slide else f"{np.rad2deg(q[i]):.1f} deg"


def _at(solution: "Solution", is_bad: Bool[np.ndarray, " step"]) -> str:
    """Return row, time and place of the first of some rows."""
    row = int(np.argmax(is_bad))
    at = ", ".join(f"{1e3 * float(x):.2f}" for x in solution.commanded[row])
    time = float(solution.time[row])
    return f"step {row}, time {time:.4f} s, commanded tip ({at}) mm"
