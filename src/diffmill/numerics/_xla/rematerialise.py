"""Functions that reverse mode computes again, from the reads that it stored."""

from collections.abc import Callable
from typing import ClassVar, ParamSpec, TypeVar

import jax
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import PyTree

P = ParamSpec("P")
R = TypeVar("R")
_T = TypeVar("_T", bound=PyTree)


class Rematerialised:
    """Functions that reverse mode computes again, and their reads, which it stores.

    The reads of a large table are small beside the table and beside all that a
    function computes from them.

    Attributes:
        READ: JAX's name of the reads.
    """

    READ: ClassVar[str] = "read"

    @classmethod
    def of(cls, function: Callable[P, R]) -> Callable[P, R]:
        """Function of which reverse mode stores the arrays that it `read`, no others.

        Args:
            function: The function.
        """
        policy = jax.checkpoint_policies.save_only_these_names(cls.READ)
        return jax.checkpoint(function, policy=policy)

    @classmethod
    def read(cls, values: _T) -> _T:
        """Arrays, marked as read of a table.

        Args:
            values: A tree of arrays.
        """
        return jax.tree.map(lambda x: checkpoint_name(x, cls.READ), values)
