"""Vector algebra on scalars that are traced one by one, for `as_scalar_code`.

A vector is a tuple of arrays and a matrix a tuple of rows; each array is one number,
or that number of every element of a batch.
"""

from collections.abc import Callable
from typing import TypeAlias

from jaxtyping import Array, Float, PyTree

Vector: TypeAlias = tuple[Array, ...]
Matrix: TypeAlias = tuple[Vector, ...]


def numbers(array: Float[Array, "..."], depth: int) -> PyTree:
    """Entries along the first `depth` axes as nested tuples."""
    if depth == 0:
        return array
    return tuple(numbers(array[i], depth - 1) for i in range(array.shape[0]))


def dot(left: Vector, right: Vector) -> Array:
    """Scalar product."""
    total = left[0] * right[0]
    for a, b in zip(left[1:], right[1:], strict=True):
        total = total + a * b
    return total


def add(first: Vector, *others: Vector) -> Vector:
    """Sum of vectors."""
    for other in others:
        first = tuple(a + b for a, b in zip(first, other, strict=True))
    return first


def scale(factor: Array, vector: Vector) -> Vector:
    """Multiple of a vector."""
    return tuple(factor * x for x in vector)


def cross(a: Vector, b: Vector) -> Vector:
    """Cross product."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def transpose(matrix: Matrix) -> Matrix:
    """Transposed matrix."""
    return tuple(zip(*matrix, strict=True))


def apply(matrix: Matrix, vector: Vector) -> Vector:
    """Matrix times vector."""
    return tuple(dot(row, vector) for row in matrix)


def product(left: Matrix, right: Matrix) -> Matrix:
    """Product of matrices."""
    columns = transpose(right)
    return tuple(tuple(dot(row, column) for column in columns) for row in left)


def add_matrices(left: Matrix, right: Matrix) -> Matrix:
    """Sum of matrices."""
    return tuple(add(a, b) for a, b in zip(left, right, strict=True))


def symmetric(entry: Callable[[int, int], Array]) -> Matrix:
    """Symmetric 3 x 3 matrix from its upper entries."""
    upper = {(i, j): entry(i, j) for i in range(3) for j in range(i, 3)}
    return tuple(tuple(upper[min(i, j), max(i, j)] for j in range(3)) for i in range(3))
