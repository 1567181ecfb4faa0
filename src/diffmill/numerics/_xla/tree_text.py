"""Trees of arrays as text, which tells two programs apart and rebuilds a result.

The text holds the nodes of a tree, with all that is static in them, and its leaves, an
array by its shape and type alone. Only objects that this package, equinox or Python
define have a text: somebody else's may change while its name stays.
"""

import importlib
import json
import types
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.tree_util import PyTreeDef, default_registry
from jaxtyping import PyTree

_PACKAGE = __name__.partition(".")[0]
_KNOWN = (_PACKAGE, "equinox", "builtins")


class _Probe(eqx.Module):
    """An empty module: it tells how equinox marks an absent field."""


_, (_ABSENT,) = jax.tree.structure(_Probe()).node_data()  # pyright: ignore[reportGeneralTypeIssues]


class HasNoText(TypeError):
    """A tree holds an object that has no text."""


def tree_text(tree: object) -> str:
    """Text of a tree; trees of equal text compile to the same program.

    Args:
        tree: A tree of arrays and of constants.

    Raises:
        HasNoText: It holds a type or an object that is defined elsewhere.
    """

    def leaf_data(leaf: Any) -> list[Any]:
        if is_array(leaf):
            dtype = jax.dtypes.canonicalize_dtype(leaf.dtype)
            return ["array", list(leaf.shape), str(dtype)]
        return _constant_data(leaf)

    leaves, structure = jax.tree.flatten(tree)
    return json.dumps([_structure_data(structure), [leaf_data(x) for x in leaves]])


def tree_of_text(text: str, arrays: list[jax.Array]) -> PyTree:
    """Tree of a text, with the given arrays as its arrays, in order.

    Args:
        text: As `tree_text` gives it.
        arrays: As many as there are in the tree.
    """
    structure, leaves = json.loads(text)
    given = iter(arrays)
    values = [next(given) if x[0] == "array" else _constant(x) for x in leaves]
    return jax.tree.unflatten(_structure(structure), values)


def arrays_of(tree: object) -> list[jax.Array | np.ndarray | np.generic]:
    """Arrays of a tree, in the order of its leaves."""
    return [x for x in jax.tree.leaves(tree) if is_array(x)]


def is_array(leaf: object) -> bool:
    """True if a leaf is an argument of a program, False if it is a constant of it."""
    return isinstance(leaf, jax.Array | np.ndarray | np.generic)


def _structure_data(structure: Any) -> list[Any] | None:
    node = structure.node_data()
    if node is None:
        return None
    kind, static = node
    if kind is type(None):
        return ["none"]
    children = [_structure_data(x) for x in structure.children()]
    return [_name(kind), _constant_data(static), children]


def _structure(data: list[Any] | None) -> Any:
    if data is None:
        return jax.tree.structure(0)
    if data == ["none"]:
        return jax.tree.structure(None)
    kind, static, children = data
    node = (_named(kind), _constant(static))
    parts = [_structure(x) for x in children]
    return PyTreeDef.from_node_data_and_children(default_registry, node, parts)


def _constant_data(value: Any) -> list[Any]:
    if value is _ABSENT:
        return ["absent"]
    if value is None or type(value) in (bool, int, float, str):
        return ["value", type(value).__name__, value]
    if type(value) in (tuple, list):
        return [type(value).__name__, [_constant_data(x) for x in value]]
    if isinstance(value, type | types.FunctionType):
        return ["name", _name(value)]
    raise HasNoText(f"a {type(value).__name__} has no text")


def _constant(data: list[Any]) -> Any:
    match data:
        case ["absent"]:
            return _ABSENT
        case ["value", _, value]:
            return value
        case ["name", name]:
            return _named(name)
        case ["tuple", values]:
            return tuple(_constant(x) for x in values)
        case [_, values]:
            return [_constant(x) for x in values]


def _name(value: "type[Any] | types.FunctionType") -> str:
    name = f"{value.__module__}:{value.__qualname__}"
    if value.__module__.partition(".")[0] not in _KNOWN or _named(name) is not value:
        raise HasNoText(f"{name} is defined elsewhere")
    return name


def _named(name: str) -> Any:
    module, _, path = name.partition(":")
    if module.partition(".")[0] not in _KNOWN:
        raise HasNoText(f"{name} is defined elsewhere")
    value = importlib.import_module(module)
    for part in path.split("."):
        value = getattr(value, part, None)
    return value
