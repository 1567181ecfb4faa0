"""Interface of a cutter."""

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
from ._elements import EdgeElements
from ._rays import Chord


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
        """Return the cutter with its nominal sizes as leaves.

        They are part of a tree's structure otherwise, since they size arrays. A program
        that has been given its sizes then does not depend on their values.
        """

    def delays(
        self, dtype: DTypeLike
    ) -> Float[Array, "before tooth"] | Float[np.ndarray, "before tooth"]:
        """Return how long ago the k-th tooth before each tooth passed [tooth periods].

        A tooth passes an angle when it has turned by what it stands behind the other.

        Differentiability: in the pitch.
        """
        # Of known teeth on the host, which has the double precision of its analyses.
        xp = jnp if is_traced(self.pitch_angles) else np
        pitch, count = xp.asarray(self.pitch_angles, dtype), self.flute_count
        before = (np.arange(count) + np.arange(1, count)[:, None]) % count
        turns = xp.mod((pitch[before] - pitch[None]) / (2 * math.pi), 1)
        # The last one is the tooth itself, a turn before.
        return count * xp.concatenate([turns, xp.ones((1, count), dtype)])

    @property
    @abc.abstractmethod
    def has_corner(self) -> bool:
        """Whether the end is rounded."""

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
        """Return the signed distance to the swept solid, negative inside [m]."""

    @abc.abstractmethod
    def normal(
        self,
        points: Float[Array, "*#place 3"],
        tip: Float[Array, "*#place 3"],
        axis: Float[Array, "*#place 3"],
    ) -> Float[Array, "... 3"]:
        """Return the outward unit gradient of the signed distance."""

    @abc.abstractmethod
    def intersect(
        self,
        family: Literal[0, 1, 2],
        b: Float[Array, "..."],
        c: Float[Array, "..."],
        tip: Float[Array, "*#ray 3"],
        offset: Float[Array, "*#ray"] | None = None,
    ) -> Chord:
        """Return where rays enter and leave the upright cutter, and whether they do."""

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
        """Return where rays enter and leave the cutter in a pose, and whether."""

    @abc.abstractmethod
    def wall_slopes(
        self,
        family: Literal[0, 1],
        end: Float[Array, "..."],
        across: Float[Array, "..."],
        tip: Float[Array, "... 3"],
    ) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """Return how a hit point moves with the tip across the ray and the radius."""

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
        """Return the edge elements of one tooth, from the centre to the shank."""

    @abc.abstractmethod
    def runout_offsets(
        self, lag: Float[Array, "*element"] | float = 0.0
    ) -> Float[Array, "tooth ..."]:
        """Return how far the edge of each tooth stands out by the run-out [m]."""

    def edge_offsets(self, height: Float[Array, "*place"]) -> Float[Array, "tooth ..."]:
        """Return how far teeth stand out by the run-out at heights on the edge [m].

        Args:
            height: Above the tip along the axis [m], shape (*place,).

        Returns:
            As `runout_offsets`, shape (tooth, *place), in the type of the heights.
        """
        if not self.has_helix:
            offsets = self.runout_offsets().astype(height.dtype)
            return offsets.reshape(-1, *(1,) * height.ndim)
        lead = jnp.tan(jnp.asarray(self.helix_angle, height.dtype))
        lag = height * lead / (self.diameter / 2)
        return self.runout_offsets(lag).astype(height.dtype)
