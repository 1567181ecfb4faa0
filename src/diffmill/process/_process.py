"""The cutting process as an object: what is cut, with what, and how finely."""

import abc
import math
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._types import IntScalar, RealScalarLike
from ..cutter import AbstractCutter
from ..cutting import AbstractForceLaw
from ..numerics import Rematerialised
from ..workpiece import Discs, Pose, RemovalWindow, Stock
from ._engagement.edge_samples import EdgeSamples, Engagement
from ._engagement.teeth_before import TeethBefore
from ._path import PosesWithin, poses_within, substep_ends, substep_middles
from ._removal_history import RemovalHistory
from ._state import ProcessState, RemovedVolume
from ._stock_derivatives import AbstractAdjoint, ThroughRays


class Substeps(NamedTuple):
    """Some sub-steps of a tooth period.

    Attributes:
        first: Index of the first one, shape ().
        length: How many.
    """

    first: Int[Array, ""]
    length: int


class AbstractEngagement(eqx.Module):
    """Engagement model: places of the teeth in the material, and their chips.

    Attributes:
        angles: Samples of the immersion angle per revolution.
        substeps: Sub-steps per tooth period.
        updates_per_period: Engagement updates of a robot's tooth period, each for as
            many sub-steps; their poses are predicted from where the tool is then.
        discs: Discs of the cutter, or the height of an edge element and the band.
        window: Window of rays of a removal.
        removal_lag: Travelled distance by which removal lags [m].
        is_upright: Whether the tool is upright all the time.
        samples_whole_period: True if an update takes the occupancy from the travel of
            the whole period, to its last predicted pose, instead of each sub-step's.
        removal_waits: True if passes wait for their removal.
    """

    removal_waits: ClassVar[bool] = True

    angles: eqx.AbstractVar[int]
    substeps: eqx.AbstractVar[int]
    updates_per_period: eqx.AbstractVar[int]
    discs: eqx.AbstractVar[Discs]
    window: eqx.AbstractVar[RemovalWindow]
    removal_lag: eqx.AbstractVar[float]
    is_upright: eqx.AbstractVar[bool]
    samples_whole_period: eqx.AbstractVar[bool]

    @abc.abstractmethod
    def remove(
        self, process: "Process", state: ProcessState, index: Int[Array, ""], pose: Pose
    ) -> tuple[ProcessState, RemovedVolume]:
        """Take in the pose at the end of a period, and remove what is due.

        Args:
            process: The process that is engaged so.
            state: State after the period that ends at the pose.
            index: Index k of the pose, shape ().
            pose: Pose k, shape (3,).

        Returns:
            The state, and what was removed.
        """

    @abc.abstractmethod
    def engage(
        self,
        process: "Process",
        state: ProcessState,
        index: Int[Array, ""],
        predicted: Pose,
        part: Substeps | None = None,
    ) -> Engagement:
        """Engagement of the teeth of a period, after its removal.

        Args:
            process: The process.
            state: State after the removal of this period.
            index: Index k of the period, from pose k - 1 to pose k, shape ().
            predicted: Poses expected in the middle of the sub-steps, shape
                (substep, 3).
            part: The sub-steps if these are not all: predicted and recent poses are
                then theirs.

        Returns:
            The engagement; of its samples only occupancies and shares of the chip may
            change with the poses, see `EdgeSamples.follows_poses`.
        """

    @abc.abstractmethod
    def wrench(
        self,
        process: "Process",
        samples: EdgeSamples,
        pose: Pose,
        earlier: Pose,
        decimated: Pose,
    ) -> Float[Array, "angle 7"]:
        """Return the loads of the tool at the angles of one sub-step.

        Args:
            process: The process.
            samples: The edges in this sub-step, shape (angle, leading, element).
            pose: Pose in the middle of the sub-step, shape (3,).
            earlier: Poses when the teeth before passed, as `Process.earlier` returns
                them, shape (before, 3), of uneven teeth (before, tooth, 3).
            decimated: Older poses, shape (circle, 3).

        Returns:
            Force on the tool in `work` [N], then its moment about the tip by levers
            along the axis [N m], then the torque that the spindle needs [N m], shape
            (angle, 7); their mean is that of the sub-step.

        Differentiability: kinks where the deciding earlier pose changes and where a
        chip ends; the edge force changes smoothly there.
        """

    @abc.abstractmethod
    def chip(
        self,
        process: "Process",
        samples: EdgeSamples,
        pose: Pose,
        earlier: Pose,
        decimated: Pose,
    ) -> Float[Array, "angle leading element"]:
        """Return the unclipped chip thickness of one sub-step [m]; see `wrench`."""

    @abc.abstractmethod
    def element_heights(
        self, cutter: AbstractCutter, dtype: jnp.dtype
    ) -> Float[Array, " element"]:
        """Height of the middle of every element above the tip [m]."""


class Process(eqx.Module):
    """The cutting process: stock, cutter, force laws and their discretisation.

    Attributes:
        stock: The raw workpiece.
        cutter: The milling cutter.
        side_law: Force law of the teeth.
        bottom_law: Force law of the bottom edges.
        spindle_speed: [rad/s], shape ().
        engagement: Where the teeth are in the material, and what chips they cut.
        derivative: How to differentiate through the removal.
    """

    stock: Stock
    cutter: AbstractCutter
    side_law: AbstractForceLaw
    bottom_law: AbstractForceLaw
    spindle_speed: RealScalarLike
    engagement: AbstractEngagement
    derivative: AbstractAdjoint

    def __init__(
        self,
        stock: Stock,
        cutter: AbstractCutter,
        law: AbstractForceLaw,
        spindle_speed: RealScalarLike,
        engagement: AbstractEngagement,
        *,
        bottom_law: AbstractForceLaw | None = None,
        derivative: AbstractAdjoint | None = None,
    ):
        """Put a process together.

        Args:
            stock: The raw workpiece.
            cutter: The cutter.
            law: The force law.
            spindle_speed: [rad/s], shape ().
            engagement: As `choose_engagement` returns it.
            bottom_law: The law of the bottom edges; derived from `law` if not given.
            derivative: How to differentiate through the removal; `ThroughRays()` if
                not given.

        Raises:
            ValueError: A law has coefficients for more or fewer teeth than the cutter.
        """
        self.stock, self.cutter, self.engagement = stock, cutter, engagement
        self.spindle_speed, self.side_law = spindle_speed, law
        self.bottom_law = law.for_bottom() if bottom_law is None else bottom_law
        self.derivative = ThroughRays() if derivative is None else derivative
        for name, each in (("law", law), ("bottom_law", self.bottom_law)):
            count = each.tooth_count
            if count is not None and count != cutter.flute_count:
                raise ValueError(
                    f"Argument `{name}` must have one value of a coefficient, or one "
                    f"for each of the {cutter.flute_count} teeth, but has {count}."
                )

    @property
    def tooth_period(self) -> Float[Array, ""]:
        """Time between two teeth T = 2 pi / (omega N_z) [s]."""
        speed = jnp.asarray(self.spindle_speed, self.stock.origin.dtype)
        return 2 * math.pi / (speed * self.cutter.flute_count)

    @property
    def repeats_after(self) -> int:
        """Tooth periods after which the cut repeats itself: 1, or a whole turn.

        Teeth differ by their pitch, by run-out and by their force coefficients.

        Differentiability: none, for values that are known.
        """
        cutter = self.cutter
        differ = not cutter.has_even_pitch or bool(np.any(np.asarray(cutter.runout)))
        for law in (self.side_law, self.bottom_law):
            if law.tooth_count is not None:
                leaves = [np.asarray(x) for x in jax.tree.leaves(law)]
                differ |= any(x.ndim > 0 and np.ptp(x) > 0 for x in leaves)
        return cutter.flute_count if differ else 1

    @property
    def removes_together(self) -> bool:
        """True if passes that follow each other may be removed in one piece.

        Of teeth with run-out they would leave nothing of what the shorter ones spare.
        """
        return self.engagement.removal_waits and not self.cutter.has_runout

    @property
    def removal(self) -> RemovalHistory:
        """Lag of the removal behind the tool."""
        engagement = self.engagement
        return RemovalHistory(
            self.cutter,
            engagement.window,
            engagement.removal_lag,
            engagement.substeps,
            self.stock.spacing,
            self.derivative,
        )

    def begin(self, pose: Pose, pose_count: int) -> ProcessState:
        """Return the state at pose 0.

        What the tool stands in is removed in the first period.

        Args:
            pose: Pose 0, shape (3,).
            pose_count: Number of poses of the whole run.
        """
        return self.removal.begin(self.stock, pose, pose_count)

    def remove(
        self, state: ProcessState, index: Int[Array, ""], pose: Pose
    ) -> tuple[ProcessState, RemovedVolume]:
        """Take in a pose, and remove what is due, as the engagement says.

        Args:
            state: State after the period that ends at the pose.
            index: Index k of the pose, shape ().
            pose: Pose k, shape (3,).

        Returns:
            The state, and what was removed.
        """
        return self.engagement.remove(self, state, index, pose)

    def engage(
        self,
        state: ProcessState,
        index: Int[Array, ""],
        predicted: Pose,
        part: Substeps | None = None,
    ) -> Engagement:
        """Engagement of the teeth of a period, after its removal.

        In reverse mode it is computed again from what it has read, which is kept.
        """
        look = lambda: self.engagement.engage(self, state, index, predicted, part)
        return Rematerialised.of(look)()

    def teeth_before(self, dtype: jnp.dtype) -> TeethBefore | None:
        """Weights of the poses at which the teeth before passed.

        None for evenly spaced teeth: those of the same sub-step, whole periods ago.
        """
        if self.cutter.has_even_pitch:
            return None
        return TeethBefore.of(self.cutter, self.engagement.substeps, dtype)

    def earlier(self, recent: Pose, now: Pose) -> Pose:
        """Poses of the tool when the k-th tooth before was at the same immersion angle.

        Args:
            recent: Poses in the middle of the sub-steps of the periods before, newest
                first, shape (period, substep, 3).
            now: Those of this period, shape (substep, 3).

        Returns:
            The poses in all sub-steps for the k-th tooth before, shape (substep,
            before, 3); where teeth are uneven, for each tooth, shape (substep, before,
            tooth, 3).
        """
        teeth = self.teeth_before(now.tip.dtype)
        if teeth is None:
            return jax.tree.map(lambda x: jnp.moveaxis(x, 0, 1), recent)
        return teeth.poses(recent, now)

    def poses_within(
        self, path: Pose, row_count: IntScalar | None = None
    ) -> PosesWithin:
        """Return the poses within the periods between given instants.

        Args:
            path: Poses at the tooth instants, shape (step, 3).
            row_count: How many of them count; all if None.
        """
        return poses_within(self.engagement.substeps, path, row_count)

    def substep_middles(self, dtype: jnp.dtype) -> Float[Array, " substep"]:
        """Return the middle of each sub-step as a share of the tooth period."""
        return substep_middles(self.engagement.substeps, dtype)

    def substep_ends(self, dtype: jnp.dtype) -> Float[Array, " substep"]:
        """Return the end of each sub-step as a share of the tooth period."""
        return substep_ends(self.engagement.substeps, dtype)


def rotation_angles(
    process: Process, dtype: jnp.dtype, part: Substeps | None = None
) -> Float[Array, "substep angle"]:
    """Return the angles by which the cutter turns from the start of a period [rad]."""
    engagement, teeth = process.engagement, process.cutter.flute_count
    count = engagement.angles // (engagement.substeps * teeth)
    total = engagement.substeps * count
    share = (jnp.arange(total, dtype=dtype) + 0.5) / total
    turn = (2 * math.pi / teeth * share).reshape(engagement.substeps, count)
    if part is None:
        return turn
    return jax.lax.dynamic_slice_in_dim(turn, part.first, part.length)
