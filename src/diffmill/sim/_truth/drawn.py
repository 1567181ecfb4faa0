"""Machines that are drawn about a model, and what commands leave on them."""

import dataclasses
from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..._job import Job
from ..._result import RESULTS
from ..._types import FloatRows3
from ...process import FrozenStock
from ...robot import Robot, rotation_matrix
from ...settings.truth import TruthSettings
from ...toolpath import ContourStatistics
from .._job.simulate import Solution, rigid_cut
from .mismatched import mismatched

# Above it a joint with friction slides, where a run begins [rad/s or m/s].
_FRICTION_SPEED = 1e-3


def drawn_machine(model: Job, sizes: TruthSettings, draw: int = 0) -> Job:
    """Job of a program on a machine that is drawn about its model.

    Args:
        model: The job; its machine must be a robot, which the controller goes on
            taking for the machine.
        sizes: Sizes of what is drawn.
        draw: Number of the draw, from 0; the same number gives the same machine.

    Returns:
        The job, touched off; see `mismatched`.

    Raises:
        ValueError: The job has no robot.

    Differentiability: none, runs on the host.
    """
    model = model.with_precision()
    if model.robot is None:
        raise ValueError("Argument `model` must have a robot, but has none.")
    stream = np.random.default_rng((sizes.seed, draw))
    joints = model.robot.joint_count
    uniform = lambda size, count: 1 + size * stream.uniform(-1, 1, count)
    factors = [uniform(sizes.stiffness, joints), uniform(sizes.damping, joints)]
    names = model.law.parameter_names
    force = uniform(sizes.force, len(names)) * (1 + sizes.force_bias)
    # Exponents stay: by a tenth of itself one changes the force by another share.
    is_exponent = np.array([name.startswith("m_") for name in names], bool)
    factors += [np.where(is_exponent, 1.0, force), np.ones(1)]
    plain = dataclasses.replace(model, nominal=None)
    machine = plain.with_scaled(jnp.log(jnp.asarray(np.concatenate(factors))))
    assert machine.robot is not None
    robot = _with_links(machine.robot, sizes, stream)
    robot = _with_reversal(robot, model.robot, sizes)
    machine = dataclasses.replace(machine, robot=robot)
    if sizes.runout > 0:
        runout = jnp.asarray(sizes.runout)
        machine = eqx.tree_at(lambda job: job.cutter.runout, machine, runout)
    return mismatched(model, machine)


def _with_links(
    robot: Robot, sizes: TruthSettings, stream: np.random.Generator
) -> Robot:
    """Robot whose joints are displaced and turned."""
    shape = (robot.body_count, 3)
    moved = jnp.asarray(sizes.links * stream.uniform(-1, 1, shape), robot.dtype)
    turned = jnp.asarray(sizes.link_angles * stream.uniform(-1, 1, shape), robot.dtype)
    places = lambda r: (r.placement_positions, r.placement_rotations)
    positions, rotations = places(robot)
    turns = jax.vmap(rotation_matrix)(turned)
    return eqx.tree_at(places, robot, (positions + moved, rotations @ turns))


def _with_reversal(robot: Robot, model: Robot, sizes: TruthSettings) -> Robot:
    """Robot with friction that sticks and gaps, besides those that it has."""
    motors = model.motor_mask()
    if sizes.friction > 0:
        bend = np.where(motors, sizes.friction, 0.0)
        coulomb = jnp.asarray(bend, robot.dtype) * model.joint_stiffness
        viscous = jnp.zeros_like(coulomb)
        if model.friction is not None:
            coulomb = coulomb + model.friction.coulomb
            viscous = model.friction.viscous
        speed = jnp.full_like(coulomb, _FRICTION_SPEED)
        presliding = None
        if sizes.presliding > 0:
            presliding = jnp.where(coulomb > 0, sizes.presliding, 0.0)
        robot = robot.with_friction(coulomb, viscous, speed, presliding=presliding)
    if sizes.backlash > 0:
        gap = jnp.asarray(np.where(motors, sizes.backlash, 0.0), robot.dtype)
        if model.backlash is not None:
            gap = gap + model.backlash.gap
        robot = robot.with_backlash(gap)
    return robot


class TrueErrors(eqx.Module):
    """Errors that commands leave on machines that are not the model.

    Attributes:
        rms: Root mean square contour error where the tool cuts [m], by case and draw;
            NaN where a run fails.
        draws: How many machines were drawn.
    """

    rms: dict[str, Float[np.ndarray, " draw"]]
    draws: int = eqx.field(static=True)

    @classmethod
    def of_commands(
        cls, model: Job, sizes: TruthSettings, commands: Mapping[str, FloatRows3]
    ) -> "TrueErrors":
        """Errors of some commands on the drawn machines.

        Args:
            model: The job.
            sizes: Sizes of what is drawn.
            commands: Commanded tips [m] by case, shape (step, 3).

        Raises:
            ValueError: The job has no robot.

        **Differentiability**: none, a host function.
        """
        rms = {name: np.full(sizes.draws, np.nan) for name in commands}
        rigid = None
        for draw in range(sizes.draws):
            machine = drawn_machine(model, sizes, draw)
            if rigid is None:
                # Stock and rows that cut are the same for all machines.
                rigid = rigid_cut(machine, FrozenStock())
            for name, command in commands.items():
                run = Solution.of_command(
                    machine, rigid, jnp.asarray(command), FrozenStock()
                )
                if bool(run.result == RESULTS.successful):
                    cuts = np.asarray(run.is_cutting)
                    rms[name][draw] = ContourStatistics.of(run.contour_error, cuts).rms
        return cls(rms, sizes.draws)

    def median(self, case: str) -> float:
        """Median over the machines [m]; NaN if a run failed."""
        return float(np.median(self.rms[case]))

    def worst(self, case: str) -> float:
        """Largest over the machines [m]; NaN if a run failed."""
        return float(np.max(self.rms[case]))
