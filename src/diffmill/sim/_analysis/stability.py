"""Stability of the cut: growth of the arm's vibrations, from the linear motion.

A chip is what lies between the tip and where it was when the tooth before passed, so
that a vibration comes back through the surface that it leaves. About the simulated
state one tooth period, of teeth that differ a turn, is a linear map of the arm's state
and of the tips in the last periods, by the slopes of the equations of motion and of the
library's own force. Its eigenvalues tell by which factors vibrations grow per tooth
period.

The map has steps of its own, short enough for every mode that the cut could excite
(`_analysis/monodromy.py`); those of the simulation may be longer.
"""

import dataclasses
import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._arrays import on_device
from ..._job import Job
from ..._moving_rows import is_moving, step_lengths
from ..._padding import padded_count
from ..._types import Transform
from ...process import FrozenStock, Process
from ...robot import ArmTerms, Robot
from ...workpiece import Pose
from .._job.simulate import Solution, job_process, simulate
from .._machine.commands import JobKinematics
from .._machine.elastic import ElasticArm
from .._machine.modal import ModalMachine
from .force_jacobian import force_slopes
from .linear_arm import LinearArm, linear_arms, linear_modes
from .monodromy import Regeneration, Step, monodromy, strongest
from .quick_force_jacobian import quick_slopes

# Rows that are looked at unless asked for, and those of a quick look.
_ROWS, _QUICK_ROWS = 100, 24
# Tooth periods over which a cross section of the chip must last to be judged by it, and
# over which the mean of a vibration is the deflection about which it swings.
_LASTING, _MEAN = 8, 16
# A vibration that does not even double before the cut calms it again reaches nothing.
_CHATTER = math.log(2)
# An undamped arm in the air has the radius 1; rounding must not make it unstable.
_TOLERANCE = 1e-4
# Of a vibration that is gone after one period.
_LEAST_RADIUS = 1e-30
# Steps of the analysis per turn of the fastest mode that counts, and per tooth period.
_STEPS, _LEAST, _MOST = 24, 48, 1200
# Steps per turn with which the forces of a vibration are right to 3 % here, and with
# which the midpoint rule keeps a frequency to 5 %.
_JUDGED, _FOLLOWED = 10, 8
# A mode counts from this share of the gain with which it could swing by itself: what
# other modes add is little.
_EXCITED = 0.5


class Stability(eqx.Module):
    """Growth of vibrations at some rows of a run.

    Attributes:
        row: The rows: of the tooth periods that end there, shape (row,).
        time: [s], shape (row,).
        position: Tool tip in `work` [m], shape (row, 3).
        radius: Largest magnitude of the eigenvalues: the factor by which the fastest
            growing vibration grows per tooth period [-], shape (row,).
        frequency: Frequency of that vibration [Hz], shape (row,).
        apparent_frequency: Frequency at which it shows in the poses, one per tooth
            period [Hz], shape (row,); at most half the tooth passing frequency.
        free_growth: Logarithm of the factor by which that vibration grows per tooth
            period in the air [-], shape (row,); negative, since the machine damps it.
        log_growth: Logarithm of the largest factor by which a vibration grows that
            passes an unstable row [-], shape (row,); 0 at stable rows and where the
            tool nearly rests.
        tooth_frequency: Tooth passing frequency [Hz].
        fastest_mode: Frequency of the fastest mode that the cut could excite [Hz]; 0
            if there is none.
        substeps: Sub-steps of the simulation per tooth period.
        steps: Steps of this analysis per tooth period.
    """

    row: Int[np.ndarray, " row"]
    time: Float[np.ndarray, " row"]
    position: Float[np.ndarray, "row 3"]
    radius: Float[np.ndarray, " row"]
    frequency: Float[np.ndarray, " row"]
    apparent_frequency: Float[np.ndarray, " row"]
    free_growth: Float[np.ndarray, " row"]
    log_growth: Float[np.ndarray, " row"]
    tooth_frequency: float
    fastest_mode: float
    substeps: int = eqx.field(static=True)
    steps: int = eqx.field(static=True)

    @property
    def is_unstable(self) -> Bool[np.ndarray, " row"]:
        """True where a vibration grows, shape (row,)."""
        return self.radius > 1 + _TOLERANCE

    @property
    def has_chatter(self) -> Bool[np.ndarray, " row"]:
        """True where a vibration has the time to double, shape (row,)."""
        return self.log_growth >= _CHATTER

    @property
    def strongest(self) -> int:
        """Index of the fastest growth of those that chatter, or of all if none does."""
        counts = self.has_chatter | ~self.has_chatter.any()
        return int(np.argmax(np.where(counts, self.radius, 0.0)))

    def warning(self) -> str | None:
        """Warning of an unstable cut, or None."""
        if not self.has_chatter.any():
            return None
        k, count = self.strongest, int(self.has_chatter.sum())
        first = float(self.time[np.argmax(self.has_chatter)])
        x, y, z = self.position[k] * 1e3
        growth, largest = float(self.radius[k]) - 1, float(self.log_growth.max())
        # Far beyond what a tool that leaves the material reaches.
        is_endless = largest > math.log(1e3)
        in_all = "over 1000-fold" if is_endless else f"{math.exp(largest):.3g}-fold"
        return (
            f"the cut is unstable (chatter) at {count} of the {len(self.row)} rows "
            f"examined, from time {first:.3f} s; most at {self.time[k]:.3f} s, "
            f"position ({x:.2f}, {y:.2f}, {z:.2f}) mm: a vibration at "
            f"{self.frequency[k]:.1f} Hz grows by {100 * growth:.2g} % "
            f"per tooth period, threefold in {1.1 / self.tooth_frequency / growth:.2g} "
            f"s, and {in_all} in the worst stretch; a smaller depth of cut, another "
            "spindle speed or more damping calms it, a corrected path does not"
        )

    def note(self) -> str:
        """Sentence about a cut without chatter."""
        if not self.is_unstable.any():
            return (
                f"of {len(self.row)} rows none is unstable; the fastest growing "
                f"vibration has the factor {self.radius.max():.3f} per tooth period"
            )
        k = int(np.argmax(np.where(self.is_unstable, self.log_growth, -1.0)))
        x, y, z = self.position[k] * 1e3
        return (
            f"vibrations grow at {int(self.is_unstable.sum())} of {len(self.row)} "
            f"rows, too briefly for chatter: most at {self.time[k]:.3f} s, position "
            f"({x:.2f}, {y:.2f}, {z:.2f}) mm, by the factor "
            f"{math.exp(self.log_growth[k]):.3g} in all while the tool moves there"
        )

    def visibility(self) -> str:
        """Note on the frequencies that a run and its check cannot show."""
        f = self.tooth_frequency
        followed, judged = f * self.substeps / _FOLLOWED, f * self.steps / _JUDGED
        text = (
            f"poses are kept once per tooth, at {f:.1f} Hz: a vibration above "
            f"{f / 2:.1f} Hz shows in them at a lower frequency, its distance from the "
            f"nearest multiple of {f:.1f} Hz, and one at such a multiple as a constant "
            f"shift; sub-steps of the simulation follow vibrations below "
            f"{followed:.0f} Hz, the stability is that of vibrations below "
            f"{judged:.0f} Hz"
        )
        if self.fastest_mode > judged:
            text += f", not of the mode at {self.fastest_mode:.0f} Hz"
        if self.fastest_mode > followed:
            needed = math.ceil(_FOLLOWED * self.fastest_mode / f)
            text += (
                f"; the cut could excite the mode at {self.fastest_mode:.0f} Hz, which "
                f"the simulation follows with [simulation] substeps = {needed}"
            )
        return text

    @staticmethod
    def along(
        arm: ElasticArm | ModalMachine,
        process: Process,
        motor_positions: Float[Array, "step joint"],
        joint_positions: Float[Array, "step joint"],
        rows: Sequence[int] | Int[np.ndarray, " row"],
        *,
        is_moving_cut: Bool[np.ndarray, " step"] | None = None,
    ) -> "Stability":
        """Growth of vibrations along a motion; see `stability`.

        Args:
            arm: The machine; its integrator does not count.
            process: The process, with the chip model "near_far".
            motor_positions: theta at the tooth instants [rad or m], shape (step,
                joint); of a machine of modes its command.
            joint_positions: Joints there [rad or m], shape (step, joint); of a machine
                of modes its poses, as a command has them.
            rows: Rows to examine, from 1.
            is_moving_cut: Rows at which the tool cuts and does not nearly stand, shape
                (step,); vibrations grow there. If not given, all at which it moves.

        Returns:
            The growth, on the host.

        Raises:
            ValueError: If a row does not exist.

        Differentiability: none, a host function.
        """
        chosen = np.unique(np.asarray(rows, dtype=np.int32))
        step_count = joint_positions.shape[0]
        if chosen.size == 0 or chosen.min() < 1 or chosen.max() >= step_count:
            raise ValueError(
                f"Argument `rows` must have rows from 1 to {step_count - 1}, but is "
                f"{rows}."
            )
        engagement = process.engagement
        path = tool_poses(arm, joint_positions, is_upright=engagement.is_upright)
        # The force has its slopes at every angle that is looked at.
        substeps = engagement.angles // process.cutter.flute_count
        slopes = force_slopes(process, path, chosen, substeps)
        motion = ToolMotion(motor_positions, joint_positions, path.tip[:step_count])
        found = _growth(arm, process, motion, chosen, slopes)
        if is_moving_cut is None:
            is_moving_cut = is_moving(
                step_lengths(motion.tips), np.ones(step_count, bool)
            )
        return _with_total(found, is_moving_cut)

    @staticmethod
    def where_suspected(job: Job, solution: Solution) -> "Stability | None":
        """Growth of vibrations where a quick check finds that they may grow.

        The quick look takes the largest lasting cross section of the chip in each of a
        few shares of the removed volume, and the slopes of its force from where the
        tool has been (`_analysis/quick_force_jacobian.py`). Where it suspects one row
        the whole path is looked at as by `stability`; what chatters between its rows
        alone is missed.

        Args:
            job: The job.
            solution: Its solution.

        Returns:
            The growth along the whole path; None where nothing grows, also for a rigid
            machine and a quasi-static job.

        Differentiability: none, a host function.
        """
        if job.is_rigid or not job.simulation.mode.vibrates:
            return None
        rows = deep_rows(solution)
        if rows.size == 0:
            return None
        job = job.with_precision()
        machine, process, motion = (
            stability_machine(job),
            stability_process(job),
            job_motion(job, solution),
        )
        path = Pose(motion.tips)
        if not process.engagement.is_upright:
            path = tool_poses(machine, motion.joints, is_upright=False)
        slopes = quick_slopes(process, path, rows)
        if not _growth(machine, process, motion, rows, slopes).is_unstable.any():
            return None
        # A few deep rows do not tell for how long it grows: the whole path does.
        found = stability(job, solution)
        return found if found.is_unstable.any() else None


def stability(
    job: Job,
    solution: Solution | None = None,
    *,
    rows: Sequence[int] | Int[np.ndarray, " row"] | None = None,
) -> Stability:
    """Growth of vibrations along the path of a job.

    The removal is replayed along the simulated path, and the coupled step linearised
    at the rows. With the chip model "point_cloud" the chip of "near_far" is taken.

    Args:
        job: The job; its machine must not be rigid.
        solution: Its solution; simulated if not given.
        rows: Rows to examine, from 1; if not given, up to 124 rows where the tool
            cuts and does not nearly rest: evenly spread, and those of a quick look.

    Returns:
        The growth, on the host.

    Raises:
        ValueError: If the machine is rigid, the job is quasi-static, a row does not
            exist, or the tool never cuts.

    Differentiability: none, a host function.
    """
    check_vibrates(job)
    job = job.with_precision()
    solution = simulate(job) if solution is None else solution
    is_moving_cut = _moving_cut(solution)
    if rows is None:
        cutting = np.flatnonzero(is_moving_cut)
        if cutting.size == 0:
            raise ValueError("Argument `solution` must cut somewhere, but does not.")
        rows = cutting[cutting > 0][:: math.ceil(cutting.size / _ROWS)]
        rows = np.concatenate([rows, deep_rows(solution)])
    motion = job_motion(job, solution)
    return Stability.along(
        stability_machine(job),
        stability_process(job),
        motion.motors,
        motion.joints,
        rows,
        is_moving_cut=is_moving_cut,
    )


def check_vibrates(job: Job) -> None:
    """Raise if the machine of a job cannot vibrate.

    Raises:
        ValueError: It is rigid, or the job is quasi-static.
    """
    if job.is_rigid:
        raise ValueError("Argument `job` must not have a rigid machine, but has.")
    if not job.simulation.mode.vibrates:
        raise ValueError(
            'Argument `job` must have mode "dynamic", but has '
            f'"{job.simulation.mode.name}", in which nothing vibrates.'
        )


def _moving_cut(solution: Solution) -> Bool[np.ndarray, " step"]:
    """Rows in which the tool cuts and the program does not nearly stand."""
    return is_moving(step_lengths(solution.desired), np.asarray(solution.is_cutting))


def _with_total(
    found: Stability, is_moving_cut: Bool[np.ndarray, " step"]
) -> Stability:
    """Return the growth with the largest factor of a vibration that passes each row.

    A row stands for the periods of the moving cut that are nearer to it than to others.
    Between them, in the air and where the tool nearly rests, a vibration decays as it
    does in the air; it begins anew where nothing is left of it.

    Args:
        found: The growth at rows in ascending order.
        is_moving_cut: Where the tool cuts and does not nearly stand, shape (step,).
    """
    known = np.flatnonzero(is_moving_cut[found.row])
    total = np.zeros(len(found.row))
    if not known.size:
        return found
    rows, moving = found.row[known], np.flatnonzero(is_moving_cut)
    nearest = np.searchsorted((rows[1:] + rows[:-1]) / 2, moving)
    periods = np.bincount(nearest, minlength=known.size)
    growth = periods * np.log(np.maximum(found.radius[known], _LEAST_RADIUS))
    # Of the row before the pause.
    pauses = np.diff(rows) - np.diff(np.searchsorted(moving, rows))
    decay = pauses * np.minimum(found.free_growth[known][:-1], 0.0)
    largest, start, size = 0.0, 0, 0.0
    for k, more in enumerate(growth):
        size += decay[k - 1] if k else 0.0
        if size <= 0:
            size, largest, start = 0.0, 0.0, k
        size += more
        if size > largest:
            largest = size
            total[known[start : k + 1]] = largest
    return dataclasses.replace(
        found, log_growth=np.where(found.is_unstable, total, 0.0)
    )


def deep_rows(solution: Solution) -> Int[np.ndarray, " row"]:
    """Return the rows of the largest chips that last, in shares of the removed volume.

    The chip is that of the rigid tool: one that vibrates leaves now more and now less.
    """
    rows = np.flatnonzero(_moving_cut(solution))
    rows = rows[rows > 0]
    volume = np.maximum(np.asarray(solution.rigid.removed_volume)[rows], 0.0)
    if not volume.any():
        return rows[:0]
    window = np.ones(min(_LASTING, rows.size))
    lasting = lambda x: np.convolve(x, window, "same")
    area = lasting(volume) / lasting(step_lengths(solution.desired)[rows])
    done = np.cumsum(volume)
    share = np.ceil(_QUICK_ROWS * done / done[-1]) - 1
    deepest = [rows[share == k][np.argmax(area[share == k])] for k in np.unique(share)]
    # As many rows for every job: one compiled program.
    return np.resize(np.array(deepest), _QUICK_ROWS)


def stability_process(job: Job) -> Process:
    """Return the process of a job with the chip model "near_far", edges along the side.

    A bottom edge on a level floor has a chip on one side of a kink and none on the
    other: its slope is that of no vibration, and the depth of the cut is held anyway.
    """
    settings = dataclasses.replace(job.simulation, chip="near_far", has_bottom=False)
    return job_process(dataclasses.replace(job, simulation=settings), FrozenStock())


def stability_machine(job: Job) -> ElasticArm | ModalMachine:
    """Return the machine of a job in its precision."""
    if job.modes is not None:
        return ModalMachine(job.modes)
    assert job.robot is not None
    return ElasticArm(job.robot, job.T_base_work)


def job_motion(job: Job, solution: Solution) -> "ToolMotion":
    """Return the motion of a solution without the vibrations about it.

    The map is that of small ones: a tool that chatters already has grown beyond them.
    """
    tips = _mean_about(solution.commanded, solution.actual)
    if job.modes is not None:
        rows = JobKinematics(job).tool_command
        return ToolMotion(rows(solution.commanded), rows(tips), tips)
    motors, joints = solution.motor_positions, solution.joint_positions
    assert motors is not None and joints is not None
    return ToolMotion(motors, _mean_about(motors, joints), tips)


def _mean_about(
    command: Float[Array, "step axis"], actual: Float[Array, "step axis"]
) -> Float[Array, "step axis"]:
    """Return a motion with the mean of its deviation over some periods."""
    from scipy.ndimage import uniform_filter1d

    deviation = np.asarray(actual) - np.asarray(command)
    mean = uniform_filter1d(deviation, _MEAN, axis=0, mode="nearest")
    return on_device(np.asarray(command) + mean.astype(actual.dtype))


def tool_poses(
    machine: ElasticArm | ModalMachine,
    positions: Float[Array, "step joint"],
    *,
    is_upright: bool,
) -> Pose:
    """Return the tool's poses in `work`, as many as one of few lengths."""
    rows = _padded(positions)
    if isinstance(machine, ElasticArm):
        return joint_poses(machine.robot, machine.T_base_work, rows, is_upright)
    return Pose(rows[:, :3], None if is_upright else rows[:, 3:])


def _padded(rows: Float[Array, "step joint"]) -> Float[Array, "padded joint"]:
    """Return rows with the last one again, as many as one of few lengths."""
    at = np.minimum(np.arange(padded_count(rows.shape[0])), rows.shape[0] - 1)
    return on_device(np.asarray(rows)[at])


@dataclasses.dataclass(frozen=True)
class ToolMotion:
    """Motors, joints and tips at the tooth instants.

    Attributes:
        motors: [rad or m], shape (step, joint); of a machine of modes its command.
        joints: [rad or m], shape (step, joint); of a machine of modes its poses.
        tips: Tool tips in `work` [m], shape (step, 3).
    """

    motors: Float[Array, "step joint"]
    joints: Float[Array, "step joint"]
    tips: Float[Array, "step 3"]


def linear_machine(
    machine: ElasticArm | ModalMachine,
    motion: ToolMotion,
    rows: Int[np.ndarray, " row"],
    T: float,
) -> LinearArm:
    """Return the machine in the middle of the periods before some rows."""
    if isinstance(machine, ModalMachine):
        return linear_modes(machine.modes, len(rows))
    motors, joints = (np.asarray(x) for x in (motion.motors, motion.joints))
    before = rows - 1
    return linear_arms(
        machine.robot,
        jnp.asarray(machine.T_base_work),
        on_device((motors[before] + motors[rows]) / 2),
        on_device((joints[before] + joints[rows]) / 2),
        on_device((joints[rows] - joints[before]) / T),
    )


def _growth(
    arm: ElasticArm | ModalMachine,
    process: Process,
    motion: ToolMotion,
    rows: Int[np.ndarray, " row"],
    slopes: Sequence[Sequence[Regeneration]],
) -> Stability:
    """Return the growth in the periods before some rows, by the slopes of the force.

    That along whole stretches is left to the caller, who knows where the tool moves.
    """
    T = float(process.tooth_period)
    arms = linear_machine(arm, motion, rows, T)
    A, G, C = (np.asarray(x, np.float64) for x in (arms.A, arms.G, arms.C))
    gains = [max(period.gain() for period in periods) for periods in slopes]
    fastest = max(map(fastest_mode, A, G, C, gains))
    steps = needed_steps(T, fastest)
    found, free = [], []
    for A_k, G_k, C_k, periods in zip(A, G, C, slopes, strict=True):
        over_step = Step.of(A_k, G_k, T / steps)
        periods = [period.in_steps(steps) for period in periods]
        found.append(strongest(monodromy(over_step, C_k, periods), T))
        # The mode that is nearest to it swings on in the air.
        poles = np.linalg.eigvals(A_k)
        off = np.abs(np.abs(poles.imag) - 2 * math.pi * found[-1].frequency)
        free.append(T * poles.real[np.argmin(off)])
    radius, frequency, apparent = np.array(found).T
    return Stability(
        row=rows,
        time=rows * T,
        position=np.asarray(motion.tips)[rows],
        radius=radius,
        frequency=frequency,
        apparent_frequency=apparent,
        free_growth=np.array(free),
        log_growth=np.zeros(len(rows)),
        tooth_frequency=1 / T,
        fastest_mode=fastest,
        substeps=process.engagement.substeps,
        steps=steps,
    )


def needed_steps(tooth_period: float, fastest: float) -> int:
    """Return the steps of a tooth period in which the fastest mode is followed.

    Args:
        tooth_period: [s].
        fastest: Frequency of that mode [Hz].
    """
    return int(np.clip(math.ceil(_STEPS * tooth_period * fastest), _LEAST, _MOST))


def fastest_mode(
    A: Float[np.ndarray, "state state"],
    G: Float[np.ndarray, "state 3"],
    C: Float[np.ndarray, "3 state"],
    gain: float,
) -> float:
    """Return the frequency of the fastest mode that the cut could excite [Hz].

    A loop whose gain is below 1 at all frequencies cannot swing by itself: that of the
    force times that of a mode, |R| / |Re lambda| for its residue and its pole.
    """
    poles, shapes = np.linalg.eig(A.astype(complex))
    residues = (C @ shapes).T[:, :, None] * (np.linalg.pinv(shapes) @ G)[:, None]
    size = np.linalg.norm(residues, axis=(1, 2))
    is_excited = gain * size >= _EXCITED * np.abs(np.real(poles))
    omega = np.abs(np.imag(poles[is_excited]))
    return float(np.max(omega, initial=0.0)) / (2 * np.pi)


@eqx.filter_jit
def joint_poses(
    robot: Robot,
    T_base_work: Transform,
    joint_positions: Float[Array, "step joint"],
    is_upright: bool,
) -> Pose:
    """Return the tool's poses in `work`, shape (step, 3)."""
    tool = jax.vmap(
        lambda q: ArmTerms.of_state(robot, q, jnp.zeros_like(q)).T_base_tool
    )
    Ts = tool(joint_positions)
    frame = jnp.asarray(T_base_work, joint_positions.dtype)
    to_base = frame[:3, :3]
    tips = (Ts[:, :3, 3] - frame[None, :3, 3]) @ to_base
    return Pose(tips, None if is_upright else Ts[:, :3, 2] @ to_base)
