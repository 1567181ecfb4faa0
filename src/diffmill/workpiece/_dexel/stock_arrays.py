"""A stock as named plain arrays and back, every property of a stock checked."""

import math
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Shaped

from .._memory import check_memory
from .stock import Rays, Stock

_NAMES = frozenset(
    {"origin", "spacing", "top"}
    | {f"{n}_{f}" for n in ("ends", "poses") for f in "xyz"}
)
# Files of the first version have no weights.
_OPTIONAL = frozenset({"volume_weights"})
# Intervals of a ray may overlap by rounding in single precision [m].
_OVERLAP = 1e-7


def arrays_of_stock(stock: Stock) -> dict[str, Shaped[np.ndarray, "..."]]:
    """Arrays of a stock by name, lengths in metres."""
    arrays = {
        "origin": np.asarray(stock.origin),
        "spacing": np.asarray(stock.spacing),
        "top": np.asarray(stock.top),
        "volume_weights": np.asarray(stock.volume_weights),
    }
    for axis, rays in zip("xyz", stock.families, strict=True):
        arrays[f"ends_{axis}"] = np.asarray(rays.ends)
        arrays[f"poses_{axis}"] = np.asarray(rays.poses)
    return arrays


def check_headers(headers: Mapping[str, jax.ShapeDtypeStruct]) -> None:
    """Raise if arrays cannot be a stock, judged by their shapes and types.

    Args:
        headers: Shape and type by name.

    Raises:
        ValueError: Arrays are missing or unknown, of wrong shape or type, or too large.
    """
    if missing := sorted(_NAMES - headers.keys()):
        raise ValueError(f"the arrays {', '.join(missing)} are missing")
    if unknown := sorted(headers.keys() - _NAMES - _OPTIONAL):
        raise ValueError(f"the arrays {', '.join(unknown)} are unknown")
    for name, header in headers.items():
        shape, dtype = header.shape, header.dtype
        if dtype.kind != ("i" if name.startswith("poses") else "f"):
            raise ValueError(f"the array {name} holds {dtype}, which is not allowed")
        wanted = {"origin": (3,), "volume_weights": (3,), "spacing": (), "top": ()}
        if name in wanted and shape != wanted[name]:
            raise ValueError(f"the array {name} has shape {shape}")
    shapes = {name: header.shape for name, header in headers.items()}
    for axis in "xyz":
        shape = shapes[f"ends_{axis}"]
        if len(shape) != 4 or shape[2] != 2 or min(shape) < 1:
            raise ValueError(f"the array ends_{axis} has shape {shape}")
        if shapes[f"poses_{axis}"] != shape:
            raise ValueError(f"the arrays ends_{axis} and poses_{axis} differ in shape")
    lines = [shapes[f"ends_{axis}"][:2] for axis in "xyz"]
    if any(lines[f][1] != lines[(f + 1) % 3][0] for f in range(3)):
        raise ValueError("the families of rays do not stand on one grid")
    size = sum(math.prod(h.shape) * h.dtype.itemsize for h in headers.values())
    check_memory(float(size), "the stock")


def stock_of_arrays(
    arrays: Mapping[str, Shaped[np.ndarray, "..."]],
    *,
    is_raw: bool,
    dtype: type | jnp.dtype | None,
) -> Stock:
    """Stock of arrays whose shapes and types have been checked.

    Args:
        arrays: The arrays by name.
        is_raw: True if the ends forget their poses and the top is the highest material.
        dtype: Floating type; JAX's default if not given.

    Raises:
        ValueError: The numbers are none of a stock.
    """
    spacing, origin = float(arrays["spacing"]), arrays["origin"]
    if not (math.isfinite(spacing) and spacing > 0):
        raise ValueError(f"the spacing is {spacing}")
    if not (np.isfinite(origin).all() and np.isfinite(arrays["top"])):
        raise ValueError("origin and top must be finite")
    for axis in "xyz":
        _check_ends(arrays[f"ends_{axis}"], axis)
    dtype = jnp.zeros(()).dtype if dtype is None else jnp.dtype(dtype)
    x, y, z = (
        Rays(
            jnp.asarray(arrays[f"ends_{axis}"], dtype),
            jnp.asarray(arrays[f"poses_{axis}"], jnp.int32),
        )
        for axis in "xyz"
    )
    weights = arrays.get("volume_weights", np.array([0.0, 0.0, 1.0]))
    if not (np.isfinite(weights).all() and abs(weights.sum() - 1) < 1e-6):
        raise ValueError("the volume weights must sum to 1")
    stock = Stock(
        families=(x, y, z),
        origin=jnp.asarray(origin, dtype),
        spacing=spacing,
        top=float(arrays["top"]),
        volume_weights=(float(weights[0]), float(weights[1]), float(weights[2])),
    )
    return stock.as_raw() if is_raw else stock


def _check_ends(ends: Float[np.ndarray, "u v 2 slot"], axis: str) -> None:
    if not np.isfinite(ends).all():
        raise ValueError(f"the array ends_{axis} holds numbers that are not finite")
    low, high = ends[:, :, 0], ends[:, :, 1]
    is_live = high > low
    if (
        is_live.any()
        and np.abs(ends[:, :, :][np.stack([is_live] * 2, 2)]).max() >= Rays.DEAD
    ):
        raise ValueError(f"the array ends_{axis} reaches beyond {Rays.DEAD:g} m")
    # Live slots in order, the dead ones behind.
    order = np.argsort(np.where(is_live, low, np.inf), axis=-1)
    low = np.take_along_axis(np.where(is_live, low, np.inf), order, axis=-1)
    high = np.take_along_axis(np.where(is_live, high, -np.inf), order, axis=-1)
    if (low[..., 1:] < high[..., :-1] - _OVERLAP).any():
        raise ValueError(f"the array ends_{axis} holds intervals that overlap")
