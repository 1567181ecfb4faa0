"""Values that are stored, against a compiler that computes them again and again."""

from collections.abc import Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir, partial_eval

_T = TypeVar("_T")

# Primitives, since JAX looks through a call that returns its arguments where reverse
# mode separates known from unknown values.
_hold, _hold_backward = Primitive("hold"), Primitive("hold_backward")
_hold.multiple_results = _hold_backward.multiple_results = True


def materialise(values: _T, *, backward_only: bool = False) -> _T:
    """The values themselves, stored: their users load them, not compute them again.

    XLA's CPU compiler fuses a computation into each of its users. A call that is not
    inlined stops it, by an attribute of that call alone; on other devices a barrier
    does. It is a hint: without it the results are the same.

    Args:
        values: A tree of arrays.
        backward_only: Store the cotangents of the values, not the values.

    **Differentiability**: linear, the identity.
    """
    leaves, tree = jax.tree.flatten(values)
    primitive = _hold_backward if backward_only else _hold
    return jax.tree.unflatten(tree, primitive.bind(*leaves))


def _same(*values: Any) -> list[Any]:
    return list(values)


_identity = jax.jit(_same)


def _call(*values: Any) -> list[Any]:
    with set_xla_metadata(inlineable="false"):
        return _identity(*values)


def _barrier(*values: Any) -> list[Any]:
    return list(jax.lax.optimization_barrier(values))


def _of_nonzero(primitive: Primitive, values: Any) -> list[Any]:
    """Bind a primitive to the values that are no symbolic zeros."""
    is_zero = [isinstance(x, ad.Zero) for x in values]
    others = [x for x, no in zip(values, is_zero, strict=True) if not no]
    bound = iter(primitive.bind(*others))
    return [x if no else next(bound) for x, no in zip(values, is_zero, strict=True)]


def _without_unused(used: Sequence[bool], equation: Any) -> tuple[list[bool], Any]:
    """Used operands, and an equation of these alone, for JAX to drop others."""
    if not any(used):
        return list(used), None
    pick = lambda values: [
        x for x, is_used in zip(values, used, strict=True) if is_used
    ]
    both = {"invars": pick(equation.invars), "outvars": pick(equation.outvars)}
    return list(used), equation.replace(**both)


def _define(primitive: Primitive) -> None:
    def jvp(primals: Any, tangents: Any) -> tuple[list[Any], list[Any]]:
        return primitive.bind(*primals), _of_nonzero(primitive, tangents)

    def transpose(cotangents: Any, *operands: Any) -> list[Any]:
        del operands
        return _of_nonzero(_hold, cotangents)

    def batch(values: Any, axes: Any) -> tuple[list[Any], Any]:
        return primitive.bind(*values), axes

    primitive.def_impl(lambda *values: [jnp.asarray(x) for x in values])
    primitive.def_abstract_eval(_same)
    ad.primitive_jvps[primitive] = jvp
    ad.primitive_transposes[primitive] = transpose
    batching.primitive_batchers[primitive] = batch
    partial_eval.dce_rules[primitive] = _without_unused


for _each in (_hold, _hold_backward):
    _define(_each)
for _rule, _where in ((_barrier, None), (_call, "cpu")):
    _lowered = mlir.lower_fun(_rule, multiple_results=True)
    mlir.register_lowering(_hold, _lowered, platform=_where)
mlir.register_lowering(_hold_backward, mlir.lower_fun(_same, multiple_results=True))
