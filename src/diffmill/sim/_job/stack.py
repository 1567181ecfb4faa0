"""Jobs of one shape as one, for `jax.vmap`."""

import dataclasses
from collections.abc import Sequence
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from ..._job import Job

_Tree = TypeVar("_Tree", bound=PyTree)


def stack(jobs: Sequence[_Tree]) -> _Tree:
    """Return jobs of one shape as one job, each number of it with an axis in front.

        forces = jax.vmap(lambda job: dm.simulate(job).force)(dm.stack(jobs))

    Jobs have one shape if they differ in numbers only: feeds, coefficients, springs,
    frequencies of modes, places of the part, but not stocks of other sizes or other
    counts of teeth. Paths are brought to the length of the longest; rows behind
    `path.row_count` are not simulated, what results hold there has no meaning. Names
    and texts are left out.

    Args:
        jobs: The jobs, or other trees of one structure, such as the `args` and `start`
            of `correction.residual`.

    Returns:
        The tree, in the precision of the jobs.

    Raises:
        ValueError: There is none, or two of them differ in more than numbers.

    **Differentiability**: smooth.
    """
    if not jobs:
        raise ValueError("Argument `jobs` must hold a job, but is empty.")
    is_job = lambda leaf: isinstance(leaf, Job)
    plain = [jax.tree.map(_plain, job, is_leaf=is_job) for job in jobs]
    if isinstance(plain[0], Job):
        longest = max(job.path.step_count for job in plain)
        plain = [
            dataclasses.replace(job, path=job.path.padded(longest)) for job in plain
        ]
    for k, other in enumerate(plain[1:], 1):
        if where := _difference(plain[0], other, ""):
            raise ValueError(
                "Argument `jobs` must hold jobs that differ in numbers only, but the "
                f"first and number {k + 1} differ in {where}."
            )
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *plain)


def _plain(leaf: PyTree) -> PyTree:
    """Return a job in its precision and without texts; another leaf as an array."""
    if not isinstance(leaf, Job):
        return jnp.asarray(leaf)
    job = leaf.with_precision()
    return dataclasses.replace(
        job, name="", source="", program="", notes=(), timing=None
    )


def _difference(one: PyTree, other: PyTree, where: str) -> str:
    """Return the first place in which two trees are not of one shape, or nothing."""
    if type(one) is not type(other):
        return f"`{where}` ({type(one).__name__} and {type(other).__name__})"
    if hasattr(one, "shape"):
        if one.shape == other.shape:
            return ""
        return f"the shape of `{where}` ({one.shape} and {other.shape})"
    if dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            place = f"{where}.{field.name}".lstrip(".")
            pair = getattr(one, field.name), getattr(other, field.name)
            if found := _difference(*pair, place):
                return found
        return ""
    if isinstance(one, tuple | list) and len(one) == len(other):
        for k, pair in enumerate(zip(one, other, strict=True)):
            if found := _difference(*pair, f"{where}[{k}]"):
                return found
        return ""
    return "" if one == other else f"`{where}` ({one} and {other})"
