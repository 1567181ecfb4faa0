"""Optimisation: least squares of expensive functions, convex quadratic programs.

What it models: a function of few unknowns whose value may be a simulation and whose
quadratic model at a point is known (`AbstractProblem`); bounds of the unknowns, hard
and soft linear constraints of every step, bounds of outputs. `least_squares` is the one
loop, whose state is one object to go on from. Assumptions: some hundred unknowns,
dense matrices, the host. Left out: implicit roots and fits within a traced function,
which optimistix does, and problems of many thousand unknowns.
"""

from ._least_squares import (
    AbstractProblem as AbstractProblem,
    LeastSquaresState as LeastSquaresState,
    LeastSquaresStep as LeastSquaresStep,
    LevenbergMarquardt as LevenbergMarquardt,
    LinearRows as LinearRows,
    QuadraticModel as QuadraticModel,
    least_squares as least_squares,
)
from ._output_constraints import OutputConstraints as OutputConstraints
from ._quadratic_program import solve_quadratic_program as solve_quadratic_program
