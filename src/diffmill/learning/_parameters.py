"""Parameters of a machine that may be wrong, in units of their priors."""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._job import Job
from .._types import FloatRows, RealScalarLike, Transform
from ..cutting import AbstractForceLaw
from ..process import FrozenStock, wall_deviation
from ..robot import Controller, Robot, jacobian
from ..sim import (
    DrivenRun,
    MachiningProblem,
    Run,
    Solution,
    drive_torques,
    linearise,
    mismatched,
    rigid_cut,
)
from ._measurement import Observables

# Of a robot without friction of its own: by which a joint yields before it slides [rad
# or m], and the rate above which it slides where a run begins [rad/s or m/s]. A law
# that creeps would lose what an axis that stands still keeps.
_PRESLIDING, _FRICTION_SPEED = 5e-6, 2e-3
# Width of the rounded corners of a gap, as a share of it: of runs, and of their slopes.
# Slopes at a sharp corner hold for a micrometre, and mislead a search that goes on.
_CORNER, _SMOOTH_CORNER = 0.2, 1.0
# Gaps below this share of their prior are none; slopes are taken at no less than
# `_LEAST_SLOPE`, since a gap of nothing has none.
_LEAST_GAP, _LEAST_SLOPE = 0.02, 0.3
# Change of friction and gaps for secants, in prior sizes.
_SECANT = 0.5
# Friction and gaps about which slopes are first taken, in prior sizes.
_EXPECTED = 1.0
# Change of the logarithm of a force coefficient, for differences.
_FORCE_STEP = 0.1

Rows3 = Float[np.ndarray, "step 3"]
# Groups of parameters, in their order.
GROUPS = (
    *("stiffness", "damping", "force", "friction", "backlash", "servo"),
    *("radius", "field"),
)


class MachinePrior(eqx.Module):
    """Sizes of what may be wrong in a model, before a part is measured.

    Standard deviations, of friction and gaps half-normal. One value for all joints, or
    one each.

    Attributes:
        stiffness: Of the logarithm of each joint's stiffness [-].
        damping: Of the logarithm of each joint's damping [-].
        force: Of the logarithm of all force coefficients together [-].
        coefficient: Of that of each coefficient besides [-].
        friction: Of the Coulomb friction of each joint, as the angle by which it bends
            the joint's spring [rad or m].
        backlash: Of the gap of each joint [rad or m].
        servo: Of the logarithm of the bandwidth of each servo, if the job has any [-].
        radius: Of what the cutter cuts beyond its radius by run-out, wear and size [m];
            points of walls alone show it.
        offset: Of the tip's error all over the work, along each axis [m].
        gradient: Of how that error grows over the work, each component [-].
    """

    stiffness: float | tuple[float, ...] = 0.1
    damping: float | tuple[float, ...] = 0.2
    force: float = 0.2
    coefficient: float = 0.07
    friction: float | tuple[float, ...] = 2e-5
    backlash: float | tuple[float, ...] = 3e-5
    servo: float | tuple[float, ...] = 0.1
    radius: float = 5e-6
    offset: float = 3e-5
    gradient: float = 2e-4


class Group(eqx.Module):
    """Parameters of one kind, one after the other.

    Attributes:
        name: "stiffness", "damping", "force", "friction", "backlash", "servo", "radius"
            or "field".
        first: Index of the first one.
        count: How many there are.
    """

    name: str = eqx.field(static=True)
    first: int = eqx.field(static=True)
    count: int = eqx.field(static=True)

    @property
    def index(self) -> np.ndarray:
        """Indices of the parameters."""
        return np.arange(self.first, self.first + self.count)


class AdaptableMachine(eqx.Module):
    """A job whose machine follows from parameters, in units of their priors.

    The controller goes on taking the machine for the job's own, and the work is touched
    off anew with every machine.

    Attributes:
        base: The job; its controller knows the model.
        sizes: Standard deviations of the priors, shape (parameter,).
        center: Point of the work about which the field turns [m], shape (3,).
        normals: Normals out of the walls that are known, see `wall_normals`, shape
            (step, 3).
        groups: The parameters by kind; the field is the last.
        names: Names of the parameters.
    """

    base: Job
    sizes: Float[np.ndarray, " parameter"]
    center: Float[np.ndarray, " 3"]
    normals: Rows3
    groups: tuple[Group, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)

    @classmethod
    def of_job(cls, job: Job, prior: MachinePrior) -> "AdaptableMachine":
        """Machine of a job that has a robot.

        Args:
            job: The job, in its precision.
            prior: Sizes of its parameters.
        """
        assert job.robot is not None
        base = mismatched(job, job) if job.nominal is None else job
        robot, law = job.robot, job.law
        joints, coefficients = robot.joint_names, law.parameter_names
        each = lambda size: np.broadcast_to(np.asarray(size, np.float64), len(joints))
        motors = robot.motor_mask()
        spring = np.where(motors, np.asarray(robot.joint_stiffness, np.float64), 0.0)
        exponents = [name.startswith("m_") for name in coefficients]
        kinds = {
            "stiffness": (each(prior.stiffness), [f"K {n}" for n in joints]),
            "damping": (each(prior.damping), [f"D {n}" for n in joints]),
            "force": (
                # One more: what all of them have in common. Exponents stay.
                np.r_[prior.force, np.where(exponents, 0.0, prior.coefficient)],
                ["force", *coefficients],
            ),
            "friction": (
                each(prior.friction) * spring,
                [f"friction {n}" for n in joints],
            ),
            "backlash": (
                np.where(motors, each(prior.backlash), 0.0),
                [f"backlash {n}" for n in joints],
            ),
            "servo": (
                np.where(motors & _has_servos(job), each(prior.servo), 0.0),
                [f"servo {n}" for n in joints],
            ),
            "radius": (np.full(1, prior.radius), ["radius of the cutter"]),
            "field": (
                np.r_[np.full(3, prior.offset), np.full(9, prior.gradient)],
                [
                    *(f"offset {a}" for a in "xyz"),
                    *(f"gradient {a}{b}" for a in "xyz" for b in "xyz"),
                ],
            ),
        }
        groups, first = [], 0
        for name, (sizes, _) in kinds.items():
            groups.append(Group(name, first, len(sizes)))
            first += len(sizes)
        positions = np.asarray(job.path.positions, np.float64)
        return cls(
            base=base,
            sizes=np.concatenate([sizes for sizes, _ in kinds.values()]),
            center=0.5 * (positions.min(axis=0) + positions.max(axis=0)),
            normals=np.zeros_like(positions),
            groups=tuple(groups),
            names=tuple(name for _, names in kinds.values() for name in names),
        )

    @property
    def count(self) -> int:
        """Number of parameters."""
        return len(self.names)

    def with_free(self, names: tuple[str, ...]) -> "AdaptableMachine":
        """The machine with parameters of some groups alone; others stay as modelled.

        Args:
            names: The groups.
        """
        sizes = np.zeros(self.count)
        for name in names:
            index = self.group(name).index
            sizes[index] = self.sizes[index]
        return dataclasses.replace(self, sizes=sizes)

    def group(self, name: str) -> Group:
        """Group of a name."""
        return next(group for group in self.groups if group.name == name)

    def units(self, name: str) -> tuple[str, ...]:
        """Units of the parameters of a group; "1" for a logarithm.

        Args:
            name: Name of the group.
        """
        assert self.base.robot is not None
        joints = self.base.robot.joint_units
        if name == "friction":
            return tuple({"rad": "N*m", "m": "N"}[unit] for unit in joints)
        if name == "backlash":
            return joints
        if name == "radius":
            return ("m",)
        if name == "field":
            return ("m",) * 3 + ("rad",) * 9
        return ("1",) * self.group(name).count

    @property
    def is_free(self) -> np.ndarray:
        """True for parameters whose prior is not zero, shape (parameter,)."""
        return self.sizes > 0

    @property
    def start(self) -> Float[np.ndarray, " parameter"]:
        """Parameters to begin with: the model, with some friction and gaps.

        Without friction a joint that carries no load floats in its gap, and no slope
        about that holds.
        """
        found = np.zeros(self.count)
        found[self._with_corners()] = _EXPECTED
        return found

    @property
    def lower(self) -> Float[np.ndarray, " parameter"]:
        """Lower bounds: friction and gaps are not negative, shape (parameter,)."""
        bounds = np.full(self.count, -np.inf)
        for name in ("friction", "backlash"):
            bounds[self.group(name).index] = 0.0
        return bounds

    def job_at(
        self, x: Float[np.ndarray, " parameter"], *, smooth: bool = False
    ) -> Job:
        """Job with the machine of some parameters, touched off.

        Args:
            x: Parameters in units of their priors, shape (parameter,).
            smooth: True for gaps with corners as round as those of slopes.
        """
        corner = _SMOOTH_CORNER if smooth else _CORNER
        return _touched_off(self, jnp.asarray(x), corner)

    def field(self, x: Float[np.ndarray, " parameter"], at: Rows3) -> Rows3:
        """Error of the tip at points of the work by the field alone [m]."""
        return np.einsum("kap,p->ka", self.field_columns(at), x)

    def field_columns(self, at: Rows3) -> Float[np.ndarray, "step 3 parameter"]:
        """Slopes of the tip at points of the work in the field's parameters [m]."""
        group = self.group("field")
        arm = np.asarray(at, np.float64) - self.center
        columns = np.zeros((len(arm), 3, self.count))
        for a in range(3):
            columns[:, a, group.first + a] = 1.0
            for b in range(3):
                columns[:, a, group.first + 3 + 3 * a + b] = arm[:, b]
        return columns * self.sizes

    def wall_columns(self) -> Float[np.ndarray, "step 3 parameter"]:
        """Slopes of the walls, as tips that stand in for them, in the radius [m]."""
        index = self.group("radius").first
        columns = np.zeros((*self.normals.shape, self.count))
        columns[:, :, index] = -self.normals * self.sizes[index]
        return columns

    def columns(
        self,
        x: Float[np.ndarray, " parameter"],
        rigid: Run,
        commanded: FloatRows,
        force_slopes: Float[Array, "step 3 coefficient"],
        *,
        on_share: Callable[[float], None] | None = None,
    ) -> Observables:
        """Slopes of what is seen of a run in the parameters, (step, 3, parameter).

        Stiffness and damping are torques along the path, which follow from where the
        joints are, and those of the force follow from the rigid cut. One linear system
        of the run, with slopes in the motors and in torques on the joints, carries any
        number of them. Friction and gaps have corners, and a joint that carries no load
        floats in its gap: their slopes are secants of whole runs.

        Args:
            x: Parameters, shape (parameter,).
            rigid: Rigid cut of the base.
            commanded: Commanded tips [m], shape (step, 3).
            force_slopes: `rigid_force_slopes()`.
            on_share: Called with the share of the runs that are done.
        """
        tell, corners = on_share or (lambda share: None), self._with_corners()
        at = x.copy()
        gaps = self.group("backlash").index
        at[gaps] = np.maximum(at[gaps], _LEAST_SLOPE)
        job = _touched_off(self, jnp.asarray(at), _SMOOTH_CORNER)
        command = jnp.asarray(commanded)
        run = Solution.of_command(job, rigid, command, FrozenStock())
        force = self._force_columns(x, force_slopes)
        around = DrivenRun.of(job, run)
        tip, arm = _columns(self, job, jnp.asarray(at), around, force)
        tip, arm = np.array(tip), np.array(arm)
        here = self._deviations(x, rigid, command)
        # The linear system costs about as much as three runs.
        for done, k in enumerate(corners, start=4):
            tell(done / (4 + len(corners)))
            way = _SECANT * np.eye(self.count)[k]
            there = self._deviations(x + way, rigid, command)
            tip[:, :, k], arm[:, :, k] = (there - here) / _SECANT
        tip = tip + self.field_columns(np.asarray(job.path.positions))
        return Observables(tip, tip + self.wall_columns(), arm, np.asarray(force))

    def _with_corners(self) -> np.ndarray:
        """Indices of the free parameters of friction and gaps."""
        both = [self.group(name).index for name in ("friction", "backlash")]
        return np.intersect1d(np.concatenate(both), np.flatnonzero(self.is_free))

    def _deviations(
        self, x: Float[np.ndarray, " parameter"], rigid: Run, command: Array
    ) -> Float[np.ndarray, "2 step 3"]:
        """Deviation of the tip without the field, in the work and of the arm [m]."""
        job = self.job_at(x)
        run = Solution.of_command(job, rigid, command, FrozenStock())
        tip = np.asarray(run.surface_deviation, np.float64)
        return np.stack([tip, tip - self.frame_shift(job)])

    def _force_columns(
        self,
        x: Float[np.ndarray, " parameter"],
        slopes: Float[Array, "step 3 coefficient"],
    ) -> Float[Array, "step 3 parameter"]:
        """Slopes of the force of the rigid cut in the parameters [N]."""
        group = self.group("force")
        sizes, own = self.sizes[group.index], x[group.index]
        # The first of the group is what all coefficients have in common.
        together = np.where(sizes[1:] > 0, sizes[0], 0.0)
        change = together * own[0] + sizes[1:] * own[1:]
        each = np.concatenate([together[:, None], np.diag(sizes[1:])], axis=1)
        found = jnp.zeros((*slopes.shape[:2], self.count), slopes.dtype)
        # A force is linear in its coefficients, and exponential in the parameters.
        scaled = slopes @ jnp.asarray(np.exp(change)[:, None] * each)
        return found.at[:, :, group.index].set(scaled)

    def rigid_force_slopes(self) -> Float[Array, "step 3 coefficient"]:
        """Slopes of the force of the rigid cut in the coefficients' logarithms [N]."""
        return _rigid_force_slopes(self.base)

    def frame_shift(self, job: Job) -> Rows3:
        """Motion of the path in the work, as the work is touched off anew [m].

        Args:
            job: The job of some parameters, touched off.
        """
        own, new = (np.asarray(j.T_base_work, np.float64) for j in (self.base, job))
        points = np.asarray(job.path.positions, np.float64)
        places = points @ own[:3, :3].T + own[:3, 3] - new[:3, 3]
        return places @ new[:3, :3] - points


def _has_servos(job: Job) -> bool:
    """True if the motors of a job follow servos."""
    return job.controller is not None and job.controller.bandwidth is not None


def _rigid_force_slopes(job: Job) -> Float[Array, "step 3 coefficient"]:
    """Slopes of the force of the rigid cut in the logarithms of the coefficients [N].

    By differences: exact for a law that is linear in its coefficients.
    """
    names = job.parameter_names
    first = len(names) - 1 - len(job.law.parameter_names)
    plain = dataclasses.replace(job, nominal=None)

    def force(change: Float[np.ndarray, " parameter"]) -> Float[Array, "step 3"]:
        return rigid_cut(plain.with_scaled(jnp.asarray(change)), FrozenStock()).force

    def slope(index: int) -> Float[Array, "step 3"]:
        way = np.zeros(len(names))
        way[index] = _FORCE_STEP
        return (force(way) - force(-way)) / (2 * math.sinh(_FORCE_STEP))

    return jnp.stack([slope(k) for k in range(first, len(names) - 1)], axis=-1)


def _robot_at(
    robot: Robot, friction: Array, backlash: Array, corner: RealScalarLike
) -> Robot:
    """Robot with more friction and gaps than its own."""
    coulomb, viscous = friction, jnp.zeros_like(friction)
    speed = jnp.full_like(friction, _FRICTION_SPEED)
    presliding = jnp.full_like(friction, _PRESLIDING)
    if robot.friction is not None:
        own = robot.friction
        coulomb, viscous = own.coulomb + friction, own.viscous
        speed, presliding = own.speed, own.presliding
    gap = backlash if robot.backlash is None else robot.backlash.gap + backlash
    robot = robot.with_friction(coulomb, viscous, speed, presliding=presliding)
    return robot.with_backlash(gap, corner=corner)


def _machine_at(machine: AdaptableMachine, x: Array, corner: RealScalarLike) -> Job:
    """Job with the machine of some parameters, its frame as it was."""
    job = machine.base
    values = dict(
        zip(
            (group.name for group in machine.groups),
            jnp.split(x * machine.sizes, [g.first for g in machine.groups[1:]]),
            strict=True,
        )
    )
    force = values["force"][0] + values["force"][1:]
    # No speed is learnt: the spindle holds its own.
    logs = [values["stiffness"], values["damping"], force, jnp.zeros(1)]
    scaled = dataclasses.replace(job, nominal=None).with_scaled(jnp.concatenate(logs))
    assert scaled.robot is not None
    gap = values["backlash"]
    is_gap = x[machine.group("backlash").index] > _LEAST_GAP
    robot = _robot_at(
        scaled.robot,
        jnp.maximum(values["friction"], 0.0),
        jnp.where(is_gap, gap, 0.0),
        corner,
    )
    controller = job.controller
    if controller is not None and controller.bandwidth is not None:
        bandwidth = controller.bandwidth * jnp.exp(values["servo"])
        controller = dataclasses.replace(controller, bandwidth=bandwidth)
        if controller.damping_ratio is not None:
            ratio = jnp.broadcast_to(controller.damping_ratio, bandwidth.shape)
            controller = dataclasses.replace(controller, damping_ratio=ratio)
    return dataclasses.replace(
        scaled, robot=robot, nominal=job.nominal, controller=controller
    )


class _TouchedOff(NamedTuple):
    """Parts of a job that follow from the parameters of its machine."""

    robot: Robot
    law: AbstractForceLaw
    bottom_law: AbstractForceLaw | None
    T_base_work: Transform
    controller: Controller | None


@eqx.filter_jit
def _frame_at(
    machine: AdaptableMachine, x: Array, corner: RealScalarLike
) -> _TouchedOff:
    job = _machine_at(machine, x, corner).touched_off()
    assert job.robot is not None
    return _TouchedOff(
        job.robot, job.law, job.bottom_law, job.T_base_work, job.controller
    )


def _touched_off(machine: AdaptableMachine, x: Array, corner: float) -> Job:
    found = _frame_at(machine, x, jnp.asarray(corner))
    return dataclasses.replace(machine.base, **found._asdict())


@eqx.filter_jit
def _columns(
    machine: AdaptableMachine,
    job: Job,
    x: Array,
    around: DrivenRun,
    force: Float[Array, "step 3 parameter"],
) -> tuple[Float[Array, "step 3 parameter"], Float[Array, "step 3 parameter"]]:
    """Slopes of the tip in all parameters but those of the field, and of the arm.

    Args:
        machine: The machine.
        job: The job at its parameters, with round corners.
        x: These.
        around: The run.
        force: Slopes of its force in the parameters [N], shape (step, 3, parameter).
    """
    motors, joints = around.motors, around.joints
    desired, period = jnp.asarray(job.path.positions), job.tooth_period
    zero = jnp.zeros(machine.count, motors.dtype)
    at = lambda change: _machine_at(machine, x + change, jnp.asarray(_SMOOTH_CORNER))
    moved = _frame_motion(at, zero, job, desired)
    changes = jnp.einsum("kja,kap->kjp", around.slopes, moved)
    controller = job.controller
    if controller is not None:
        commanded = motors
        motors, changes = (controller.motors(y, period) for y in (motors, changes))
        if _has_servos(job):
            changes = changes + jax.jacfwd(
                lambda change: _controller(at(change)).motors(commanded, period)
            )(zero)
    torque = drive_torques(at, zero, joints, around.driven, period)
    R, robot = jnp.asarray(job.T_base_work)[:3, :3], job.robot
    assert robot is not None
    J = jax.vmap(lambda q: jacobian(robot, q)[:3])(joints)
    torque = torque + jnp.einsum("kbj,ba,kap->kjp", J, R, force)
    problem = MachiningProblem.of(job, FrozenStock())
    assert problem.machine is not None
    command = jnp.concatenate([motors, jnp.zeros_like(motors)], axis=1)
    run = linearise(problem.machine, problem.process, command)
    ends = run.move(jnp.concatenate([changes, torque], axis=1)).ends
    shares, still = around.wall_share, jnp.zeros_like(desired)
    of = lambda ends: wall_deviation(ends, still, shares)
    tip = jax.vmap(of, in_axes=-1, out_axes=-1)(ends)
    return tip, tip - moved


def _controller(job: Job) -> Controller:
    assert job.controller is not None
    return job.controller


def _frame_motion(
    at: Callable[[Array], Job], zero: Array, job: Job, desired: Float[Array, "step 3"]
) -> Float[Array, "step 3 parameter"]:
    """Motion of the tip in the work as the work's frame moves under it [m]."""
    known = job.nominal
    assert known is not None

    def frame(change: Array) -> Float[Array, "4 4"]:
        robot = at(change).robot
        assert robot is not None
        return known.touch_off(robot)

    T, dT = jnp.asarray(job.T_base_work), jax.jacfwd(frame)(zero)
    R, dR, dt = T[:3, :3], dT[:3, :3], dT[:3, 3]
    turned = jnp.einsum("bap,bc,kc->kap", dR, R, desired)
    return turned - jnp.einsum("ba,bp->ap", R, dt)[None]
