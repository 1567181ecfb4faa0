"""State of a correction between two checkpoints, as plain arrays by name.

A state is a tree of arrays and numbers, written leaf by leaf. Arrays only, so that a
file of them needs no code to be read. Where they are written is the caller's business.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PyTree, Shaped

from ..._arrays import Arrays as Arrays, below as below, named_leaves
from ..._result import RESULTS
from ..._types import FloatRows
from ...optimise import LeastSquaresStep
from .._core.method import MethodResult, corrected
from .._core.problem import Motion, Problem

# Called with all that is needed to go on from here.
OnCheckpoint: TypeAlias = Callable[[Arrays], None]
_State = TypeVar("_State")


def pack(state: PyTree) -> dict[str, np.ndarray]:
    """Leaves of a state, named by their place in it; the steps of a search as a table.

    Args:
        state: A tree of arrays, numbers and steps of searches.
    """
    fields = [field.name for field in dataclasses.fields(LeastSquaresStep)]
    arrays = {}
    for name, leaf in named_leaves(state, _is_history).items():
        if isinstance(leaf, tuple):
            rows = [[float(getattr(step, name)) for name in fields] for step in leaf]
            leaf = np.array(rows, np.float64).reshape(-1, len(fields))
        arrays[name] = np.asarray(leaf)
    return arrays


def unpack(arrays: Arrays, like: _State) -> _State:
    """State from its leaves.

    Args:
        arrays: The leaves by name.
        like: A state of the same structure, shapes and types; an array without entries
            stands for any.

    Raises:
        ValueError: The leaves are others.
    """
    leaves = named_leaves(like, _is_history)
    if sorted(arrays) != sorted(leaves):
        raise ValueError("the state of the plant has another structure")
    return jax.tree.unflatten(
        jax.tree.structure(like, is_leaf=_is_history),
        [_leaf(arrays[name], leaf) for name, leaf in leaves.items()],
    )


def _is_history(node: object) -> bool:
    """True for steps of a search, of which there may be any number."""
    return type(node) is tuple and all(isinstance(x, LeastSquaresStep) for x in node)


def _leaf(array: np.ndarray, like: Any) -> Any:
    """Leaf of the same kind as another one."""
    if isinstance(like, tuple):
        kinds: list[Any] = [
            field.type for field in dataclasses.fields(LeastSquaresStep)
        ]
        return tuple(
            LeastSquaresStep(*(kind(x) for kind, x in zip(kinds, row, strict=True)))
            for row in array
        )
    if isinstance(like, bool | int | float):
        return type(like)(array)
    if like.size and (array.shape != like.shape or array.dtype != like.dtype):
        raise ValueError("the state of the plant has other shapes or types")
    return jnp.asarray(array) if isinstance(like, jax.Array) else np.asarray(array)


class CaseState(eqx.Module):
    """Outcome of a method without what follows from it by a little arithmetic.

    Attributes:
        command: The corrected command, shape (step, axis).
        motion: Motion of the plant.
        forward_runs: Runs of the plant.
        linearisations: Runs with their linear system, or with a gradient.
        detail_names: Names of the settings that the method chose, in their order.
        detail: These settings, shape (detail,).
        is_successful: Whether the method succeeded.
        seconds: Time that it took, compilation included [s].
    """

    command: FloatRows
    motion: Motion
    forward_runs: int
    linearisations: int
    detail_names: Shaped[np.ndarray, " detail"]
    detail: Float[np.ndarray, " detail"]
    is_successful: bool
    seconds: float

    @classmethod
    def of(cls, outcome: MethodResult, seconds: float) -> "CaseState":
        """State of an outcome that took some time [s]; steps are left out."""
        return cls(
            outcome.command,
            # A motion with its solution is far larger.
            Motion(outcome.motion.actual, outcome.motion.force),
            outcome.forward_runs,
            outcome.linearisations,
            np.array([*outcome.detail], np.str_),
            np.array([*outcome.detail.values()], np.float64),
            bool(outcome.result == RESULTS.successful),
            seconds,
        )

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> "CaseState | None":
        """State from a checkpoint; None if there are no arrays."""
        if not arrays:
            return None
        rows, none = jnp.zeros((0, 3)), np.zeros(0)
        like = cls(np.zeros((0, 3)), Motion(rows, rows), 0, 0, none, none, False, 0.0)
        return unpack(arrays, like)

    def outcome(self, problem: Problem) -> MethodResult:
        """Outcome of the method, which was of this problem."""
        names = [str(name) for name in self.detail_names]
        return corrected(
            problem,
            self.command,
            motion=self.motion,
            forward_runs=self.forward_runs,
            linearisations=self.linearisations,
            detail=dict(zip(names, map(float, self.detail), strict=True)),
        )


class CorrectionState(eqx.Module):
    """State of a correction, from which it goes on.

    Attributes:
        method: Outcomes of the methods that have ended, by name.
        search: State of the search that runs, if one does, by the name of its method.
    """

    method: dict[str, CaseState]
    search: dict[str, Arrays]
