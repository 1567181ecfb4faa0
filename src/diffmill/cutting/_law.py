"""Force laws: from chip thickness to force per chip width."""

import abc
import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int32

from .._types import RealScalarLike

# One number for all teeth, or one per tooth.
ToothValues = RealScalarLike | Float[Array, " tooth"] | Float[np.ndarray, " tooth"]


class AbstractForceLaw(eqx.Module):
    """Force per chip width on an element of the edge.

    Directions belong to the element: F_t acts against the cutting motion, F_r along
    the element's outward normal reversed, so into the tool, and F_a along the third
    direction: up the shank on the side of a cutter. Chip width is measured along
    the edge.
    """

    @abc.abstractmethod
    def force_per_width(
        self,
        chip_thickness: Float[Array, "*sample"],
        edge_contact: Float[Array, "*sample"],
        tooth: Int32[Array, "*sample"],
    ) -> tuple[
        Float[Array, "*sample"], Float[Array, "*sample"], Float[Array, "*sample"]
    ]:
        """Tangential, radial and axial force per width.

        Args:
            chip_thickness: Chip thickness h [m], zero outside the cut, any shape.
            edge_contact: Contact of edge and material, 0 to 1, same shape.
            tooth: Index of the tooth, same shape; matters only to coefficients per
                tooth.

        Returns:
            Three forces per chip width [N/m], each of the same shape.
        """

    def for_bottom(self) -> "AbstractForceLaw":
        """Law of the bottom edges that is derived from this one.

        A bottom edge is taken as the same edge without inclination: F_t and F_r as
        on the side, F_r now along the axis, and no force along the edge. That force
        comes from the chip's flow over an inclined edge, and a bottom edge, nearly
        radial, has none even where the side has a helix.
        """
        return UninclinedLaw(self)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the uncertain parameters: the fields that hold real numbers."""

        def is_real(value: object) -> bool:
            dtype = getattr(value, "dtype", None)
            if dtype is None:
                return isinstance(value, float)
            return bool(jnp.issubdtype(dtype, jnp.floating))

        names = [field.name for field in dataclasses.fields(self)]
        return tuple(name for name in names if is_real(getattr(self, name)))

    @property
    def tooth_count(self) -> int | None:
        """Number of teeth that have coefficients of their own, None for one for all."""
        return None


class UninclinedLaw(AbstractForceLaw):
    """Another law without its force F_a along the edge.

    Attributes:
        law: The law that gives F_t and F_r.
    """

    law: AbstractForceLaw

    def force_per_width(
        self,
        chip_thickness: Float[Array, "*sample"],
        edge_contact: Float[Array, "*sample"],
        tooth: Int32[Array, "*sample"],
    ) -> tuple[
        Float[Array, "*sample"], Float[Array, "*sample"], Float[Array, "*sample"]
    ]:
        """F_t, F_r and zero per width; see `AbstractForceLaw`.

        Differentiability: as `law`.
        """
        F_t, F_r, _ = self.law.force_per_width(chip_thickness, edge_contact, tooth)
        return F_t, F_r, jnp.zeros_like(F_t)

    @property
    def tooth_count(self) -> int | None:
        """Number of teeth of the other law, None for one for all."""
        return self.law.tooth_count


def as_coefficient(value: ToothValues | Sequence[RealScalarLike]) -> ToothValues:
    """Coefficient in floating point, so that it is one of the parameters."""
    if isinstance(value, float | jax.Array | np.ndarray):
        is_real = jnp.issubdtype(jnp.result_type(value), jnp.floating)
        return value if is_real else jnp.asarray(value, float)
    known = np.asarray(value, np.float64)
    return float(known) if known.ndim == 0 else known


def check_teeth(**coefficients: ToothValues) -> None:
    """Refuse coefficients that are neither numbers nor one number per tooth.

    Args:
        **coefficients: By name, each of shape () or (tooth,).

    Raises:
        ValueError: If one has more axes, or if two have different numbers of teeth.

    Differentiability: not applicable, looks at shapes only.
    """
    shapes = {name: np.shape(value) for name, value in coefficients.items()}
    for name, shape in shapes.items():
        if len(shape) > 1 or shape == (0,):
            raise ValueError(
                f"Argument `{name}` must be a number or have shape (tooth,), but has "
                f"shape {shape}."
            )
    counts = {name: shape[0] for name, shape in shapes.items() if shape}
    if len(set(counts.values())) > 1:
        listed = ", ".join(f"{name}: {count}" for name, count in counts.items())
        raise ValueError(
            "Coefficients with one value per tooth must all have as many values, but "
            f"found {listed}."
        )


def tooth_count_of(*coefficients: ToothValues) -> int | None:
    """Number of teeth of the coefficients with a value per tooth; None without any.

    Args:
        *coefficients: Each of shape () or (tooth,), as `check_teeth` lets them pass.
    """
    for value in coefficients:
        # A traced list is a list of tracers, which NumPy cannot take.
        shape = (len(value),) if isinstance(value, list) else np.shape(value)
        if shape:
            return shape[0]
    return None


def of_tooth(
    coefficient: ToothValues,
    like: Float[Array, "*sample"],
    tooth: Int32[Array, "*sample"],
) -> Float[Array, "..."]:
    """Coefficient at samples of several teeth.

    Args:
        coefficient: Shape () or (tooth,), any unit.
        like: Sets the floating point type, any shape.
        tooth: Index of the tooth from 0, same shape.

    Returns:
        Shape () for a number, else that of `tooth`; NaN where there is no such tooth,
        so that too short a list cannot pass unnoticed.

    Differentiability: linear in the coefficient.
    """
    values = jnp.asarray(coefficient, like.dtype)
    if values.ndim == 0:
        return values
    return values.at[tooth].get(mode="fill", fill_value=jnp.nan)
