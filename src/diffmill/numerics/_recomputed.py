"""What reverse mode computes again, and what it keeps for that."""

from collections.abc import Callable
from typing import ClassVar, ParamSpec, TypeVar

import jax
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import PyTree

P = ParamSpec("P")
R = TypeVar("R")
_T = TypeVar("_T", bound=PyTree)


class Rematerialised:
    """Functions that reverse mode computes again, and what it stores of them.

    What a function reads of a large table is small beside the table and beside what
    follows from it, so that only the reads are stored.

    Attributes:
        READ: Name under which JAX knows them.
    """

    READ: ClassVar[str] = "read"

    @classmethod
    def of(cls, function: Callable[P, R]) -> Callable[P, R]:
        """Return a function of which reverse mode stores what was `read`, and no more.

        Args:
            function: The function.
        """
        policy = jax.checkpoint_policies.save_only_these_names(cls.READ)
        return jax.checkpoint(function, policy=policy)

    @classmethod
    def read(cls, values: _T) -> _T:
        """Return arrays, a tree, marked as read of a table.

        Args:
            values: The arrays.
        """
        return jax.tree.map(lambda x: checkpoint_name(x, cls.READ), values)
