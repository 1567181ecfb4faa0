"""End mills from the sizes in a catalogue."""

import dataclasses
import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arrays import is_traced
from .._types import RealScalarLike
from ._end_mill import EndMill

# Largest difference of a whole turn and the sum of the angles between the teeth [rad].
_TURN_TOLERANCE = 1e-6
# Angles between the teeth that differ by less are even [rad].
_PITCH_ROUNDING = 1e-12

_Angles = Float[Array, " tooth"] | Float[np.ndarray, " tooth"]
Pitch = Sequence[float] | _Angles


def flat_end_mill(
    diameter: RealScalarLike,
    teeth: int,
    helix_angle: RealScalarLike = 0.0,
    *,
    flute_length: float | None = None,
    nominal_diameter: float | None = None,
    pitch: Pitch | None = None,
    runout: RealScalarLike = 0.0,
    runout_angle: RealScalarLike = 0.0,
    dish_angle: RealScalarLike = 0.0,
) -> EndMill:
    """Flat end mill.

    Args:
        diameter: Diameter [m], shape ().
        teeth: Number of teeth.
        helix_angle: Helix angle [rad], shape (); positive for a right-hand helix, whose
            edge lags behind its tip.
        flute_length: Height of the cutting part [m]; three diameters if not given.
        nominal_diameter: Diameter that sizes the windows of rays [m]; needed only
            where `diameter` is a traced value.
        pitch: Angle from each tooth to the next [rad], shape (tooth,), the last one
            back to the first; even if not given.
        runout: Distance of the axis of rotation from the cutter's own [m], shape ().
        runout_angle: Direction of that offset from tooth 0 [rad], shape ().
        dish_angle: Angle by which the end is ground hollow, from the corner up to the
            center [rad], shape ().

    Returns:
        The cutter.

    Raises:
        ValueError: A size is not finite and positive, there is no tooth, or `pitch`
            is no whole turn in as many parts as there are teeth.

    Differentiability: smooth in all sizes, `pitch`, `runout` and `dish_angle`.
    """
    D = _nominal("diameter", diameter, nominal_diameter)
    if teeth < 1:
        raise ValueError(f"Argument `teeth` must be at least 1, but is {teeth}.")
    even = 2 * math.pi / teeth
    pitch_angles, has_even_pitch = even * np.arange(teeth), True
    if pitch is not None:
        steps = _checked_pitch(pitch, teeth)
        pitch_angles = steps.cumsum() - steps
        has_even_pitch = not is_traced(steps) and bool(
            np.all(np.abs(steps - even) < _PITCH_ROUNDING)
        )
    has_runout = _may_differ_from_zero(runout)
    return EndMill(
        diameter=diameter,
        own_corner_radius=None,
        helix_angle=helix_angle,
        pitch_angles=pitch_angles,
        runout=runout,
        runout_angle=runout_angle,
        dish_angle=dish_angle,
        kind="flat",
        flute_count=teeth,
        flute_length=3 * D if flute_length is None else float(flute_length),
        nominal_radius=D / 2,
        nominal_corner_radius=0.0,
        has_helix=_may_differ_from_zero(helix_angle),
        has_dish=_may_differ_from_zero(dish_angle),
        has_runout=has_runout,
        has_even_pitch=has_even_pitch,
        is_plain=has_even_pitch and not has_runout,
    )


def ball_end_mill(
    diameter: RealScalarLike,
    teeth: int,
    helix_angle: RealScalarLike = 0.0,
    *,
    flute_length: float | None = None,
    nominal_diameter: float | None = None,
    pitch: Pitch | None = None,
    runout: RealScalarLike = 0.0,
    runout_angle: RealScalarLike = 0.0,
) -> EndMill:
    """Ball end mill; its tip is the lowest point of the ball.

    Args:
        diameter: Diameter of ball and shank [m], shape ().
        teeth: Number of teeth.
        helix_angle: Helix angle of constant lead, at the full radius [rad], shape ().
        flute_length: Height of the cutting part [m]; three diameters if not given.
        nominal_diameter: As for `flat_end_mill`.
        pitch: As for `flat_end_mill`.
        runout: As for `flat_end_mill`.
        runout_angle: As for `flat_end_mill`.

    Returns:
        The cutter; its corner radius follows the diameter.

    Raises:
        ValueError: As for `flat_end_mill`.

    Differentiability: smooth in all sizes, `pitch` and `runout`.
    """
    mill = flat_end_mill(
        diameter,
        teeth,
        helix_angle,
        flute_length=flute_length,
        nominal_diameter=nominal_diameter,
        pitch=pitch,
        runout=runout,
        runout_angle=runout_angle,
    )
    return dataclasses.replace(
        mill,
        kind="ball",
        nominal_corner_radius=mill.nominal_radius,
        is_plain=False,
    )


def bull_nose(
    diameter: RealScalarLike,
    teeth: int,
    corner_radius: RealScalarLike,
    helix_angle: RealScalarLike = 0.0,
    *,
    flute_length: float | None = None,
    nominal_diameter: float | None = None,
    nominal_corner_radius: float | None = None,
    pitch: Pitch | None = None,
    runout: RealScalarLike = 0.0,
    runout_angle: RealScalarLike = 0.0,
) -> EndMill:
    """Bull-nose end mill: a flat end with a rounded corner.

    Args:
        diameter: Diameter [m], shape ().
        teeth: Number of teeth.
        corner_radius: Radius of the corner [m], shape (); below the cutter's radius.
        helix_angle: Helix angle of constant lead, at the full radius [rad], shape ().
        flute_length: Height of the cutting part [m]; three diameters if not given.
        nominal_diameter: As for `flat_end_mill`.
        nominal_corner_radius: Corner radius that sizes the edge elements [m]; needed
            only where `corner_radius` is a traced value.
        pitch: As for `flat_end_mill`.
        runout: As for `flat_end_mill`.
        runout_angle: As for `flat_end_mill`.

    Returns:
        The cutter.

    Raises:
        ValueError: As for `flat_end_mill`, or the corner does not fit the cutter.

    Differentiability: smooth in all sizes, `pitch` and `runout`.
    """
    mill = flat_end_mill(
        diameter,
        teeth,
        helix_angle,
        flute_length=flute_length,
        nominal_diameter=nominal_diameter,
        pitch=pitch,
        runout=runout,
        runout_angle=runout_angle,
    )
    return dataclasses.replace(
        mill,
        kind="bull",
        own_corner_radius=corner_radius,
        nominal_corner_radius=_nominal(
            "corner_radius", corner_radius, nominal_corner_radius
        ),
        is_plain=False,
    )


def _may_differ_from_zero(size: RealScalarLike) -> bool:
    """True if a size is not zero, or is traced."""
    # Within a trace, a comparison of an array that is known would be traced, too.
    return is_traced(size) or float(size) != 0


def _nominal(name: str, value: RealScalarLike, nominal: float | None) -> float:
    """Static size beside one that may be traced [m]."""
    if nominal is None and is_traced(value):
        raise ValueError(
            f"Argument `nominal_{name}` must be given where `{name}` is traced."
        )
    return float(value if nominal is None else nominal)


def _checked_pitch(pitch: Pitch, count: int) -> _Angles:
    """Angle from every tooth to the next [rad], shape (tooth,), checked."""
    if is_traced(pitch):
        parts = jnp.asarray(pitch)
        if parts.shape != (count,):
            raise ValueError(_wrong_pitch(count, f"has shape {parts.shape}"))
        return parts
    parts = np.asarray(pitch)
    # A JAX array keeps its type; anything else is a list of Python numbers.
    dtype = parts.dtype if np.issubdtype(parts.dtype, np.floating) else float
    parts = parts.astype(dtype)
    slack = max(_TURN_TOLERANCE, 10 * float(np.finfo(dtype).eps))
    if parts.shape != (count,):
        raise ValueError(_wrong_pitch(count, f"has shape {parts.shape}"))
    if not (np.isfinite(parts).all() and (parts > 0).all()):
        raise ValueError(_wrong_pitch(count, f"is {parts.tolist()}"))
    if abs(float(parts.sum()) - 2 * math.pi) > slack:
        raise ValueError(_wrong_pitch(count, f"sums to {float(parts.sum()):.9g}"))
    return parts


def _wrong_pitch(count: int, fault: str) -> str:
    return (
        f"Argument `pitch` must hold {count} positive angles, one per tooth, that sum "
        f"to 2 pi, but {fault}."
    )
