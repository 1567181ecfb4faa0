"""Errors of a machine about its model, and the machine that has them."""

import dataclasses
from collections.abc import Callable
from dataclasses import fields

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job, parameter_uncertainty
from ..._types import RealScalarLike
from ...robot import NominalRobot, Robot, rotation_matrix
from ...settings.machine_errors import MachineErrorSettings

# Above it a joint with friction slides, where a run begins [rad/s or m/s].
_FRICTION_SPEED = 1e-3

# Errors that are not negative.
POSITIVE = ("friction", "backlash", "runout")

EachJoint = Float[Array, " joint"] | Float[np.ndarray, " joint"]
EachBody = Float[Array, "body 3"] | Float[np.ndarray, "body 3"]
Pair = Float[Array, "2 3"] | Float[np.ndarray, "2 3"]


class MachineErrors(eqx.Module):
    """Errors of a machine with a robot about its model, or their sizes.

    Attributes:
        scale: Logarithms of the factors of `Job.parameter_names` without the speed [-],
            shape (parameter,).
        displacement: Of each joint along each axis [m], shape (body, 3).
        rotation: Of each joint about each axis [rad], shape (body, 3).
        bandwidth: Logarithms of the factors of the servos' bandwidths [-], shape
            (joint,); None where all are right, as in what follows.
        registration: Displacement of the part along each axis [m], and its rotation
            about each axis through the middle of the probes [rad], shape (2, 3).
        friction: Coulomb friction of each joint, as the angle by which it bends the
            spring [rad or m], shape (joint,).
        backlash: Gap of each joint [rad or m], shape (joint,).
        runout: Run-out of the cutter [m], shape ().
    """

    scale: Float[Array, " parameter"] | Float[np.ndarray, " parameter"]
    displacement: EachBody
    rotation: EachBody
    bandwidth: EachJoint | None = None
    registration: Pair | None = None
    friction: EachJoint | None = None
    backlash: EachJoint | None = None
    runout: RealScalarLike | None = None

    @classmethod
    def sizes(cls, job: Job, settings: MachineErrorSettings) -> "MachineErrors":
        """Sizes of the errors of a job's machine.

        Args:
            job: The job; it must have a robot.
            settings: The sizes.

        Raises:
            ValueError: Servos are uncertain that the controller does not have.
        """
        assert job.robot is not None
        controller = job.controller
        has_servos = controller is not None and controller.bandwidth is not None
        if settings.bandwidth > 0 and not has_servos:
            raise ValueError(
                "Argument `sizes` must have no bandwidth unless the controller of the "
                f"job has one, but has {settings.bandwidth}."
            )
        motors, bodies = job.robot.motor_mask(), np.ones((job.robot.body_count, 3))
        each = lambda size: np.where(motors, size, 0.0) if size > 0 else None
        part = np.array([[settings.registration], [settings.registration_angles]])
        return cls(
            scale=parameter_uncertainty(
                job.parameter_names,
                stiffness=settings.stiffness,
                damping=settings.damping,
                force=settings.force,
            )[:-1],
            displacement=settings.links * bodies,
            rotation=settings.link_angles * bodies,
            bandwidth=each(settings.bandwidth),
            registration=np.tile(part, (1, 3)) if part.any() else None,
            friction=each(settings.friction),
            backlash=each(settings.backlash),
            runout=np.asarray(settings.runout) if settings.runout > 0 else None,
        )

    def each_by(
        self, change: Callable[[str, np.ndarray], np.ndarray]
    ) -> "MachineErrors":
        """Errors that are changed, each by a function of its name and its value."""
        own = {field.name: getattr(self, field.name) for field in fields(self)}
        given = {name: x for name, x in own.items() if x is not None}
        changed = {name: change(name, np.asarray(x)) for name, x in given.items()}
        return dataclasses.replace(self, **changed)

    def names(self, job: Job) -> tuple[str, ...]:
        """Names of the errors of a job's machine, in the order of the leaves."""
        assert job.robot is not None
        joints = job.robot.joint_names
        frames = [f"{k} {a}" for k in range(1, job.robot.body_count + 1) for a in "xyz"]
        each = {
            "scale": job.parameter_names[:-1],
            "displacement": [f"link {frame}" for frame in frames],
            "rotation": [f"link angle {frame}" for frame in frames],
            "registration": [f"{kind} {a}" for kind in ("part", "turn") for a in "xyz"],
            "runout": ["runout"],
        }
        return tuple(
            name
            for field in fields(self)
            if getattr(self, field.name) is not None
            for name in each.get(field.name, [f"{field.name} {j}" for j in joints])
        )

    def machine_of(self, model: Job, known: NominalRobot, presliding: float) -> Job:
        """Job on the machine with these errors, touched off.

        Args:
            model: The job on its model.
            known: What the controller knows (`nominal_robot`).
            presliding: By which a joint with friction yields before it slides [rad].

        **Differentiability**: smooth, but where a gap is 0.
        """
        dtype = model.simulation.precision
        plain = dataclasses.replace(model, nominal=None)
        job = plain.with_scaled(jnp.append(jnp.asarray(self.scale, dtype), 0.0))
        assert job.robot is not None and model.robot is not None
        robot = self._reversing(self._displaced(job.robot), model.robot, presliding)
        job = dataclasses.replace(job, robot=robot, nominal=self._registered(known))
        if self.bandwidth is not None:
            assert job.controller is not None
            own, factors = job.controller.bandwidth, jnp.exp(self.bandwidth)
            bandwidth = jnp.asarray(own, dtype) * jnp.asarray(factors, dtype)
            servos = dataclasses.replace(job.controller, bandwidth=bandwidth)
            job = dataclasses.replace(job, controller=servos)
        if self.runout is not None:
            cutter = dataclasses.replace(
                job.cutter,
                runout=jnp.asarray(self.runout, dtype),
                has_runout=True,
                is_plain=False,
            )
            job = dataclasses.replace(job, cutter=cutter)
        return job.touched_off()

    def _displaced(self, robot: Robot) -> Robot:
        """Robot whose joints are displaced and turned."""
        places = lambda r: (r.placement_positions, r.placement_rotations)
        positions, rotations = places(robot)
        moved = positions + jnp.asarray(self.displacement, robot.dtype)
        turns = jax.vmap(rotation_matrix)(jnp.asarray(self.rotation, robot.dtype))
        return eqx.tree_at(places, robot, (moved, rotations @ turns))

    def _reversing(self, robot: Robot, model: Robot, presliding: float) -> Robot:
        """Robot with friction that sticks and gaps, besides those that it has."""
        if self.friction is not None:
            bend = jnp.asarray(self.friction, robot.dtype)
            coulomb, viscous = bend * model.joint_stiffness, jnp.zeros_like(bend)
            if model.friction is not None:
                coulomb = coulomb + model.friction.coulomb
                viscous = model.friction.viscous
            speed = jnp.full_like(coulomb, _FRICTION_SPEED)
            yields = None
            if presliding > 0:
                yields = jnp.where(coulomb > 0, presliding, 0.0)
            robot = robot.with_friction(coulomb, viscous, speed, presliding=yields)
        if self.backlash is not None:
            gap = jnp.asarray(self.backlash, robot.dtype)
            if model.backlash is not None:
                gap = gap + model.backlash.gap
            robot = robot.with_backlash(gap)
        return robot

    def _registered(self, known: NominalRobot) -> NominalRobot:
        """Robot and work as the controller knows them, probes where the part is."""
        if self.registration is None:
            return known
        probes = jnp.asarray(known.probes)
        shift, turn = jnp.asarray(self.registration, probes.dtype)
        middle = probes.mean(0)
        # In its own frame a part that is displaced has the probes on the other side.
        own = (probes - middle[None] - shift[None]) @ rotation_matrix(turn)
        return dataclasses.replace(known, probes=middle[None] + own)


def drawn_errors(
    sizes: MachineErrors, stream: np.random.Generator, law: str
) -> MachineErrors:
    """Errors of one machine, drawn from their sizes.

    Args:
        sizes: The sizes.
        stream: Random numbers.
        law: "normal" for logarithms and lengths that are normal, others half-normal;
            "uniform" for factors and lengths that are uniform, others from 0; "stated"
            for the same, but others as stated.

    **Differentiability**: none, a host function.
    """

    def draw(name: str, size: np.ndarray) -> np.ndarray:
        if name in POSITIVE and law == "stated":
            return size
        if law == "normal":
            error = size * stream.normal(size=size.shape)
        else:
            error = size * stream.uniform(-1, 1, size.shape)
        if name in POSITIVE:
            return np.abs(error)
        # A factor is uniform itself, or its logarithm is normal.
        is_log = name in ("scale", "bandwidth") and law != "normal"
        return np.log1p(error) if is_log else error

    return sizes.each_by(draw)
