"""The outcome of a run, as one enumeration that travels through jitted code.

A traced loop cannot raise. It keeps a flag in its carry, the flag becomes a member
of `RESULTS`, and the host raises `SimulationFailed` once, after the call.
"""

import equinox as eqx


class RESULTS(eqx.Enumeration):
    """Outcome of a simulation, a solve or a correction; carries its message."""

    successful = ""
    interval_overflow = (
        "A ray of the stock needed more intervals than it has slots for; raise "
        "`interval_counts` (in a job: [stock] intervals)."
    )
    window_overflow = (
        "The tool moved or reached farther than its window of rays covers; raise "
        "`axial_depth` (in a job: [simulation] axial_depth) or slow the motion down."
    )
    non_finite = "A state of the simulation became infinite or not a number."
    unreachable = "The robot does not reach every pose that is commanded."
    not_converged = "The iteration ended before its tolerance."
    singular_mass_matrix = "The mass matrix of the robot is singular at this pose."


class SimulationFailed(RuntimeError):
    """Raise when a run cannot be completed; the partial solution is `solution`.

    Attributes:
        solution: What was computed up to the failure, or None.
    """

    def __init__(self, message: str, solution: object = None):
        super().__init__(message)
        self.solution = solution
