"""Discretisation of the cutting process."""

import dataclasses
import math
from typing import Any

import numpy as np
from jaxtyping import Float

from .._arrays import is_traced
from ..cutter import AbstractCutter
from ..settings.base import builds
from ..settings.simulation import ChipSettings, NearFarSettings, PointCloudSettings
from ..workpiece import Discs, RemovalWindow, Stock
from ._engagement.bottom_edge import BottomEdges
from ._engagement.dexel_cloud import DexelCloud
from ._engagement.edge_elements import EdgeDiscretisation, EdgeElementsInSpace
from ._engagement.upright import UprightFlat
from ._process import AbstractEngagement

# A robot that bends tilts its tool by less than this [rad].
_TILT = 0.02
# Samples per revolution, unless asked for: of a flat cutter that stands upright, and of
# others, whose samples have to be looked up one by one.
_ANGLES, _ANGLES_IN_SPACE = 180, 96
# Annuli of the bottom edge of an upright flat cutter.
_ANNULI = 4
# Elements of a corner are shorter than those of a side by this factor: across them
# the direction of the force changes.
_CORNER = 0.5
# Helix angle that is assumed where it is traced: few mills have a steeper one [rad].
_STEEP = math.pi / 4
# Elements at least of a corner, per square root of its radius over the height of an
# element: however shallow the cut, its arc is long.
_LEAST_CORNER = 5.0


def default_element_height(
    chip: str | ChipSettings, spacing: float, cutter: AbstractCutter
) -> float:
    """Return the height of a disc if none is asked for.

    Over one disc a helical edge lags by no more than a default sample, or entry and
    exit would come in steps that the instantaneous force shows.

    Args:
        chip: The chip model, by its name or its settings.
        spacing: Spacing of the rays [m].
        cutter: The cutter; a helix angle that is traced is taken to be 45 degrees, so
            that discs are no higher than those of most helices.

    Returns:
        The height [m].
    """
    height = ChipSettings.of(chip).disc_height * spacing
    if not cutter.has_helix:
        return height
    turn = 2 * math.pi / _ANGLES
    angle = cutter.helix_angle
    slope = abs(math.tan(_STEEP if is_traced(angle) else float(angle)))
    return min(height, cutter.nominal_radius * turn / slope)


def choose_engagement(
    stock: Stock,
    cutter: AbstractCutter,
    *,
    axial_depth: float,
    angles: int | None = None,
    substeps: int = 8,
    element_height: float | None = None,
    axes: Float[np.ndarray, "step 3"] | None = None,
    is_upright: bool = True,
    plunges: bool = False,
    has_bottom: bool = True,
    chip: str | ChipSettings = "near_far",
    updates_per_period: int = 1,
) -> AbstractEngagement:
    """Choose the sizes of a process.

    Args:
        stock: The workpiece.
        cutter: The cutter.
        axial_depth: Deepest immersion below the top of the stock [m].
        angles: Samples per revolution; raised to a multiple of teeth x substeps.
            If not given at least 180 of a plain flat cutter that is upright, and
            96 of others.
        substeps: Sub-steps per tooth period.
        element_height: Height of a disc [m]; if not given 3.5 ray spacings, one for
            a point cloud, less for a steep helix: see `default_element_height`.
        axes: Tool axes that will occur, shape (step, 3); used if not upright.
        is_upright: Whether the tool is upright all the time.
        plunges: Whether the path descends in material, so that the bottom cuts.
        has_bottom: Whether bottom edges cut where the tool descends.
        chip: The chip model, by its name or its settings.
        updates_per_period: Engagement updates of a robot's tooth period.

    Returns:
        `UprightFlat`, `EdgeElementsInSpace` or `DexelCloud`.

    Raises:
        ValueError: A point cloud is asked for, but not of a plain flat cutter that
            is upright; or updates do not divide the sub-steps.
    """
    model = ChipSettings.of(chip)
    is_simple = is_upright and cutter.is_plain
    if model.needs_plain_cutter and not is_simple:
        raise ValueError(
            'Argument `chip` must be "near_far" unless the cutter is flat, has even '
            f'teeth without run-out and stands along +z, but is "{model.name}".'
        )
    unit = cutter.flute_count * substeps
    if angles is None:
        angles = _ANGLES if is_simple else _ANGLES_IN_SPACE
    angles = math.ceil(angles / unit) * unit
    if element_height is None:
        element_height = default_element_height(model, stock.spacing, cutter)
    dz = float(element_height)
    radius = cutter.nominal_radius
    # Samples on the rim farther apart than the rays must not step over a wall.
    band = 0.5 * max(stock.spacing, radius * 2 * math.pi / angles)
    # The sagitta of a fresh surface at this distance is beyond the band.
    lag = 1.25 * math.sqrt(2 * radius * band)
    reach = 2 * stock.spacing
    sizes: dict[str, Any] = {
        "angles": angles,
        "substeps": substeps,
        "removal_lag": lag,
        "updates_per_period": updates_per_period,
    }
    if is_simple:
        # One more disc than the depth holds: its share rises before it is immersed.
        depth = min(axial_depth, cutter.flute_length)
        sizes["discs"] = Discs(max(1, math.ceil(depth / dz + 0.5)), dz, band)
        sizes["window"] = RemovalWindow.upright(stock, cutter, axial_depth, reach)
        bottom = BottomEdges(_ANNULI) if plunges and has_bottom else None
        engagement = model.build(sizes, bottom)
        assert isinstance(engagement, AbstractEngagement)
        return engagement
    if is_upright:
        window = RemovalWindow.upright(stock, cutter, axial_depth, reach)
        profile = _profile(cutter, axial_depth, dz, plunges)
    else:
        axes = _tilted(axes)
        window = RemovalWindow.tilted(stock, cutter, axes, axial_depth, reach)
        # The end of a tool that leans cuts with all teeth wherever it goes ahead.
        keeps_all = plunges or has_bottom
        profile = _tilted_profile(
            cutter, axes, axial_depth, window.length, dz, keeps_all
        )
    if not has_bottom:
        profile = dataclasses.replace(profile, bottom=0)
    discs = Discs(1, dz, band)
    return EdgeElementsInSpace(
        **sizes, discs=discs, window=window, profile=profile, is_upright=is_upright
    )


@builds(NearFarSettings)
def _near_far(
    settings: NearFarSettings, sizes: dict[str, Any], bottom: BottomEdges | None
) -> UprightFlat:
    return UprightFlat(**sizes, bottom=bottom)


@builds(PointCloudSettings)
def _point_cloud(
    settings: PointCloudSettings, sizes: dict[str, Any], bottom: BottomEdges | None
) -> DexelCloud:
    return DexelCloud(**sizes)


def _tilted(
    axes: Float[np.ndarray, "step 3"] | None,
) -> Float[np.ndarray, "axis 3"] | None:
    """Return the axes and, around each, those of a tool on a bent robot."""
    if axes is None:
        return None
    axes = np.unique(np.round(axes, 3), axis=0)
    nudges = _TILT * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    near = (axes[:, None] + nudges[None]).reshape(-1, 3)
    return near / np.linalg.norm(near, axis=1, keepdims=True)


def _tilted_profile(
    cutter: AbstractCutter,
    axes: Float[np.ndarray, "axis 3"] | None,
    axial_depth: float,
    length: float,
    dz: float,
    keeps_all: bool,
) -> EdgeDiscretisation:
    """Choose the edge elements of a tool that leans."""
    least = 0.0 if axes is None else float(axes[:, 2].min())
    if least > 0:
        # The rim's lowest point sinks by R sin(tilt) below the middle of its disc.
        sink = cutter.nominal_radius * math.sqrt(1 - least**2)
        length = min(length, (axial_depth + sink) / least)
    return _profile(cutter, length, dz, keeps_all)


def _profile(
    cutter: AbstractCutter, length: float, dz: float, keeps_all: bool
) -> EdgeDiscretisation:
    """Choose the edge elements that reach a length above the tip."""
    R, rc = cutter.nominal_radius, cutter.nominal_corner_radius
    highest = min(length + dz / 2, cutter.flute_length)
    flat = R - rc
    limit = math.acos(max(0.0, 1 - highest / rc)) if rc > 0 else 0.0
    side = max(0, math.ceil((highest - rc) / dz))
    corner = max(rc * limit / (_CORNER * dz), _LEAST_CORNER * math.sqrt(rc / dz))
    return EdgeDiscretisation(
        bottom=math.ceil(flat / (2 * dz)) if flat > 0 else 0,
        corner=math.ceil(corner),
        side=side,
        # Where the flutes end, so do the elements.
        side_height=(highest - rc) / side if side > 0 else dz,
        corner_limit=limit,
        # Near the axis of a round end every tooth rubs all the way round.
        keeps_all=keeps_all or rc > 0,
    )
