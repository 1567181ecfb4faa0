"""Making end mills from what a user knows of them."""

import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arrays import is_traced
from .._types import RealScalarLike
from ._end_mill import EndMill, Kind

# How far the angles between the teeth may miss a whole turn [rad].
_TURN = 1e-6
# Angles between the teeth that differ by less are even [rad].
_EVEN = 1e-12

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
    """Return a flat end mill.

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
    return _end_mill(
        "flat",
        diameter,
        teeth,
        helix_angle,
        flute_length=flute_length,
        nominal_diameter=nominal_diameter,
        pitch=pitch,
        runout=runout,
        runout_angle=runout_angle,
        dish_angle=dish_angle,
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
    """Return a ball end mill; its tip is the lowest point of the ball.

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
    return _end_mill(
        "ball",
        diameter,
        teeth,
        helix_angle,
        flute_length=flute_length,
        nominal_diameter=nominal_diameter,
        pitch=pitch,
        runout=runout,
        runout_angle=runout_angle,
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
    """Return a bull-nose end mill: a flat end with a rounded corner.

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
    return _end_mill(
        "bull",
        diameter,
        teeth,
        helix_angle,
        corner_radius=corner_radius,
        flute_length=flute_length,
        nominal_diameter=nominal_diameter,
        nominal_corner_radius=nominal_corner_radius,
        pitch=pitch,
        runout=runout,
        runout_angle=runout_angle,
    )


def _end_mill(
    kind: Kind,
    diameter: RealScalarLike,
    teeth: int,
    helix_angle: RealScalarLike,
    *,
    corner_radius: RealScalarLike | None = None,
    flute_length: float | None = None,
    nominal_diameter: float | None = None,
    nominal_corner_radius: float | None = None,
    pitch: Pitch | None = None,
    runout: RealScalarLike = 0.0,
    runout_angle: RealScalarLike = 0.0,
    dish_angle: RealScalarLike = 0.0,
) -> EndMill:
    """Return an end mill with its derived static sizes."""
    D = _nominal("diameter", diameter, nominal_diameter)
    nominal_corner = {"flat": 0.0, "ball": D / 2}.get(kind)
    if corner_radius is not None:
        nominal_corner = _nominal("corner_radius", corner_radius, nominal_corner_radius)
    assert nominal_corner is not None
    if teeth < 1:
        raise ValueError(f"Argument `teeth` must be at least 1, but is {teeth}.")
    steps = None if pitch is None else _pitch(pitch, teeth)
    has_even_pitch = _is_even(steps, teeth)
    has_runout = _is_set(runout)
    return EndMill(
        diameter=diameter,
        own_corner_radius=corner_radius,
        helix_angle=helix_angle,
        pitch_angles=_pitch_angles(steps, teeth),
        runout=runout,
        runout_angle=runout_angle,
        dish_angle=dish_angle,
        kind=kind,
        flute_count=teeth,
        flute_length=3 * D if flute_length is None else float(flute_length),
        nominal_radius=D / 2,
        nominal_corner_radius=nominal_corner,
        has_helix=_is_set(helix_angle),
        has_dish=_is_set(dish_angle),
        has_runout=has_runout,
        has_even_pitch=has_even_pitch,
        is_plain=kind == "flat" and has_even_pitch and not has_runout,
    )


def _is_set(value: RealScalarLike) -> bool:
    """Return whether a size is not zero, or may not be."""
    # Within a trace, a comparison of an array that is known would be traced, too.
    return is_traced(value) or float(value) != 0


def _nominal(name: str, value: RealScalarLike, nominal: float | None) -> float:
    """Return the static size beside a differentiable one."""
    if nominal is None and is_traced(value):
        raise ValueError(
            f"Argument `nominal_{name}` must be given where `{name}` is traced."
        )
    return float(value if nominal is None else nominal)


def _pitch_angles(steps: _Angles | None, count: int) -> _Angles:
    """Return the angle of every tooth from tooth 0 [rad]."""
    if steps is None:
        return 2 * math.pi / count * np.arange(count)
    return steps.cumsum() - steps


def _is_even(steps: _Angles | None, count: int) -> bool:
    """Return whether all teeth are known to stand equally far apart."""
    if steps is None:
        return True
    if is_traced(steps):
        return False
    return bool(np.all(np.abs(steps - 2 * math.pi / count) < _EVEN))


def _pitch(pitch: Pitch, count: int) -> _Angles:
    """Return the angle from every tooth to the next [rad], checked."""
    if is_traced(pitch):
        parts = jnp.asarray(pitch)
        if parts.shape != (count,):
            raise ValueError(_wrong_pitch(count, f"has shape {parts.shape}"))
        return parts
    given = np.asarray(pitch)
    # A JAX array keeps its type; anything else is a list of Python numbers.
    dtype = given.dtype if np.issubdtype(given.dtype, np.floating) else float
    parts = given.astype(dtype)
    slack = max(_TURN, 10 * float(np.finfo(dtype).eps))
    if parts.shape != (count,):
        raise ValueError(_wrong_pitch(count, f"has shape {parts.shape}"))
    if not (np.isfinite(parts).all() and (parts > 0).all()):
        raise ValueError(_wrong_pitch(count, f"is {parts.tolist()}"))
    if abs(float(parts.sum()) - 2 * math.pi) > slack:
        raise ValueError(_wrong_pitch(count, f"sums to {float(parts.sum()):.9g}"))
    return parts


def _wrong_pitch(count: int, found: str) -> str:
    return (
        f"Argument `pitch` must hold {count} positive angles, one per tooth, that sum "
        f"to 2 pi, but {found}."
    )
