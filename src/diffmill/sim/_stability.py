"""Whether a vibration of the arm grows in the cut: chatter, from the linearised step.

A chip is what lies between the tip and where it was one tooth period before, so that a
vibration comes back through the surface that it leaves. About the simulated state one
tooth period is a linear map of the arm's state and the tips of the last periods, sub-
step by sub-step as the simulation keeps them: the slopes of the integrator's own step
and of the library's own force. Its eigenvalues are the factors by which vibrations grow
per tooth period.
"""

import dataclasses
import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._job import Job
from .._types import RealScalarLike, Transform
from ..cutter import AbstractCutter
from ..cutting import AbstractForceLaw
from ..robot import Robot, arm_terms
from ..workpiece import Pose, Stock
from ._force_slopes import force_slopes
from ._integrators import make_integrator
from ._midpoint import Midpoint
from ._period_map import growth, period_maps
from ._plan import ProcessPlan
from ._simulate import Solution, job_plan, simulate, with_precision
from ._stepping import AbstractIntegrator

# Rows that are looked at unless asked for.
_ROWS = 100
# An undamped arm in the air has the radius 1; rounding must not make it unstable.
_TOLERANCE = 1e-4


class Stability(eqx.Module):
    """How vibrations grow at some rows of a run.

    Attributes:
        row: The rows: of the tooth periods that end there, shape (row,).
        time: [s], shape (row,).
        position: Tool tip in `work` [m], shape (row, 3).
        radius: Largest magnitude of the eigenvalues: the factor by which the fastest
            growing vibration grows per tooth period [-], shape (row,).
        frequency: Frequency of that vibration [Hz], shape (row,).
        apparent_frequency: Frequency at which it shows in the poses, one per tooth
            period [Hz], shape (row,); at most half the tooth passing frequency.
        tooth_frequency: Tooth passing frequency [Hz].
        substeps: Sub-steps per tooth period.
    """

    row: Int[np.ndarray, " row"]
    time: Float[np.ndarray, " row"]
    position: Float[np.ndarray, "row 3"]
    radius: Float[np.ndarray, " row"]
    frequency: Float[np.ndarray, " row"]
    apparent_frequency: Float[np.ndarray, " row"]
    tooth_frequency: float
    substeps: int = eqx.field(static=True)

    @property
    def is_unstable(self) -> Bool[np.ndarray, " row"]:
        """Whether a vibration grows, shape (row,)."""
        return self.radius > 1 + _TOLERANCE

    def warning(self) -> str | None:
        """Return what the user must know of an unstable cut, or None."""
        if not self.is_unstable.any():
            return None
        k, count = int(np.argmax(self.radius)), int(self.is_unstable.sum())
        first = float(self.time[np.argmax(self.is_unstable)])
        x, y, z = self.position[k] * 1e3
        return (
            f"the cut is unstable (chatter) at {count} of the {len(self.row)} rows "
            f"looked at, from time {first:.3f} s; most at {self.time[k]:.3f} s, "
            f"position ({x:.2f}, {y:.2f}, {z:.2f}) mm: a vibration at "
            f"{self.frequency[k]:.1f} Hz grows by {100 * (self.radius[k] - 1):.2g} % "
            "per tooth period"
        )

    def visibility(self) -> str:
        """Return which frequencies one pose per tooth period cannot show."""
        f = self.tooth_frequency
        return (
            f"poses are kept once per tooth, at {f:.1f} Hz: a vibration above "
            f"{f / 2:.1f} Hz shows in them at a lower frequency, its distance from the "
            f"nearest multiple of {f:.1f} Hz, and one at such a multiple as a constant "
            f"shift; sub-steps compute vibrations below {f * self.substeps / 2:.0f} Hz"
        )


def stability(
    job: Job,
    solution: Solution | None = None,
    *,
    rows: Sequence[int] | Int[np.ndarray, " row"] | None = None,
) -> Stability:
    """Return how vibrations grow along the path of a job.

    The removal is replayed along the simulated path, and the coupled step linearised
    at the rows. With the chip model "point_cloud" the chip of "near_far" is taken.

    Args:
        job: The job, with a robot.
        solution: Its solution; simulated if not given.
        rows: Rows to look at, from 1; if not given, up to 100 rows where the tool
            cuts, evenly spread.

    Returns:
        The growth, on the host.

    Raises:
        ValueError: If the machine is rigid, the job is quasi-static, a row does not
            exist, or the tool never cuts.

    Differentiability: none, a host function.
    """
    if job.robot is None:
        raise ValueError("Argument `job` must have a robot, but its machine is rigid.")
    if job.simulation.mode != "dynamic":
        raise ValueError(
            'Argument `job` must have mode "dynamic", but has '
            f'"{job.simulation.mode}", in which nothing vibrates.'
        )
    job = with_precision(job)
    robot = job.robot
    assert robot is not None
    solution = simulate(job) if solution is None else solution
    settings = dataclasses.replace(job.simulation, chip="near_far")
    plan = job_plan(dataclasses.replace(job, simulation=settings))
    if rows is None:
        cutting = np.flatnonzero(np.asarray(solution.is_cutting))
        cutting = cutting[cutting > 0]
        if cutting.size == 0:
            raise ValueError("Argument `solution` must cut somewhere, but does not.")
        rows = cutting[:: math.ceil(cutting.size / _ROWS)]
    assert solution.motor_positions is not None
    assert solution.joint_positions is not None
    return stability_along(
        solution.motor_positions,
        solution.joint_positions,
        solution.force,
        robot,
        job.T_base_work,
        job.stock,
        job.cutter,
        job.law,
        job.tooth_period,
        plan,
        rows,
        bottom_law=job.bottom_law,
        integrator=make_integrator(job.simulation.integrator, job.simulation.dynamics),
    )


def stability_along(
    motor_positions: Float[Array, "step joint"],
    joint_positions: Float[Array, "step joint"],
    force: Float[Array, "step 3"],
    robot: Robot,
    T_base_work: Transform,
    stock: Stock,
    cutter: AbstractCutter,
    law: AbstractForceLaw,
    tooth_period: RealScalarLike,
    plan: ProcessPlan,
    rows: Sequence[int] | Int[np.ndarray, " row"],
    bottom_law: AbstractForceLaw | None = None,
    integrator: AbstractIntegrator | None = None,
) -> Stability:
    """Return how vibrations grow along a motion; see `stability`.

    Args:
        motor_positions: theta at the tooth instants [rad or m], shape (step, joint).
        joint_positions: Joints there [rad or m], shape (step, joint).
        force: Mean force on the tool over the period before, in `work` [N], (step, 3).
        robot: The robot with its tool.
        T_base_work: Pose of the workpiece in the robot's base, shape (4, 4).
        stock: The raw workpiece.
        cutter: The cutter.
        law: The force law.
        tooth_period: T [s], shape ().
        plan: Sizes of the process, with the chip model "near_far".
        rows: Rows to look at, from 1.
        bottom_law: The law of the bottom edge; derived from `law` if not given.
        integrator: The rule of the robot's sub-steps; `Midpoint()` if not given.

    Returns:
        The growth, on the host.

    Raises:
        ValueError: If a row does not exist.

    Differentiability: none, a host function.
    """
    chosen = np.asarray(rows, dtype=np.int32)
    step_count = joint_positions.shape[0]
    if chosen.size == 0 or chosen.min() < 1 or chosen.max() >= step_count:
        raise ValueError(
            f"Argument `rows` must have rows from 1 to {step_count - 1}, but is {rows}."
        )
    # What comes after the last row looked at is of no interest.
    end = int(chosen.max()) + 1
    is_wanted = np.zeros(end, dtype=bool)
    is_wanted[chosen] = True
    dtype = joint_positions.dtype
    T, frame = jnp.asarray(tooth_period, dtype), jnp.asarray(T_base_work, dtype)
    path = _poses(robot, frame, joint_positions[:end], plan.is_upright)
    slopes = force_slopes(
        path, stock, cutter, law, bottom_law, plan, jnp.asarray(is_wanted)
    )
    maps = period_maps(
        robot,
        frame,
        Midpoint() if integrator is None else integrator,
        T,
        plan,
        jax.tree.map(lambda x: x[chosen], slopes),
        (motor_positions[chosen - 1], motor_positions[chosen]),
        (joint_positions[chosen - 1], joint_positions[chosen]),
        force[chosen],
    )
    radius, frequency, apparent = growth(
        np.asarray(maps), float(T), (cutter.flute_count, plan.substeps)
    )
    return Stability(
        row=chosen,
        time=chosen * float(T),
        position=np.asarray(path.tip)[chosen],
        radius=radius,
        frequency=frequency,
        apparent_frequency=apparent,
        tooth_frequency=1 / float(T),
        substeps=plan.substeps,
    )


@eqx.filter_jit
def _poses(
    robot: Robot,
    T_base_work: Float[Array, "4 4"],
    joint_positions: Float[Array, "step joint"],
    is_upright: bool,
) -> Pose:
    """Return the tool's poses in `work`, shape (step, 3)."""
    tool = jax.vmap(lambda q: arm_terms(robot, q, jnp.zeros_like(q)).T_base_tool)
    Ts = tool(joint_positions)
    to_base = T_base_work[:3, :3]
    tips = (Ts[:, :3, 3] - T_base_work[None, :3, 3]) @ to_base
    return Pose(tips, None if is_upright else Ts[:, :3, 2] @ to_base)
