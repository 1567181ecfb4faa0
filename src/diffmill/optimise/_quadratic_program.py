"""Convex quadratic programs with dense matrices, by an interior-point method.

    minimise  x.P x / 2 + c.x + sum_j w_j^2 s_j^2 / 2
    subject to  lower - s <= L x <= upper + s

A row with an infinite weight is a bound; any other is a spring that begins to act at
the bound. Clarabel solves it: Goulart and Chen, Clarabel: An interior-point solver for
conic programs with quadratic objectives, 2024.
"""

import importlib
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# What the solver calls a solution.
_SOLVED_STATUS = ("Solved", "AlmostSolved")


def solve_quadratic_program(
    P: "Float[np.ndarray, 'unknown unknown'] | csr_array",
    c: Float[np.ndarray, " unknown"],
    rows: "Float[np.ndarray, 'row unknown'] | csr_array",
    lower: Float[np.ndarray, " row"],
    upper: Float[np.ndarray, " row"],
    weight: Float[np.ndarray, " row"] | None = None,
) -> Float[np.ndarray, " unknown"] | None:
    """Minimise a convex quadratic function within bounds of linear rows.

    Args:
        P: Symmetric and positive semidefinite, an array or sparse.
        c: Gradient at zero, shape (unknown,).
        rows: L, an array or sparse, shape (row, unknown).
        lower: Lower bounds of L x; minus infinity where there is none.
        upper: Upper bounds, likewise.
        weight: w of each row, infinite for a bound; all are bounds if not given.

    Returns:
        The minimiser x, to about eight digits, shape (unknown,); None if the solver
        finds none.
    """
    from scipy import sparse

    # Its classes come from Rust, where a type checker does not see them.
    clarabel: Any = importlib.import_module("clarabel")
    unknowns = c.shape[0]
    L: Any = sparse.csr_matrix(rows)
    over, under = np.flatnonzero(np.isfinite(upper)), np.flatnonzero(np.isfinite(lower))
    A: Any = sparse.vstack([L[over], -L[under]])
    b = np.concatenate([upper[over], -lower[under]])
    full: Any = sparse.csc_matrix(P)
    if weight is not None:
        each = np.concatenate([weight[over], weight[under]])
        gives = np.flatnonzero(np.isfinite(each))
        count = gives.size
        entries = (np.full(count, -1.0), (gives, np.arange(count)))
        A = sparse.hstack([A, sparse.csr_matrix(entries, shape=(len(b), count))])
        full = sparse.block_diag([full, sparse.diags_array(each[gives] ** 2)])
        c = np.concatenate([c, np.zeros(count)])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cones = [clarabel.NonnegativeConeT(len(b))]
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix(sparse.triu(full)),
        c,
        sparse.csc_matrix(A),
        b,
        cones,
        settings,
    ).solve()
    x = np.asarray(solution.x)[:unknowns]
    if str(solution.status) not in _SOLVED_STATUS or not np.all(np.isfinite(x)):
        return None
    return x
