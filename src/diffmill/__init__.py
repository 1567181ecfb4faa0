"""Predict and correct the path error of a milling robot.

`load_job` reads a job, `simulate` predicts it, `correct` corrects it; the parts are in
the subpackages. Arrays are SI, frames and signs are in the README.
"""

from . import (
    correction as correction,
    cutter as cutter,
    cutting as cutting,
    robot as robot,
    sim as sim,
    toolpath as toolpath,
    workpiece as workpiece,
)
from ._job import (
    CorrectionSettings as CorrectionSettings,
    Job as Job,
    SimulationSettings as SimulationSettings,
)
from ._result import RESULTS as RESULTS, SimulationFailed as SimulationFailed
from .correction import Correction as Correction, correct as correct
from .io import JobError as JobError, load_job as load_job
from .sim import Solution as Solution, simulate as simulate
