"""Array aliases that several subpackages share."""

import inspect
import re
from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

import numpy as np
from jaxtyping import Array, Bool, Float, Int

# What a user may pass wherever a number is expected.
RealScalarLike: TypeAlias = (
    float | int | np.floating | np.integer | Float[Array, ""] | Float[np.ndarray, ""]
)

# Trajectories as users pass them: NumPy on the host or JAX when traced.
FloatRows3: TypeAlias = Float[Array, "step 3"] | Float[np.ndarray, "step 3"]
FloatRows: TypeAlias = Float[Array, "step axis"] | Float[np.ndarray, "step axis"]
FloatSteps: TypeAlias = Float[Array, " step"] | Float[np.ndarray, " step"]
BoolSteps: TypeAlias = Bool[Array, " step"] | Bool[np.ndarray, " step"]
IntScalar: TypeAlias = Int[Array, ""] | Int[np.ndarray, ""]
IntSteps: TypeAlias = Int[Array, " step"] | Int[np.ndarray, " step"]
Transform: TypeAlias = Float[Array, "4 4"] | Float[np.ndarray, "4 4"]

_Function = TypeVar("_Function", bound=Callable[..., Any])
_MODULES = re.compile(r"(?:\b\w+\.)+(?=\w)")


class _ShortName(str):
    """Text of an annotation that a signature shows without quotes."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


def readable_signature(function: _Function) -> _Function:
    """Let help show the signature of a function without modules' names.

    Args:
        function: The function; its annotations stay as they are.
    """
    found = inspect.signature(function)
    short = lambda x: _ShortName(_MODULES.sub("", inspect.formatannotation(x)))
    parameters = [
        p if p.annotation is p.empty else p.replace(annotation=short(p.annotation))
        for p in found.parameters.values()
    ]
    result = found.return_annotation
    if result is not found.empty:
        result = short(result)
    readable = found.replace(parameters=parameters, return_annotation=result)
    function.__signature__ = readable  # pyright: ignore[reportFunctionMemberAccess]
    return function
