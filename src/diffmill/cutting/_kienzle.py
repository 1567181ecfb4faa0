"""Cutting force that is a power of the chip thickness: Kienzle's law.

Thin chips need more force per area. Kienzle's coefficient is K(h) = K_1 (h / h_1)^-m,
with K_1 the value at the reference thickness h_1, by convention 1 mm. Force per width
is K(h) h, whose slope grows without bound as h goes to zero, so below a least
thickness h_0 the coefficient follows its tangent:

    K(h) = K(h_0) (1 + m (1 - h / h_0)),   0 <= h < h_0.

Force and slope are continuous there, force is exactly zero at h = 0, and its slope
there is (1 + m) K(h_0).
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int32

from .._types import RealScalarLike
from ..settings.base import builds
from ..settings.force import KienzleSettings
from ._law import (
    AbstractForceLaw,
    ToothValues,
    as_coefficient,
    check_teeth,
    of_tooth,
    tooth_count_of,
)


class KienzleLaw(AbstractForceLaw):
    """Cutting force with an exponent of the chip thickness, plus an edge force.

    Per chip width, dF_i = K_ic11 (h / h_1)^-m_i h + K_ie for i = t, r, a. The
    tangential pair is the k_c1.1 and m_c of tables of specific cutting force, which
    hold the edge force already: leave K_ie zero with these.

    The exponential form of Altintas, K_tc = K_T h^-p, is the same law with
    K_T = K_tc11 h_1^m_t and p = m_t. If K_T was found with h in mm, its number in
    N/mm^2 is that of K_tc11, h_1 = 1 mm. If K_T is in SI units, h in m, set
    `reference_thickness` to 1.

    Each coefficient and exponent is a number or has one value per tooth, shape
    (tooth,).

    Attributes:
        K_tc11: Tangential cutting coefficient at the reference thickness [Pa].
        K_rc11: Radial cutting coefficient at the reference thickness [Pa].
        K_ac11: Axial cutting coefficient at the reference thickness [Pa]; positive
            pushes the tool toward the shank, as a left-hand helix does, negative
            toward the work, as a right-hand helix.
        m_t: Tangential exponent [-], from 0 to less than 1.
        m_r: Radial exponent [-], from 0 to less than 1.
        m_a: Axial exponent [-], from 0 to less than 1.
        K_te: Tangential edge coefficient [N/m].
        K_re: Radial edge coefficient [N/m].
        K_ae: Axial edge coefficient [N/m].
        reference_thickness: Chip thickness h_1 of K_ic11 [m].
        least_thickness: Chip thickness h_0 below which the coefficient follows its
            tangent [m], above 0.

    Raises:
        ValueError: If a coefficient or exponent is neither a number nor one per
            tooth, or two differ in the number of teeth.
    """

    K_tc11: ToothValues = eqx.field(converter=as_coefficient)
    K_rc11: ToothValues = eqx.field(converter=as_coefficient)
    K_ac11: ToothValues = eqx.field(converter=as_coefficient)
    m_t: ToothValues = eqx.field(converter=as_coefficient)
    m_r: ToothValues = eqx.field(converter=as_coefficient)
    m_a: ToothValues = eqx.field(converter=as_coefficient)
    K_te: ToothValues = eqx.field(converter=as_coefficient, default=0.0)
    K_re: ToothValues = eqx.field(converter=as_coefficient, default=0.0)
    K_ae: ToothValues = eqx.field(converter=as_coefficient, default=0.0)
    reference_thickness: RealScalarLike = eqx.field(
        converter=as_coefficient, default=KienzleSettings.reference_thickness
    )
    least_thickness: RealScalarLike = eqx.field(
        converter=as_coefficient, default=KienzleSettings.least_thickness
    )

    def __check_init__(self) -> None:
        """Refuse coefficients of a wrong shape."""
        check_teeth(
            K_tc11=self.K_tc11,
            K_rc11=self.K_rc11,
            K_ac11=self.K_ac11,
            m_t=self.m_t,
            m_r=self.m_r,
            m_a=self.m_a,
            K_te=self.K_te,
            K_re=self.K_re,
            K_ae=self.K_ae,
        )

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of coefficients and exponents; the two thicknesses are conventions."""
        conventions = ("reference_thickness", "least_thickness")
        return tuple(x for x in super().parameter_names if x not in conventions)

    @property
    def tooth_count(self) -> int | None:
        """Number of teeth that have coefficients of their own, None for one for all."""
        cutting = (self.K_tc11, self.K_rc11, self.K_ac11, self.m_t, self.m_r, self.m_a)
        return tooth_count_of(*cutting, self.K_te, self.K_re, self.K_ae)

    def force_per_width(
        self,
        chip_thickness: Float[Array, "*sample"],
        edge_contact: Float[Array, "*sample"],
        tooth: Int32[Array, "*sample"],
    ) -> tuple[
        Float[Array, "*sample"], Float[Array, "*sample"], Float[Array, "*sample"]
    ]:
        """Tangential, radial and axial force per width; see `AbstractForceLaw`.

        Differentiability: once continuously differentiable in the chip, h = 0
        included; the curvature jumps at the least thickness. Smooth in the
        coefficients and exponents.
        """
        h, touch = chip_thickness, edge_contact
        components = (
            (self.K_tc11, self.m_t, self.K_te),
            (self.K_rc11, self.m_r, self.K_re),
            (self.K_ac11, self.m_a, self.K_ae),
        )
        F_t, F_r, F_a = (
            self._cutting(h, of_tooth(K_1, h, tooth), of_tooth(m, h, tooth))
            + of_tooth(K_e, h, tooth) * touch
            for K_1, m, K_e in components
        )
        return F_t, F_r, F_a

    def _cutting(
        self,
        h: Float[Array, "*sample"],
        K_1: Float[Array, "..."],
        m: Float[Array, "..."],
    ) -> Float[Array, "*sample"]:
        """Cutting part K(h) h of one component [N/m]."""
        h_1 = jnp.asarray(self.reference_thickness, h.dtype)
        h_0 = jnp.asarray(self.least_thickness, h.dtype)
        # The power never sees a chip below h_0: at zero its derivative is infinite.
        thick = jnp.where(h > h_0, h, h_0)
        tangent = 1 + m * (thick - h) / h_0
        return K_1 * (thick / h_1) ** -m * tangent * h


@builds(KienzleSettings)
def _kienzle_law(settings: KienzleSettings) -> KienzleLaw:
    given = {name: value for name, value in vars(settings).items() if value is not None}
    return KienzleLaw(**{"m_r": settings.m_t, "m_a": settings.m_t} | given)
