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
from jaxtyping import PyTree, Shaped

from ..._result import RESULTS
from ...optimise import LeastSquaresState, LeastSquaresStep
from .._core.method import MethodResult, corrected
from .._core.problem import Motion, Problem
from .offset_fit import FitValue

Arrays: TypeAlias = Mapping[str, Shaped[np.ndarray, "..."]]
# Called with all that is needed to go on from here.
OnCheckpoint: TypeAlias = Callable[[Arrays], None]
_FIELDS = tuple(field.name for field in dataclasses.fields(LeastSquaresStep))
_WHOLE = ("evaluations", "models")
# What can be run again is not kept.
_VALUE = ("errors", "rough", "outputs")


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


def pack_fit(state: LeastSquaresState) -> dict[str, np.ndarray]:
    """Return the state of a fit as arrays."""
    return {
        "x": state.x,
        **{name: getattr(state.value, name) for name in _VALUE},
        "damping": np.asarray(state.damping),
        "has_converged": np.asarray(state.has_converged),
        "counts": np.array([state.steps, state.evaluations, state.models], np.int64),
        "history": pack_history(state.history),
    }


def unpack_fit(arrays: Arrays) -> LeastSquaresState:
    """Return the state of a fit from its arrays."""
    steps, evaluations, models = (int(count) for count in arrays["counts"])
    errors, rough, outputs = (np.asarray(arrays[name]) for name in _VALUE)
    return LeastSquaresState(
        x=np.asarray(arrays["x"]),
        value=FitValue(errors, rough, outputs),
        damping=float(arrays["damping"]),
        steps=steps,
        evaluations=evaluations,
        models=models,
        has_converged=bool(arrays["has_converged"]),
        history=unpack_history(arrays["history"]),
    )


def pack_tree(tree: PyTree) -> dict[str, np.ndarray]:
    """Return the leaves of a tree of arrays, numbered."""
    return {str(i): np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(tree))}


def unpack_tree(arrays: Arrays, like: PyTree) -> PyTree:
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


def pack_method(found: MethodResult) -> dict[str, np.ndarray]:
    """Return what is needed to have the outcome of a method again, but its steps."""
    return {
        "command": np.asarray(found.command),
        "actual": np.asarray(found.motion.actual),
        "force": np.asarray(found.motion.force),
        "counts": np.array([found.forward_runs, found.linearisations], np.int64),
        "detail_names": np.array([*found.detail], np.str_),
        "detail": np.array([*found.detail.values()], np.float64),
        "is_successful": np.asarray(bool(found.result == RESULTS.successful)),
    }


def unpack_method(
    arrays: Arrays, problem: Problem, *, is_start: bool = False
) -> MethodResult | None:
    """Return the outcome of a method.

    Args:
        arrays: What `pack_method` has made, or nothing.
        problem: The problem that it was for.
        is_start: Whether only a start is looked for, which need not have settled.

    Returns:
        The outcome; None where there is nothing, or where the method did not succeed
        and is to be run again for its exact outcome.
    """
    if not arrays or not (is_start or bool(arrays["is_successful"])):
        return None
    names = [str(name) for name in arrays["detail_names"]]
    return corrected(
        problem,
        arrays["command"],
        motion=Motion(jnp.asarray(arrays["actual"]), jnp.asarray(arrays["force"])),
        forward_runs=int(arrays["counts"][0]),
        linearisations=int(arrays["counts"][1]),
        detail=dict(zip(names, map(float, arrays["detail"]), strict=True)),
    )
