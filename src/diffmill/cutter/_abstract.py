"""Interface of a cutter, and the elements of its cutting edge."""

import abc
import math
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from .._arrays import is_traced
from .._types import RealScalarLike
from ._rays import Chord


class EdgeElements(eqx.Module):
    """Edge elements from the center of the end to the shank, by their middles.

    The outward normal of an element is sin kappa e - cos kappa a, e the radial
    direction at its immersion angle and a the axis.

    Attributes:
        height: Above the tip [m], shape (element,).
        radius: From the axis [m], shape (element,).
        sin_kappa: Shape (element,).
        cos_kappa: Shape (element,).
        width: Length along the profile [m], shape (element,).
        lag: Angle by which the helix holds the element back [rad], shape (element,).
        sagitta: Distance of an element's mean inward of its middle [m], shape
            (element,).
        bottom_count: Number of elements on the flat end, which come first.
    """

    height: Float[Array, " element"]
    radius: Float[Array, " element"]
    sin_kappa: Float[Array, " element"]
    cos_kappa: Float[Array, " element"]
    width: Float[Array, " element"]
    lag: Float[Array, " element"]
    sagitta: Float[Array, " element"]
    bottom_count: int = eqx.field(static=True)


class AbstractCutter(eqx.Module):
    """Interface of a cutter for removal, engagement and forces.

    Every member is elementwise in the coordinates of points and rays, which broadcast.
    """

    diameter: eqx.AbstractVar[RealScalarLike]
    helix_angle: eqx.AbstractVar[RealScalarLike]
    pitch_angles: eqx.AbstractVar[Float[Array, " tooth"] | Float[np.ndarray, " tooth"]]
    runout: eqx.AbstractVar[RealScalarLike]
    runout_angle: eqx.AbstractVar[RealScalarLike]
    dish_angle: eqx.AbstractVar[RealScalarLike]
    flute_count: eqx.AbstractVar[int]
    flute_length: eqx.AbstractVar[float]
    nominal_radius: eqx.AbstractVar[float]
    nominal_corner_radius: eqx.AbstractVar[float]
    has_helix: eqx.AbstractVar[bool]
    has_dish: eqx.AbstractVar[bool]
    has_runout: eqx.AbstractVar[bool]
    has_even_pitch: eqx.AbstractVar[bool]
    is_plain: eqx.AbstractVar[bool]

    @abc.abstractmethod
    def with_sizes_as_leaves(self) -> "AbstractCutter":
        """Cutter with its nominal sizes as leaves.

        They are part of a tree's structure otherwise, since they size arrays. A program
        that has been given its sizes then does not depend on their values.
        """

    def delays(
        self, dtype: DTypeLike
    ) -> Float[Array, "before tooth"] | Float[np.ndarray, "before tooth"]:
        """Delay of each tooth behind the k-th tooth before it [tooth periods].

        A tooth passes an angle when it has turned by the angle between the two teeth.

        Differentiability: in the pitch.
        """
        # Known teeth on the host, in the double precision of its analyses.
        xp = jnp if is_traced(self.pitch_angles) else np
        pitch, count = xp.asarray(self.pitch_angles, dtype), self.flute_count
        before = (np.arange(count) + np.arange(1, count)[:, None]) % count
        turns = xp.mod((pitch[before] - pitch[None]) / (2 * math.pi), 1)
        # The last one is the tooth itself, a turn before.
        return count * xp.concatenate([turns, xp.ones((1, count), dtype)])

    @property
    @abc.abstractmethod
    def has_corner(self) -> bool:
        """True if the end is rounded."""

    @property
    @abc.abstractmethod
    def corner_radius(self) -> RealScalarLike:
        """Corner radius [m]: 0 for a flat end, the radius for a ball."""

    @abc.abstractmethod
    def level(
        self,
        points: Float[Array, "*#place 3"],
        tip: Float[Array, "*#place 3"],
        axis: Float[Array, "*#place 3"],
        offset: Float[Array, "*#place"] | None = None,
    ) -> Float[Array, "..."]:
        """Signed distance to the swept solid, negative inside [m]."""

    @abc.abstractmethod
    def normal(
        self,
        points: Float[Array, "*#place 3"],
        tip: Float[Array, "*#place 3"],
        axis: Float[Array, "*#place 3"],
    ) -> Float[Array, "... 3"]:
        """Outward normal: the unit gradient of the signed distance."""

    @abc.abstractmethod
    def intersect(
        self,
        family: Literal[0, 1, 2],
        b: Float[Array, "..."],
        c: Float[Array, "..."],
        tip: Float[Array, "*#ray 3"],
        offset: Float[Array, "*#ray"] | None = None,
    ) -> Chord:
        """Chords of rays in the upright cutter."""

    @abc.abstractmethod
    def intersect_pose(
        self,
        family: Literal[0, 1, 2],
        b: Float[Array, "*#ray"],
        c: Float[Array, "*#ray"],
        tip: Float[Array, "*#ray 3"],
        axis: Float[Array, "*#ray 3"],
        offset: Float[Array, "*#ray"] | None = None,
    ) -> Chord:
        """Chords of rays in the cutter in a pose."""

    @abc.abstractmethod
    def wall_slopes(
        self,
        family: Literal[0, 1],
        end: Float[Array, "..."],
        across: Float[Array, "..."],
        tip: Float[Array, "... 3"],
    ) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """Slopes of a hit point by the tip across the ray, and by the radius."""

    @abc.abstractmethod
    def elements(
        self,
        bottom: int,
        corner: int,
        side: int,
        height: RealScalarLike,
        dtype: DTypeLike,
        corner_limit: RealScalarLike = math.pi / 2,
    ) -> EdgeElements:
        """Edge elements of one tooth, from the centre to the shank."""

    @abc.abstractmethod
    def runout_offsets(
        self, lag: Float[Array, "*element"] | float = 0.0
    ) -> Float[Array, "tooth ..."]:
        """Radial offset of the edge of each tooth by the run-out [m]."""

    def edge_offsets(self, height: Float[Array, "*place"]) -> Float[Array, "tooth ..."]:
        """Radial offset of each tooth by the run-out at heights on the edge [m].

        Args:
            height: Above the tip along the axis [m], shape (*place,).

        Returns:
            `runout_offsets` at these heights, shape (tooth, *place), in their type.
        """
        if not self.has_helix:
            offsets = self.runout_offsets().astype(height.dtype)
            return offsets.reshape(-1, *(1,) * height.ndim)
        lead = jnp.tan(jnp.asarray(self.helix_angle, height.dtype))
        lag = height * lead / (self.diameter / 2)
        return self.runout_offsets(lag).astype(height.dtype)
