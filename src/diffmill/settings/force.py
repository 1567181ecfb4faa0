"""Settings of force laws: `[force]` of a job file."""

from collections.abc import Iterable
from typing import ClassVar

from .base import Strategy, key
from .fields import (
    PositiveLength,
    ToothEdgeForce,
    ToothExponent,
    ToothPositivePressure,
    ToothPressure,
)

# A coefficient so many times the tangential one is none of a metal.
_LARGE = 1.5


class ForceLawSettings(Strategy, table="force"):
    """Force law, chosen by `law`: force per chip width, of the chip thickness h.

    Its builder takes the settings.

    Attributes:
        compared: Cutting coefficients whose sizes are compared, the tangential one
            first.
    """

    compared: ClassVar[tuple[str, ...]] = ()

    def unusual(self) -> Iterable[str]:
        """Keys of coefficients that are large beside the tangential one, with why."""
        sizes = [_largest(getattr(self, name)) for name in self.compared]
        for name, size in zip(self.compared, sizes, strict=True):
            if size > _LARGE * sizes[0]:
                yield (
                    f"{name}: {size / sizes[0]:.3g} times {self.compared[0]}; less "
                    "than that is usual: are they interchanged?"
                )


def _largest(values: float | list[float]) -> float:
    """Largest size of the coefficients of the teeth."""
    return max(map(abs, values)) if isinstance(values, list) else abs(values)


class LinearEdgeSettings(ForceLawSettings, name="linear_edge"):
    """Force per chip width K_c h + K_e, of the chip thickness h."""

    compared: ClassVar[tuple[str, ...]] = ("K_tc", "K_rc", "K_ac")
    K_tc: ToothPositivePressure = key(
        'tangential cutting coefficient, such as "989.8 N/mm^2"'
    )
    K_rc: ToothPressure = key('radial cutting coefficient, such as "337.3 N/mm^2"')
    K_ac: ToothPressure = key('axial cutting coefficient, such as "66.9 N/mm^2"')
    K_te: ToothEdgeForce = key(
        'tangential edge coefficient, such as "3.0 N/mm"', default=0.0
    )
    K_re: ToothEdgeForce = key(
        'radial edge coefficient, such as "3.0 N/mm"', default=0.0
    )
    K_ae: ToothEdgeForce = key(
        'axial edge coefficient, such as "3.0 N/mm"', default=0.0
    )


class KienzleSettings(ForceLawSettings, name="kienzle"):
    """Force per chip width K_c11 (h / h_1)^-m h + K_e, of the chip thickness h."""

    compared: ClassVar[tuple[str, ...]] = ("K_tc11", "K_rc11", "K_ac11")
    K_tc11: ToothPositivePressure = key(
        "tangential cutting coefficient at the reference thickness h_1 (k_c1.1), such "
        'as "1500 N/mm^2"'
    )
    K_rc11: ToothPressure = key(
        'radial cutting coefficient at h_1, such as "500 N/mm^2"'
    )
    K_ac11: ToothPressure = key('axial cutting coefficient at h_1, such as "0 N/mm^2"')
    m_t: ToothExponent = key(
        "exponent of the tangential coefficient (m_c), a number from 0 to below 1, "
        "such as 0.25"
    )
    m_r: ToothExponent | None = key(
        "exponent of the radial coefficient; m_t if left out", default=None
    )
    m_a: ToothExponent | None = key(
        "exponent of the axial coefficient; m_t if left out", default=None
    )
    K_te: ToothEdgeForce = key(
        'tangential edge coefficient, such as "3.0 N/mm"', default=0.0
    )
    K_re: ToothEdgeForce = key(
        'radial edge coefficient, such as "3.0 N/mm"', default=0.0
    )
    K_ae: ToothEdgeForce = key(
        'axial edge coefficient, such as "3.0 N/mm"', default=0.0
    )
    reference_thickness: PositiveLength = key(
        "chip thickness h_1 of K_tc11, K_rc11 and K_ac11", default=1e-3
    )
    least_thickness: PositiveLength = key(
        "chip thickness below which a cutting coefficient follows its tangent",
        default=1e-6,
    )
