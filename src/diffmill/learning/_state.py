"""State of learning, from which an interrupted run goes on."""

import dataclasses
from collections.abc import Callable
from typing import TypeAlias

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._arrays import Arrays, below, named_leaves

# Called with all that is needed to go on from here.
OnCheckpoint: TypeAlias = Callable[[Arrays], None]


class LearningState(eqx.Module):
    """State of learning before a step of it.

    Attributes:
        step: Steps on the parameters so far.
        parameters: Parameters before the next one, shape (parameter,).
        set_up: What the set-ups leave open, shape (nuisance,).
        stage: Stages of the next command that have ended.
        command: The command with which the next stage begins [m], shape (step, 3);
            empty before the first.
        correction: State of the correction that runs in it, if one does.
    """

    step: int
    parameters: Float[np.ndarray, " parameter"]
    set_up: Float[np.ndarray, " nuisance"]
    stage: int = 0
    command: Float[np.ndarray, "step 3"] = dataclasses.field(
        default_factory=lambda: np.zeros((0, 3))
    )
    correction: Arrays = dataclasses.field(default_factory=dict)

    def arrays(self) -> Arrays:
        """All of it as plain arrays by name."""
        return {name: np.asarray(leaf) for name, leaf in named_leaves(self).items()}

    @classmethod
    def of_arrays(cls, arrays: Arrays) -> "LearningState":
        """State of what `arrays` has returned.

        Args:
            arrays: The arrays.
        """
        return cls(
            int(arrays["step"]),
            np.asarray(arrays["parameters"]),
            np.asarray(arrays["set_up"]),
            int(arrays["stage"]),
            np.asarray(arrays["command"]),
            below("correction", arrays),
        )
