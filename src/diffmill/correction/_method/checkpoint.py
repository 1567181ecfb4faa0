"""State of a correction between two checkpoints, as named plain arrays.

Arrays only, so that a file of them needs no code to be read. Where they are written is
the caller's business.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Shaped

from ..._result import RESULTS
from .._core.method import Corrected, corrected
from .._core.problem import Motion, Problem
from .._least_squares_records import (
    LeastSquaresMemory,
    LeastSquaresSolution,
    LeastSquaresStep,
)
from .minimax import WorstCaseMemory

Arrays: TypeAlias = Mapping[str, Shaped[np.ndarray, "..."]]
# Called with all that is needed to go on from here.
OnCheckpoint: TypeAlias = Callable[[Arrays], None]
_FIELDS = tuple(field.name for field in dataclasses.fields(LeastSquaresStep))
_WHOLE = ("step", "bound_count", "products", "forward_runs")
# What a least-squares solution may have for a result.
_OUTCOMES = (RESULTS.successful, RESULTS.not_converged, RESULTS.non_finite)


def under(prefix: str, arrays: Arrays) -> dict[str, np.ndarray]:
    """Return arrays with a prefix before their names."""
    return {f"{prefix}/{name}": np.asarray(value) for name, value in arrays.items()}


def below(prefix: str, arrays: Arrays | None) -> dict[str, np.ndarray]:
    """Return the arrays whose names begin with a prefix, without it."""
    start = f"{prefix}/"
    found = {} if arrays is None else arrays
    return {k[len(start) :]: found[k] for k in found if k.startswith(start)}


def pack_history(history: Iterable[LeastSquaresStep]) -> np.ndarray:
    """Return steps of an optimiser as a table, a row per step."""
    rows = [[float(getattr(step, name)) for name in _FIELDS] for step in history]
    return np.array(rows, np.float64).reshape(-1, len(_FIELDS))


def unpack_history(
    table: Shaped[np.ndarray, "step field"],
) -> tuple[LeastSquaresStep, ...]:
    """Return the steps of a table."""
    steps = []
    for row in table:
        values: dict[str, Any] = dict(zip(_FIELDS, map(float, row), strict=True))
        values["is_accepted"] = bool(values["is_accepted"])
        values.update({name: int(values[name]) for name in _WHOLE})
        steps.append(LeastSquaresStep(**values))
    return tuple(steps)


def pack_least_squares(memory: LeastSquaresMemory) -> dict[str, np.ndarray]:
    """Return the memory of a least-squares iteration as arrays."""
    names = [f.name for f in dataclasses.fields(memory) if f.name != "history"]
    packed = {name: np.asarray(getattr(memory, name)) for name in names}
    return {**packed, "history": pack_history(memory.history)}


def unpack_least_squares(arrays: Arrays) -> LeastSquaresMemory:
    """Return the memory of a least-squares iteration from its arrays."""
    return LeastSquaresMemory(
        z=np.asarray(arrays["z"]),
        damping=float(arrays["damping"]),
        growth=float(arrays["growth"]),
        first_kkt=float(arrays["first_kkt"]),
        is_done=bool(arrays["is_done"]),
        products=int(arrays["products"]),
        forward_runs=int(arrays["forward_runs"]),
        history=unpack_history(arrays["history"]),
    )


def pack_worst_case(memory: WorstCaseMemory) -> dict[str, np.ndarray]:
    """Return the memory of the rounds of a worst case as arrays."""
    packed = {
        "round": np.asarray(memory.round),
        "weights": memory.weights,
        "start": memory.start,
        "lowest": np.asarray(memory.lowest),
        "history": pack_history(memory.history),
        **under("inner", pack_least_squares(memory.inner)),
    }
    if (best := memory.best) is not None:
        is_it = [bool(best.result == outcome) for outcome in _OUTCOMES]
        solution = {
            "x": np.asarray(best.x),
            "cost": np.asarray(best.cost),
            "held": best.held,
            "outcome": np.asarray(is_it.index(True)),
        }
        packed.update(under("best", solution))
    return packed


def unpack_worst_case(arrays: Arrays) -> WorstCaseMemory:
    """Return the memory of the rounds of a worst case from its arrays."""
    best = None
    if found := below("best", arrays):
        best = LeastSquaresSolution(
            x=jnp.asarray(found["x"]),
            cost=float(found["cost"]),
            history=(),
            result=_OUTCOMES[int(found["outcome"])],
            held=np.asarray(found["held"]),
        )
    return WorstCaseMemory(
        round=int(arrays["round"]),
        weights=np.asarray(arrays["weights"]),
        start=np.asarray(arrays["start"]),
        best=best,
        lowest=float(arrays["lowest"]),
        history=unpack_history(arrays["history"]),
        inner=unpack_least_squares(below("inner", arrays)),
    )


def pack_tree(tree: Any) -> dict[str, np.ndarray]:
    """Return the leaves of a tree of arrays, numbered."""
    return {str(i): np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(tree))}


def unpack_tree(arrays: Arrays, like: Any) -> Any:
    """Return the tree of numbered leaves.

    Args:
        arrays: The leaves.
        like: A tree of the same structure, shapes and types.

    Raises:
        ValueError: The leaves are others.
    """
    leaves, structure = jax.tree.flatten(like)
    if sorted(arrays) != sorted(str(i) for i in range(len(leaves))):
        raise ValueError("the state of the plant has another structure")
    found = [jnp.asarray(arrays[str(i)]) for i in range(len(leaves))]
    for leaf, new in zip(leaves, found, strict=True):
        if new.shape != jnp.shape(leaf) or new.dtype != jnp.asarray(leaf).dtype:
            raise ValueError("the state of the plant has other shapes or types")
    return jax.tree.unflatten(structure, found)


def pack_method(found: Corrected, seconds: float) -> dict[str, np.ndarray]:
    """Return what is needed to have the outcome of a method again, but its steps."""
    return {
        "command": np.asarray(found.command),
        "actual": np.asarray(found.motion.actual),
        "force": np.asarray(found.motion.force),
        "counts": np.array([found.forward_runs, found.products], np.int64),
        "detail_names": np.array([*found.detail], np.str_),
        "detail": np.array([*found.detail.values()], np.float64),
        "is_successful": np.asarray(bool(found.result == RESULTS.successful)),
        "seconds": np.asarray(seconds),
    }


def unpack_method(
    arrays: Arrays, problem: Problem, *, is_start: bool = False
) -> tuple[Corrected, float] | None:
    """Return the outcome of a method and its wall time [s].

    Args:
        arrays: What `pack_method` has made, or nothing.
        problem: The problem that it was for.
        is_start: Whether only a start is looked for, which need not have settled.

    Returns:
        Both; None where there is nothing, or where the method did not succeed and is
        to be run again for its exact outcome.
    """
    if not arrays or not (is_start or bool(arrays["is_successful"])):
        return None
    names = [str(name) for name in arrays["detail_names"]]
    found = corrected(
        problem,
        arrays["command"],
        motion=Motion(jnp.asarray(arrays["actual"]), jnp.asarray(arrays["force"])),
        forward_runs=int(arrays["counts"][0]),
        products=int(arrays["counts"][1]),
        detail=dict(zip(names, map(float, arrays["detail"]), strict=True)),
    )
    return found, float(arrays["seconds"])
