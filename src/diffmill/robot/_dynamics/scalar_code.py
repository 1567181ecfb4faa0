"""Small vector algebra on scalars that are traced one by one.

A vector is a tuple of arrays and a matrix a tuple of rows; each array is one number,
or that number in every lane of a batch. Nothing is stacked, so zeros and symmetry cost
nothing and a batch runs along SIMD registers.

XLA's CPU compiler fuses such code until every result computes its own inputs again.
Two attributes of its calls stop that, for these operations alone: what a call that is
not inlined returns is stored (`materialise`), and a call that is declared small is
compiled to one function without a dispatch per operation (`as_scalar_code`). They are
hints: without them the results are the same.
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jax.experimental.xla_metadata import set_xla_metadata
from jaxtyping import Array, Float, PyTree

from ...numerics import materialise
from .._model.robot import Robot

Vector: TypeAlias = tuple[Array, ...]
Matrix: TypeAlias = tuple[Vector, ...]

# Lanes that are computed together: some hundred arrays of this length fit the second
# cache. XLA must not split an operation inside a small call into threads (it then emits
# a call with wrong arguments); it does so from 256 KiB on.
_BLOCK = 256


def _small_call(function: Callable[..., Array]) -> Callable[..., Array]:
    # XLA 0.10 stops at an argument that a small call in a loop does not use: all are
    # used by holding them.
    compiled = jax.jit(lambda *args: function(*materialise(args)))

    def call(*args: Any) -> Array:
        if jax.default_backend() != "cpu":
            return compiled(*args)
        with set_xla_metadata(inlineable="false", xla_cpu_small_call="true"):
            return compiled(*args)

    return call


def as_scalar_code(function: Callable[..., Array]) -> Callable[..., Array]:
    """Return a function of a robot and arrays, which `vmap` batches.

    Args:
        function: Of a robot and of arrays with any number of trailing axes of a batch;
            returns an array with the same trailing axes.

    Returns:
        The function of arrays without a batch. A batch of robots is computed one robot
        after the other.
    """
    compute = _small_call(function)

    @custom_vmap
    def single(robot: Robot, *args: Array) -> Array:
        return compute(robot, *args)

    @single.def_vmap
    def batch(
        count: int, is_batched: list[Any], robot: Robot, *args: Array
    ) -> tuple[Array, bool]:
        of_robot, *of_args = is_batched
        if any(jax.tree.leaves(of_robot)):
            row = lambda x: single(*_with_rows(is_batched, (robot, *args), x))
            rows = _rows(is_batched, (robot, *args))
            return jax.lax.map(row, rows), True
        full = [
            x if b else jnp.broadcast_to(x[None], (count, *x.shape))
            for x, b in zip(args, of_args, strict=True)
        ]
        return _in_blocks(compute, robot, full, count), True

    return single


def _rows(is_batched: Any, values: Any) -> list[Array]:
    """Return the leaves that have a row per element of the batch."""
    flags = jax.tree.leaves(is_batched)
    return [x for x, b in zip(jax.tree.leaves(values), flags, strict=True) if b]


def _with_rows(is_batched: Any, values: Any, rows: list[Array]) -> Any:
    """Return the values with one row each in place of the leaves of `_rows`."""
    leaves, tree = jax.tree.flatten(values)
    rest = iter(rows)
    flags = jax.tree.leaves(is_batched)
    return tree.unflatten(
        [next(rest) if b else x for x, b in zip(leaves, flags, strict=True)]
    )


def _in_blocks(
    compute: Callable[..., Array], robot: Robot, args: list[Array], count: int
) -> Array:
    """Return the results of a batch, whose axis is last inside, first outside."""
    if count <= _BLOCK:
        columns = compute(robot, *(jnp.moveaxis(x, 0, -1) for x in args))
        return jnp.moveaxis(columns, -1, 0)
    blocks = -(-count // _BLOCK)

    def split(x: Array) -> Array:
        # The last block is filled up with copies of the last element.
        spare = [(0, blocks * _BLOCK - count)] + [(0, 0)] * (x.ndim - 1)
        return jnp.pad(x, spare, mode="edge").reshape(blocks, _BLOCK, *x.shape[1:])

    def block(rows: list[Array]) -> Array:
        columns = compute(robot, *(jnp.moveaxis(x, 0, -1) for x in rows))
        return jnp.moveaxis(columns, -1, 0)

    found = jax.lax.map(block, [split(x) for x in args])
    return found.reshape(blocks * _BLOCK, *found.shape[2:])[:count]


def numbers(array: Float[Array, "..."], depth: int) -> PyTree:
    """Return the entries along the first `depth` axes as nested tuples."""
    if depth == 0:
        return array
    return tuple(numbers(array[i], depth - 1) for i in range(array.shape[0]))


def dot(left: Vector, right: Vector) -> Array:
    """Return the scalar product."""
    total = left[0] * right[0]
    for a, b in zip(left[1:], right[1:], strict=True):
        total = total + a * b
    return total


def add(first: Vector, *others: Vector) -> Vector:
    """Return the sum of vectors."""
    for other in others:
        first = tuple(a + b for a, b in zip(first, other, strict=True))
    return first


def scale(factor: Array, vector: Vector) -> Vector:
    """Return a multiple of a vector."""
    return tuple(factor * x for x in vector)


def cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def transpose(matrix: Matrix) -> Matrix:
    """Return the transposed matrix."""
    return tuple(zip(*matrix, strict=True))


def apply(matrix: Matrix, vector: Vector) -> Vector:
    """Return matrix times vector."""
    return tuple(dot(row, vector) for row in matrix)


def product(left: Matrix, right: Matrix) -> Matrix:
    """Return the product of matrices."""
    columns = transpose(right)
    return tuple(tuple(dot(row, column) for column in columns) for row in left)


def add_matrices(left: Matrix, right: Matrix) -> Matrix:
    """Return the sum of matrices."""
    return tuple(add(a, b) for a, b in zip(left, right, strict=True))


def symmetric(entry: Callable[[int, int], Array]) -> Matrix:
    """Return a symmetric 3 x 3 matrix from its upper entries."""
    upper = {(i, j): entry(i, j) for i in range(3) for j in range(i, 3)}
    return tuple(tuple(upper[min(i, j), max(i, j)] for j in range(3)) for i in range(3))
