"""Force linear in the chip thickness, plus an edge force."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int32

from ..settings.base import builds
from ..settings.force import LinearEdgeSettings
from ._law import (
    AbstractForceLaw,
    ToothValues,
    as_coefficient,
    check_teeth,
    of_tooth,
    tooth_count_of,
)


class LinearEdgeLaw(AbstractForceLaw):
    """Cutting force linear in the chip thickness, plus an edge force.

    Per chip width, dF_i = K_ic h + K_ie for i = t, r, a. Eq. (4) of the paper;
    Altintas, Manufacturing Automation, 2012, chapter 2. Each coefficient is a number
    or has one value per tooth, shape (tooth,).

    Attributes:
        K_tc: Tangential cutting coefficient [Pa].
        K_rc: Radial cutting coefficient [Pa].
        K_ac: Axial cutting coefficient [Pa]; positive pushes the tool toward the
            shank, as a left-hand helix does, negative toward the work, as a
            right-hand helix.
        K_te: Tangential edge coefficient [N/m].
        K_re: Radial edge coefficient [N/m].
        K_ae: Axial edge coefficient [N/m].
        NAMES: The names of the coefficients in this order.

    Raises:
        ValueError: If a coefficient is neither a number nor one per tooth, or two
            differ in the number of teeth.
    """

    NAMES: ClassVar[tuple[str, ...]] = ("K_tc", "K_rc", "K_ac", "K_te", "K_re", "K_ae")
    K_tc: ToothValues = eqx.field(converter=as_coefficient)
    K_rc: ToothValues = eqx.field(converter=as_coefficient)
    K_ac: ToothValues = eqx.field(converter=as_coefficient)
    K_te: ToothValues = eqx.field(converter=as_coefficient, default=0.0)
    K_re: ToothValues = eqx.field(converter=as_coefficient, default=0.0)
    K_ae: ToothValues = eqx.field(converter=as_coefficient, default=0.0)

    def __check_init__(self) -> None:
        """Refuse coefficients of a wrong shape."""
        check_teeth(
            K_tc=self.K_tc,
            K_rc=self.K_rc,
            K_ac=self.K_ac,
            K_te=self.K_te,
            K_re=self.K_re,
            K_ae=self.K_ae,
        )

    @property
    def tooth_count(self) -> int | None:
        """Number of teeth that have coefficients of their own, None for one for all."""
        return tooth_count_of(
            self.K_tc, self.K_rc, self.K_ac, self.K_te, self.K_re, self.K_ae
        )

    def force_per_width(
        self,
        chip_thickness: Float[Array, "*sample"],
        edge_contact: Float[Array, "*sample"],
        tooth: Int32[Array, "*sample"],
    ) -> tuple[
        Float[Array, "*sample"], Float[Array, "*sample"], Float[Array, "*sample"]
    ]:
        """Tangential, radial and axial force per width; see `AbstractForceLaw`.

        Differentiability: linear in the chip, the contact and the coefficients.
        """
        h, touch = chip_thickness, edge_contact
        K_tc, K_rc, K_ac, K_te, K_re, K_ae = (
            of_tooth(coefficient, h, tooth)
            for coefficient in (
                self.K_tc,
                self.K_rc,
                self.K_ac,
                self.K_te,
                self.K_re,
                self.K_ae,
            )
        )
        return (
            jnp.asarray(K_tc * h + K_te * touch),
            jnp.asarray(K_rc * h + K_re * touch),
            jnp.asarray(K_ac * h + K_ae * touch),
        )


@builds(LinearEdgeSettings)
def _linear_edge_law(settings: LinearEdgeSettings) -> LinearEdgeLaw:
    return LinearEdgeLaw(**vars(settings))
