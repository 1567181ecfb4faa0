"""Parts of a job that is being read."""

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from ..._types import FloatRows3
from ...cutter import AbstractCutter, ToolHolder
from ...robot import Controller, Robot, TipModes
from ...toolpath import Path, Program, TimedProgram
from .stock import StockPlan

if TYPE_CHECKING:
    from ...learning import MachinePosterior


class JobParts(NamedTuple):
    """Parts of a job; None where a fault keeps one from being there.

    Attributes:
        program: The program, before it is timed.
        speed: Spindle speed [rad/s].
        cutter: The cutter.
        holder: Its holder, if the job has one.
        stock: The stock.
        robot: The robot; None for a rigid machine and one of modes.
        T_base_work: Maps work coordinates to the robot's base, shape (4, 4).
        joint_start: Where inverse kinematics starts [rad or m]; None for home.
        path: The path with a row per tooth period.
        controller: What is between program and motors; None for nothing.
        fastest: Highest frequency of the machine that counts [Hz]; 0 for none.
        modes: The modes of a machine that is given by them, else None.
        timed: The program with the speed at every place of it; None for a recorded
            path.
        commanded: Tips that the controller is told instead of the path's, if any.
        joints: Joints of the robot along the path [rad or m], if they are known.
        nominal: The robot as its controller knows it; None if that is `robot`.
        learnt: What parts have shown of the machine, if the job names it.
    """

    program: Program | Path | None
    speed: float | None
    cutter: AbstractCutter | None
    holder: ToolHolder | None
    stock: StockPlan | None
    robot: Robot | None
    T_base_work: Float[np.ndarray, "4 4"]
    joint_start: Float[np.ndarray, " joint"] | None
    path: Path | None
    controller: Controller | None = None
    fastest: float = 0.0
    modes: TipModes | None = None
    timed: TimedProgram | None = None
    commanded: FloatRows3 | None = None
    joints: Float[np.ndarray, "step joint"] | None = None
    nominal: Robot | None = None
    learnt: "MachinePosterior | None" = None

    @property
    def tooth_period(self) -> float:
        """Tooth period [s] of a job with a cutter and a speed."""
        assert self.speed is not None and self.cutter is not None
        return 2 * math.pi / (self.speed * self.cutter.flute_count)
