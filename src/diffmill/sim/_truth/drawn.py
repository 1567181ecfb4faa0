"""Machines that are drawn about a model, and what commands leave on them."""

import dataclasses
import math
from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..._job import Job, parameter_uncertainty
from ..._result import RESULTS
from ..._types import FloatRows3
from ...process import FrozenStock
from ...settings.correction import UncertaintySettings
from ...settings.truth import TruthSettings
from ...toolpath import ContourStatistics
from .._job.simulate import Solution, rigid_cut, simulate_with_slot_growth
from .machine_errors import MachineErrors, drawn_errors
from .mismatched import nominal_robot


def drawn_machine(
    model: Job, sizes: TruthSettings | UncertaintySettings, draw: int = 0
) -> Job:
    """Job of a program on a machine that is drawn about its model.

    Args:
        model: The job; its machine must be a robot, which the controller goes on
            taking for the machine.
        sizes: Sizes of what is drawn.
        draw: Number of the draw, from 0; the same number gives the same machine.

    Returns:
        The job, touched off; see `mismatched`.

    Raises:
        ValueError: The job has no robot, or sizes of servos that its controller does
            not have.

    Differentiability: none, runs on the host.
    """
    model = model.with_precision()
    if model.robot is None:
        raise ValueError("Argument `model` must have a robot, but has none.")
    law = "stated"
    if isinstance(sizes, UncertaintySettings):
        law = "normal" if sizes.is_gaussian else "uniform"
    stream = np.random.default_rng((sizes.seed, draw))
    errors = drawn_errors(MachineErrors.sizes(model, sizes), stream, law)
    if isinstance(sizes, TruthSettings):
        bias = parameter_uncertainty(
            model.parameter_names,
            stiffness=0.0,
            damping=0.0,
            force=math.log1p(sizes.force_bias),
        )
        errors = dataclasses.replace(errors, scale=errors.scale + bias[:-1])
    return errors.machine_of(model, nominal_robot(model), sizes.presliding)


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
                if bool(run.result == RESULTS.interval_overflow):
                    # Beside the model a ray may break into more pieces.
                    run = simulate_with_slot_growth(
                        machine, jnp.asarray(command), FrozenStock(), lambda *_: None
                    ).solution
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
