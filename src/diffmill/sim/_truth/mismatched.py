"""A program on another machine than the one that its controller knows."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..._job import Job
from ...robot import NominalRobot
from .._machine.commands import JobKinematics

# Points of the path at which the work is touched off, unless others are stated.
_PROBES = 40


def mismatched(model: Job, machine: Job) -> Job:
    """Job whose machine is another one than its controller knows.

    The controller turns the program into motor positions by the model: its links, tool,
    springs and weight. These motors move the machine, which has links, springs, drives
    and a cut of its own. Its workpiece frame is the best rigid fit of some points that
    are touched off at rest.

    Args:
        model: What the controller knows; its machine must be a robot. The work is
            touched off at its `probes`, or at 40 rows of the path at equal distances.
        machine: The same program on the other machine: robot, force law, cutter and
            controller may differ. The robot has as many motors; virtual joints, as of a
            flange spring, may come to it.

    Returns:
        The job: `simulate` runs its program, `correct` corrects it for the machine.

    Raises:
        ValueError: One of the two has no robot, the machine has another path or number
            of motors, or the probes are on a line.

    Differentiability: smooth in the machine, as `NominalRobot.touch_off`.
    """
    for name, job in (("model", model), ("machine", machine)):
        if job.robot is None:
            raise ValueError(f"Argument `{name}` must have a robot, but has none.")
    if machine.path.positions.shape != model.path.positions.shape:
        raise ValueError(
            f"Argument `machine` must have the path of `model`, of "
            f"{model.path.step_count} rows, but has {machine.path.step_count}."
        )
    return dataclasses.replace(machine, nominal=nominal_robot(model)).touched_off()


def nominal_robot(model: Job) -> NominalRobot:
    """Robot and work of a job as its controller knows them, with what is touched off.

    Args:
        model: The job; it must have a robot.
    """
    known = model.as_known
    assert known.robot is not None
    points = _path_points(model)
    if model.probes is not None:
        points = np.asarray(model.probes, np.float64)
    dtype = known.robot.dtype
    return NominalRobot(
        robot=known.robot,
        T_base_work=known.T_base_work,
        probes=jnp.asarray(points, dtype),
        probe_motors=_kinematics_at(known, points)
        .motors(jnp.asarray(points, dtype))
        .positions,
    )


def _path_points(job: Job) -> Float[np.ndarray, "probe 3"]:
    """Rows of a path at equal distances in time."""
    count = job.path.step_count
    rows = np.unique(np.linspace(0, count - 1, min(_PROBES, count)).astype(int))
    return np.asarray(job.path.positions, np.float64)[rows]


def _kinematics_at(job: Job, points: Float[np.ndarray, "probe 3"]) -> JobKinematics:
    """Kinematics for points of the work, with the tool as on the row next to each."""
    known = JobKinematics(job)
    rows = np.asarray(job.path.positions, np.float64)
    # A point at a time: all distances at once would take the memory of many paths.
    near = np.array([np.argmin(np.sum((rows - p) ** 2, axis=1)) for p in points])
    rows_of_path = lambda k: (k.tool_axes, k.tool_x)
    at = tuple(None if x is None else x[near] for x in rows_of_path(known))
    return eqx.tree_at(rows_of_path, known, at, is_leaf=lambda x: x is None)
