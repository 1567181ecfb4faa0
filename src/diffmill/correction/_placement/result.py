"""A place of the workpiece in the cell, as it is reported and judged."""

import dataclasses
import warnings

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job
from .objective import across, path_tangents, whole_path

# A joint that turns by more than this between two rows [rad] changes configuration.
_CONFIGURATION_TURN = 0.5


class Placement(eqx.Module):
    """A place of the workpiece and a rotation of the tool.

    Attributes:
        T_base_work: Place of the workpiece in the base, shape (4, 4).
        T_flange_tool: Tool in the flange, shape (4, 4): the flange turns about the
            tool axis while the tool's own frame stays with the path.
        shift: Of the middle of the cut from the job's place, in the base [m], (3,).
        angle: Turn of the workpiece about z of the base [rad].
        rotation: Turn of the flange about the tool axis [rad].
        rms_before: Predicted rms error across the path at the job's place, over the
            rows that cut [m]; NaN where that place cannot be reached.
        rms_after: The same at this place [m].
        searched: Places tried before the steps began.
        refused: How many of them the arm cannot reach, within its limits.
        at_bound: Names of the unknowns that stand at a bound, of "x", "y", "z",
            "angle" and "rotation".
    """

    T_base_work: Float[np.ndarray, "4 4"]
    T_flange_tool: Float[np.ndarray, "4 4"]
    shift: Float[np.ndarray, " 3"]
    angle: float
    rotation: float
    rms_before: float
    rms_after: float
    searched: int = eqx.field(static=True)
    refused: int = eqx.field(static=True)
    at_bound: tuple[str, ...] = eqx.field(static=True)

    @property
    def toml(self) -> str:
        """Lines of `[robot]` that bring a job here."""
        lines = [f"work_in_base = {_pose_text(self.T_base_work)}"]
        if self.rotation:
            lines.append(f"tool_in_flange = {_pose_text(self.T_flange_tool)}")
        return "\n".join(lines)

    def moved(self, job: Job) -> Job:
        """Job with its workpiece here and its tool turned so.

        Raises:
            ValueError: The job has no robot.
        """
        if job.robot is None:
            raise ValueError(
                "Argument `job` must have a robot, but its machine is rigid."
            )
        return dataclasses.replace(
            job,
            T_base_work=self.T_base_work,
            robot=job.robot.with_tool(self.T_flange_tool),
        )


def rms_across(job: Job, force: Float[Array, "step 3"]) -> float:
    """Rms error over the whole path [m]; infinite where the arm cannot follow it."""
    robot = job.robot
    assert robot is not None
    path = whole_path(job, force)
    q = np.asarray(path.joints)
    turns = np.array([kind == "revolute" for kind in robot.joint_kinds])
    jump = np.abs(np.diff(q, axis=0))[:, turns]
    is_within = (q >= np.asarray(robot.joint_lower)[None]) & (
        q <= np.asarray(robot.joint_upper)[None]
    )
    is_smooth = jump.max(initial=0.0) < _CONFIGURATION_TURN
    if not (bool(path.is_reached) and is_within.all() and is_smooth):
        return np.inf
    along = path_tangents(np.asarray(job.path.positions, np.float64))
    moved = path.deflection
    error = across(moved, jnp.asarray(along, moved.dtype))
    is_cutting = jnp.any(force != 0, axis=1)
    return float(jnp.sqrt(jnp.mean(jnp.sum(error[is_cutting] ** 2, axis=1))))


def _pose_text(T: Float[np.ndarray, "4 4"]) -> str:
    """Pose as a job file has it, to a nanometre and 1e-9 degrees."""
    from scipy.spatial.transform import Rotation

    # Adding 0 makes a rounded -0 a plain 0.
    position = [f'"{round(1e3 * x, 6) + 0.0:.10g} mm"' for x in T[:3, 3].tolist()]
    with warnings.catch_warnings():
        # Where roll and yaw turn about one axis, one of them is taken to be 0.
        warnings.filterwarnings("ignore", "Gimbal lock")
        angles = Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)
    rpy = [f'"{round(x, 9) + 0.0:.12g} deg"' for x in angles.tolist()]
    return f"{{ position = [{', '.join(position)}], rpy = [{', '.join(rpy)}] }}"
