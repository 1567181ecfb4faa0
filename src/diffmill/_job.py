"""A job: everything that one simulation or correction needs, as one pytree.

Numbers that change from run to run are leaves (they differentiate and do not
recompile); counts, names and choices are static. Reading a job from a file, units
and the error that lists every fault are in `diffmill.config`.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.tree_util import GetAttrKey, register_pytree_with_keys
from jaxtyping import Array, Float

from ._arrays import cast_floats, has_values, is_traced
from ._messages import html_rows
from ._types import FloatRows3, RealScalarLike, Transform
from .cutter import AbstractCutter, ToolHolder
from .cutting import AbstractForceLaw
from .robot import Controller, NominalRobot, Robot, TipModes, ToolRotation
from .settings.base import Settings
from .settings.correction import CorrectionSettings
from .settings.output import OutputSettings
from .settings.simulation import SimulationSettings
from .settings.truth import TruthSettings
from .toolpath import Path, ProgramTiming
from .workpiece import Stock

# Share of a tooth period by which rows may be off: times of float32 are rounded.
_PERIOD_SHARE = 0.01


def _register(kind: type[Settings]) -> None:
    """Make a class of settings a node of JAX's trees, static but for its leaves."""

    def flatten(settings: Settings) -> tuple[list[tuple[object, object]], Settings]:
        leaves = settings.leaves()
        keys = map(GetAttrKey, settings.leaf_names())
        static = settings.with_leaves([None] * len(leaves))
        return list(zip(keys, leaves, strict=True)), static

    register_pytree_with_keys(kind, flatten, Settings.with_leaves)


for _kind in (
    CorrectionSettings,
    OutputSettings,
    SimulationSettings,
    TruthSettings,
):
    _register(_kind)


class Job(eqx.Module):
    """A cut to predict and correct.

    Attributes:
        name: Name of the job, for messages and file names.
        cutter: The milling cutter.
        law: The force law with its coefficients.
        spindle_speed: [rad/s].
        stock: The workpiece before the cut.
        path: The desired path, sampled at the tooth instants.
        robot: The robot with its tool, or None for a rigid machine and one of modes.
        T_base_work: Pose of the workpiece frame in the robot's base, shape (4, 4); of a
            machine that its controller does not know, where a probe finds it.
        joint_start: Joint angles near which inverse kinematics begins [rad],
            shape (joint,), or None for the robot's home.
        simulation: Numerical settings.
        correction: Settings of the correction.
        source: The job file's text, for the record in the results; may be empty.
        program: The program's text as read, for writing the corrected one.
        notes: What the user should know but what is no fault.
        bottom_law: The force law of the bottom edges, or None for the one that `law`
            derives (`law.for_bottom()`).
        holder: What holds the cutter, to look for in the stock; None if not known.
        tool_rotation: Rotation about the tool axis: "fixed", that of `path.tool_x` or,
            without it, tool x as near to x of `work` as the axis allows, or "free",
            chosen by the inverse kinematics.
        modes: The modes at the tool tip, in the axes of the work, of a machine that is
            given by them; None for a robot and a rigid machine.
        keeps_intervals: Whether the rays of the stock keep the slots that they have;
            else a run that needs more is repeated with more.
        controller: What the robot's motors do of their command; None if they follow it.
        output: How a corrected program is written.
        timing: How the program was timed; None for a recorded path.
        commanded: Tip positions that the program commands instead of those of the path
            [m], shape (step, 3), for a simulation; None for those of the path.
        nominal: Robot and work as the controller knows them; None if the machine is as
            it knows it.
        truth: Machines on which the commands of a correction are run, too.
        probes: Points of the work that are touched off on a machine that its controller
            does not know [m], shape (probe, 3); rows of the path if None.
    """

    name: str = eqx.field(static=True)
    cutter: AbstractCutter
    law: AbstractForceLaw
    spindle_speed: RealScalarLike
    stock: Stock
    path: Path
    robot: Robot | None
    T_base_work: Transform
    joint_start: Float[Array, " joint"] | Float[np.ndarray, " joint"] | None
    simulation: SimulationSettings
    correction: CorrectionSettings = CorrectionSettings()
    source: str = eqx.field(static=True, default="")
    program: str = eqx.field(static=True, default="")
    notes: tuple[str, ...] = eqx.field(static=True, default=())
    bottom_law: AbstractForceLaw | None = None
    holder: ToolHolder | None = None
    tool_rotation: ToolRotation = eqx.field(static=True, default="fixed")
    keeps_intervals: bool = eqx.field(static=True, default=False)
    output: OutputSettings = OutputSettings()
    controller: Controller | None = None
    modes: TipModes | None = None
    timing: ProgramTiming | None = eqx.field(static=True, default=None)
    commanded: FloatRows3 | None = None
    nominal: NominalRobot | None = None
    truth: TruthSettings = TruthSettings()
    probes: FloatRows3 | None = None

    def __check_init__(self):
        if self.robot is not None and self.modes is not None:
            raise ValueError("Argument `modes` must be None beside a robot.")
        if self.robot is None and self.nominal is not None:
            raise ValueError("Argument `nominal` must be None without a robot.")

    def __repr__(self) -> str:
        """Cutter, force law, stock and machine of the job, in five lines."""
        read = (self.spindle_speed, self.path.time, self.stock.families[0].ends)
        if not has_values(*read) or is_traced(self) or np.ndim(read[0]) > 0:
            return f"Job({self.name!r}, traced, stacked or without values)"
        machine = "rigid"
        if self.modes is not None:
            machine = f"{len(np.asarray(self.modes.frequencies))} modes at the tool tip"
        elif self.robot is not None:
            machine = f"{self.robot.name}, {self.robot.joint_count} joints"
        kind = type(self.cutter).__name__
        return (
            f"Job {self.name!r}: {self.path.step_count} rows in "
            f"{float(self.path.time[-1] - self.path.time[0]):.3f} s\n"
            f"  cutter: {kind}, {2e3 * self.cutter.nominal_radius:g} mm, "
            f"{self.cutter.flute_count} teeth, "
            f"{float(self.spindle_speed) * 30 / math.pi:.0f} rpm\n"
            f"  force: {type(self.law).__name__}\n"
            f"  stock: {1e9 * float(self.stock.volume()):.1f} mm^3, rays "
            f"{1e3 * self.stock.spacing:g} mm apart\n"
            f"  machine: {machine}"
        )

    def _repr_html_(self) -> str:
        """The same lines as a table, for notebooks."""
        return html_rows(repr(self))

    def replace(self, **changes: object) -> "Job":
        """Job with other values of some attributes, such as `correction`.

        Args:
            changes: New values by the names of the attributes.

        Raises:
            ValueError: An attribute does not exist.

        Differentiability: the same as that of the values.
        """
        known = [field.name for field in dataclasses.fields(self)]
        if unknown := sorted(set(changes) - set(known)):
            raise ValueError(
                f"Arguments must be attributes of a job ({', '.join(known)}), but "
                f"found {', '.join(unknown)}."
            )
        return dataclasses.replace(self, **changes)

    @property
    def is_rigid(self) -> bool:
        """True if the machine goes where it is told."""
        return self.robot is None and self.modes is None

    @property
    def as_known(self) -> "Job":
        """The job with the machine as its controller knows it."""
        known = self.nominal
        if known is None:
            return self
        return dataclasses.replace(
            self, robot=known.robot, T_base_work=known.T_base_work, nominal=None
        )

    @property
    def tooth_period(self) -> RealScalarLike:
        """Time between two teeth T = 2 pi / (omega N_z) [s]."""
        return 2 * 3.141592653589793 / (self.spindle_speed * self.cutter.flute_count)

    @property
    def tool_axes(self) -> Float[Array, "step 3"] | None:
        """Tool axes of the path, None if the tool is upright."""
        return jnp.asarray(self.path.axes) if self.simulation.axes else None

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters in the order of `with_scaled`.

        "K" and "D" with the name of a joint or mode for stiffness and damping, the
        force law's own names, and "speed".
        """
        springs = [f"{letter} {name}" for letter in "KD" for name in self._springs()]
        return (*springs, *self.law.parameter_names, "speed")

    def with_scaled(self, log_scale: Float[Array, " parameter"]) -> "Job":
        """Return the job with every parameter times the exponential of a number.

        Args:
            log_scale: Logarithms of the factors in the order of `parameter_names`,
                shape (parameter,).

        Returns:
            The job; all teeth's values of a coefficient have the same factor. Where
            the controller does not know the machine, the work is touched off anew.

        Raises:
            ValueError: The machine is rigid.

        Differentiability: smooth.
        """
        factor = jnp.exp(log_scale)
        count, names = len(self._springs()), self.law.parameter_names
        stiffness, damping = factor[:count], factor[count : 2 * count]
        coefficients = factor[2 * count : -1]
        # A law of the bottom edges that is given is as uncertain as that of the side.
        places = [
            (law, name)
            for law in ("law", "bottom_law")
            for name in getattr(getattr(self, law), "parameter_names", ())
            if name in names
        ]
        values = lambda job: [getattr(getattr(job, law), name) for law, name in places]
        leaves = lambda job: [*job._drives(), *values(job), job.spindle_speed]
        if self.modes is None:
            scales = [stiffness, damping]
        else:
            # At the same modal mass: omega^2 is the stiffness, 2 zeta omega the
            # damping.
            root = jnp.sqrt(stiffness)
            scales = [root, damping / root]
        drives = [x * scale for x, scale in zip(self._drives(), scales, strict=True)]
        law = [
            jnp.asarray(x) * coefficients[names.index(name)]
            for x, (_, name) in zip(values(self), places, strict=True)
        ]
        speed = jnp.asarray(self.spindle_speed) * factor[-1]
        job = eqx.tree_at(leaves, self, [*drives, *law, speed])
        return job if job.nominal is None else job.touched_off()

    def touched_off(self) -> "Job":
        """The job with its work where the probe of its machine finds it.

        The same where the controller knows the machine.

        Differentiability: as `NominalRobot.touch_off`.
        """
        if self.nominal is None or self.robot is None:
            return self
        frame = self.nominal.touch_off(self.robot)
        return dataclasses.replace(self, T_base_work=frame)

    def _springs(self) -> tuple[str, ...]:
        """Return the names of what is soft: joints or modes."""
        if self.modes is not None:
            return tuple(f"mode {k + 1}" for k in range(len(self.modes.frequencies)))
        if self.robot is None:
            raise ValueError("Argument `job` must not have a rigid machine, but has.")
        return self.robot.joint_names

    def _drives(self) -> list[Any]:
        """Return the leaves that say how soft and how damped the machine is."""
        if self.modes is not None:
            return [self.modes.frequencies, self.modes.damping_ratios]
        assert self.robot is not None
        return [self.robot.joint_stiffness, self.robot.joint_damping]

    def with_precision(self) -> "Job":
        """Return the job with all its numbers in its precision.

        Raises:
            ValueError: float64 is asked for and `jax_enable_x64` is off.
        """
        dtype = jnp.dtype(self.simulation.precision)
        if dtype == jnp.float64 and jnp.result_type(float) != dtype:
            raise ValueError(
                'Argument `job` must have precision "float32", or '
                'jax.config.update("jax_enable_x64", True) must come first.'
            )
        return cast_floats(self, dtype)

    def with_intervals(self, counts: Sequence[int]) -> "Job":
        """Return the job with slots for so many intervals along x, y and z, and a note.

        The same job if it has so many.

        **Differentiability**: runs on the host.
        """
        if tuple(counts) == self.stock.interval_counts:
            return self
        note = (
            "[stock] intervals: the rays were given {0} intervals along x, y and z, "
            "since the program needs more than it began with; intervals = [{0}] "
            "begins with them, and saves the second start"
        )
        mark = note.split("{0}")[0]
        notes = tuple(n for n in self.notes if not n.startswith(mark))
        listed = ", ".join(str(count) for count in counts)
        return dataclasses.replace(
            self,
            stock=self.stock.with_interval_counts(counts),
            notes=(*notes, note.format(listed)),
        )


def parameter_uncertainty(
    names: tuple[str, ...],
    *,
    stiffness: RealScalarLike,
    damping: RealScalarLike,
    force: RealScalarLike,
) -> Float[np.ndarray, " parameter"]:
    """Return the relative uncertainty of every parameter of a job.

    Args:
        names: `Job.parameter_names`.
        stiffness: That of every joint's stiffness.
        damping: That of every joint's damping.
        force: That of every force coefficient. Exponents (m_t, m_r, m_a) keep their
            value: by a tenth of itself one changes the force by another share.

    Returns:
        Uncertainties, shape (parameter,); 0 for the speed.
    """
    kinds = {"K ": stiffness, "D ": damping, "m_": 0.0}
    sizes = [0.0 if name == "speed" else kinds.get(name[:2], force) for name in names]
    return np.array(sizes, np.float64)


def check_job(job: object) -> None:
    """Raise if an argument from outside is no job, or has other rows than teeth.

    What is traced has no times to look at.

    Args:
        job: The argument.

    Raises:
        TypeError: It is no job.
        ValueError: The rows of its path are not a tooth period apart.
    """
    if not isinstance(job, Job):
        raise TypeError(
            "Argument `job` must be a Job, as `load_job` returns it, but is "
            f"{job!r:.80}."
        )
    if is_traced(job) or not has_values(job.path.time, job.tooth_period):
        return
    time, period = np.asarray(job.path.time, np.float64), float(job.tooth_period)
    steps = np.diff(time)
    row = int(np.argmax(np.abs(steps - period)))
    if not abs(steps[row] - period) <= _PERIOD_SHARE * period:
        raise ValueError(
            "Argument `job` must have a path with a row per tooth period, "
            f"{1e3 * period:.6g} ms at this speed and number of teeth, but its rows "
            f"{row} and {row + 1} are {1e3 * steps[row]:.6g} ms apart."
        )
