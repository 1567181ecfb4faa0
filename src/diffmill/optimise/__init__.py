"""Optimisation: least squares of expensive functions, convex quadratic programs.

What it models: a function of few unknowns whose value may be a simulation and whose
quadratic model at a point is known (`AbstractProblem`); bounds of the unknowns, linear
constraints and springs of every step. `least_squares` is the one loop, whose state is
one object to go on from. Assumptions: few unknowns, dense matrices, the host. Left out:
implicit roots and fits within a traced function, which optimistix does, and large
problems whose derivatives are products only.
"""

from ._least_squares import (
    AbstractProblem as AbstractProblem,
    LeastSquaresState as LeastSquaresState,
    LevenbergMarquardt as LevenbergMarquardt,
    LinearRows as LinearRows,
    QuadraticModel as QuadraticModel,
    least_squares as least_squares,
)
from ._quadratic_program import (
    QuadraticProgramSolution as QuadraticProgramSolution,
    solve_quadratic_program as solve_quadratic_program,
)
