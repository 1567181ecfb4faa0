"""Force laws: from chip thickness to force per chip width."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import RealScalarLike


class AbstractForceLaw(eqx.Module):
    """Force per chip width as a function of chip thickness."""

    @abc.abstractmethod
    def force_per_width(
        self,
        chip_thickness: Float[Array, "*sample"],
        edge_contact: Float[Array, "*sample"],
    ) -> tuple[
        Float[Array, "*sample"], Float[Array, "*sample"], Float[Array, "*sample"]
    ]:
        """Return tangential, radial and axial force per width [N/m]."""


class LinearEdgeLaw(AbstractForceLaw):
    """Cutting force linear in the chip thickness, plus an edge force.

    Per chip width, dF_i = K_ic h + K_ie for i = t, r, a. Eq. (4) of the paper;
    Altintas, Manufacturing Automation, 2012, chapter 2.

    Attributes:
        K_tc: Tangential cutting coefficient [Pa].
        K_rc: Radial cutting coefficient [Pa].
        K_ac: Axial cutting coefficient [Pa]; positive pushes the tool toward the
            shank.
        K_te: Tangential edge coefficient [N/m].
        K_re: Radial edge coefficient [N/m].
        K_ae: Axial edge coefficient [N/m].
    """

    K_tc: RealScalarLike
    K_rc: RealScalarLike
    K_ac: RealScalarLike
    K_te: RealScalarLike = 0.0
    K_re: RealScalarLike = 0.0
    K_ae: RealScalarLike = 0.0

    def force_per_width(
        self,
        chip_thickness: Float[Array, "*sample"],
        edge_contact: Float[Array, "*sample"],
    ) -> tuple[
        Float[Array, "*sample"], Float[Array, "*sample"], Float[Array, "*sample"]
    ]:
        """Return tangential, radial and axial force per width.

        Args:
            chip_thickness: Chip thickness h [m], zero outside the cut, any shape.
            edge_contact: 0 to 1, whether the edge touches the material, same shape.

        Returns:
            Three forces per chip width [N/m], each of the same shape.

        Differentiability: linear in all arguments and coefficients.
        """
        h, touch = jnp.asarray(chip_thickness), jnp.asarray(edge_contact)
        return (
            jnp.asarray(self.K_tc * h + self.K_te * touch),
            jnp.asarray(self.K_rc * h + self.K_re * touch),
            jnp.asarray(self.K_ac * h + self.K_ae * touch),
        )
