"""Segments of a long path: rows that are run together, all of one length."""

import dataclasses
from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Int, PyTree


class PathSegment(NamedTuple):
    """Some rows of a path that are run together.

    Attributes:
        first: Row of the path at which they begin, the last of the segment before.
        row_count: How many of them there are.
        length: To how many they are padded; all segments of a path have one length.
        total: Rows of the path.
    """

    first: int
    row_count: int
    length: int
    total: int

    def rows(self, before: int = 0, behind: int = 0) -> Int[np.ndarray, " row"]:
        """Rows of the path, with more at either end; the outermost come again.

        Args:
            before: How many more before the first.
            behind: How many more behind the last.
        """
        rows = np.arange(self.first - before, self.first + self.length + behind)
        return np.clip(rows, 0, self.total - 1)

    def put(self, path: PyTree, rows: PyTree) -> None:
        """Put rows of the segment into arrays of the whole path.

        Row 0 of a segment belongs to the one before, if there is one.

        Args:
            path: Arrays of the path, on the host.
            rows: Arrays of the segment, in the same tree.
        """
        own = min(self.first, 1)

        def put(path: np.ndarray, rows: np.ndarray | Array) -> None:
            part = np.asarray(rows)[own : self.row_count]
            path[self.first + own : self.first + self.row_count] = part

        jax.tree.map(put, path, rows)


@dataclasses.dataclass(frozen=True)
class Segments:
    """Segments of a long path.

    Attributes:
        total: Rows of the path.
        length: Rows of a segment; two that follow each other share one.
    """

    total: int
    length: int

    def __iter__(self) -> Iterator[PathSegment]:
        """Segments in the order of the path."""
        for first in range(0, self.total - 1, self.length - 1):
            count = min(self.length, self.total - first)
            yield PathSegment(first, count, self.length, self.total)
