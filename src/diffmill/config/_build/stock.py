"""The stock of a job: a block, a mesh file, or what an earlier run left."""

import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...workpiece import (
    Mesh,
    Stock,
    StockFileError,
    box,
    from_mesh,
    load_stock,
)
from .._schema.job import StockTable
from .context import FileContext

# A result and a job may state the same spacing with different rounding.
_SAME_SPACING = 1e-6
_BLOCK_SLOTS = (8, 8, 1)


class StockPlan(eqx.Module):
    """Extent of a stock, before or after it is made.

    Attributes:
        lower: Least x, y, z [m], shape (3,).
        upper: Greatest x, y, z [m], shape (3,).
        spacing: Distance between rays [m].
        interval_counts: Slots of a ray of a block along x, y and z.
        dtype: Floating type.
        stock: The stock from a file; a block is made when all else is right.
    """

    lower: Float[np.ndarray, " 3"]
    upper: Float[np.ndarray, " 3"]
    spacing: float
    interval_counts: tuple[int, int, int]
    dtype: jnp.dtype
    stock: Stock | None

    def make(self) -> Stock:
        """Stock of the plan."""
        if self.stock is not None:
            return self.stock
        return box(
            self.lower,
            self.upper,
            self.spacing,
            interval_counts=self.interval_counts,
            dtype=self.dtype,
        )


def read_stock(
    table: StockTable,
    precision: str,
    context: FileContext,
) -> StockPlan | None:
    """Plan of a job's stock; None after a fault.

    Args:
        table: The table `[stock]`.
        precision: "float64" or "float32".
        context: The job file.
    """
    # Without 64-bit numbers in JAX a request for them would only give a warning.
    is_double = precision == "float64" and jax.config.read("jax_enable_x64")
    dtype = jnp.dtype(np.float64 if is_double else np.float32)
    is_box = table.lower is not None or table.upper is not None
    sources = {
        "lower and upper": is_box,
        "mesh": table.mesh is not None,
        "result": table.result is not None,
    }
    found = [name for name, is_given in sources.items() if is_given]
    if len(found) > 1:
        context.problems.append(
            f"[stock]: found {', '.join(found)}; only one of lower and upper, mesh, "
            "and result is allowed"
        )
        return None
    if table.mesh_unit is not None and table.mesh is None:
        context.problems.append(
            "[stock] mesh_unit: found it without mesh, which it is for"
        )
    if table.spacing is None and table.result is None:
        context.problems.append(
            "[stock] spacing: found nothing, but it is required: a length, such as "
            '"0.2 mm"'
        )
    if table.mesh is not None:
        return _from_mesh(table, dtype, context)
    if table.result is not None:
        return _from_result(table, dtype, context)
    return _block(table, dtype, context.problems)


def _block(
    table: StockTable, dtype: jnp.dtype, problems: list[str]
) -> StockPlan | None:
    """Plan of a block; a fault if it is empty or too large for this computer."""
    before = len(problems)
    for key in ("lower", "upper"):
        if getattr(table, key) is None:
            problems.append(
                f"[stock] {key}: found nothing, but it is required: three lengths, "
                'such as ["80 mm", ...]; or mesh or result instead of a block'
            )
    if table.lower is None or table.upper is None:
        return None
    for key in ("lower", "upper"):
        corner = getattr(table, key)
        if max(map(abs, corner)) > Mesh.FARTHEST:
            far = ", ".join(f"{x:g}" for x in corner)
            problems.append(
                f"[stock] {key}: found {far} m; at most {Mesh.FARTHEST:g} m is allowed"
            )
    for axis, low, high in zip("xyz", table.lower, table.upper, strict=True):
        if high <= low:
            problems.append(
                f"[stock] upper: found {high * 1e3:g} mm in {axis}, but more than "
                f"lower ({low * 1e3:g} mm) is required"
            )
    if len(problems) > before or table.spacing is None:
        return None
    lower, upper = np.asarray(table.lower), np.asarray(table.upper)
    if table.spacing > (widest := float(np.max(upper - lower))):
        problems.append(
            f"[stock] spacing: found {table.spacing * 1e3:g} mm, but at most the "
            f"longest edge of the block, {widest * 1e3:g} mm, is allowed"
        )
        return None
    slots = _slots(table) or _BLOCK_SLOTS
    memory = Stock.memory_of_block(upper - lower, table.spacing, slots, dtype.itemsize)
    if memory.is_too_much:
        problems.append(
            f"[stock] spacing: found {table.spacing * 1e3:g} mm, for which the stock "
            f"takes {memory.needed / 1e9:.3g} GB; at most half of the physical memory, "
            f"{memory.limit / 1e9:.3g} GB, is allowed: take a larger spacing, a "
            "smaller box or float32"
        )
        return None
    return StockPlan(lower, upper, table.spacing, slots, dtype, None)


def _from_mesh(
    table: StockTable,
    dtype: jnp.dtype,
    context: FileContext,
) -> StockPlan | None:
    assert table.mesh is not None
    path = context.file(table.mesh, "[stock] mesh")
    if path is None or table.spacing is None:
        return None
    try:
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            stock = from_mesh(
                path,
                table.spacing,
                unit=table.mesh_unit or "mm",
                interval_counts=_slots(table),
                dtype=dtype,
            )
        context.notes.extend(f"[stock] mesh: {item.message}" for item in found)
    except ValueError as error:
        key = "intervals" if "`interval_counts`" in str(error) else "mesh"
        context.problems.append(f"[stock] {key}: {error}")
        return None
    return _plan_of(stock, dtype)


def _from_result(
    table: StockTable,
    dtype: jnp.dtype,
    context: FileContext,
) -> StockPlan | None:
    assert table.result is not None
    path = context.file(f"{table.result}/stock.npz", "[stock] result")
    if path is None:
        return None
    try:
        stock = load_stock(path, dtype=dtype)
        slots = _slots(table)
        stock = stock if slots is None else stock.with_interval_counts(slots)
    except StockFileError as error:
        context.problems.append(f"[stock] result: {error}")
        return None
    except ValueError as error:
        context.problems.append(f"[stock] intervals: {error}")
        return None
    off = 0.0 if table.spacing is None else abs(table.spacing / stock.spacing - 1)
    if table.spacing is not None and off > _SAME_SPACING:
        context.problems.append(
            f"[stock] spacing: found {table.spacing * 1e3:g} mm, but the rays of the "
            f"result are {stock.spacing * 1e3:g} mm apart; state that or nothing"
        )
        return None
    return _plan_of(stock, dtype)


def _slots(table: StockTable) -> tuple[int, int, int] | None:
    if table.intervals is None:
        return None
    x, y, z = table.intervals
    return x, y, z


def _plan_of(stock: Stock, dtype: jnp.dtype) -> StockPlan:
    points = np.concatenate([stock.ray_ends(f).points for f in range(3)])
    upper = points.max(axis=0)
    # The highest point of a mesh may lie between the rays.
    upper[2] = stock.top
    counts = stock.interval_counts
    return StockPlan(points.min(axis=0), upper, stock.spacing, counts, dtype, stock)
