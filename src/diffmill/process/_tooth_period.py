"""One tooth period of the cutting process: remove, look, and cut.

A period has two halves, because a robot moves within it:

1. `advance_process` takes the pose at the start of the period into the history, removes
   from the stock the poses that the tool has left behind, and samples where along the
   tooth paths of this period there is material.
   Under the chip model "point_cloud" the pose is removed at once, and what the end of
   the period takes from the stock says where the teeth cut.
2. `substep_wrench` gives force and moment of one sub-step for an actual pose, from the
   chip between it and the poses one or more tooth periods earlier.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..cutter import AbstractCutter
from ..cutting import AbstractForceLaw
from ..workpiece import Pose, repeated
from ._discretisation import ProcessPlan, Substeps
from ._engagement.bottom_edge import BottomEngagement, bottom_engagement, bottom_force
from ._engagement.dexel_cloud import cloud_engagement, remove_at_once
from ._engagement.edge_elements import (
    chip_in_space,
    engagement_in_space,
    profile_elements,
    wrench_in_space,
)
from ._engagement.edge_samples import EdgeSamples
from ._engagement.upright import upright_chip, upright_engagement, upright_wrench
from ._live_rows import when_live
from ._removal_history import (
    ProcessState,
    Removed,
    advance_removal,
    thinned_poses,
)
from ._stock_derivatives import AbstractAdjoint


class Engagement(eqx.Module):
    """Engagement of the teeth in one tooth period.

    Attributes:
        samples: The side edges, shape (substep, angle, kept, element).
        thinned: Some older poses, shape (circle, 3).
        bottom: The bottom edges of an upright flat cutter, if its path descends.
    """

    samples: EdgeSamples
    thinned: Pose
    bottom: BottomEngagement | None = None


def advance_process(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    state: ProcessState,
    index: Int[Array, ""],
    pose: Pose,
    predicted: Pose,
    adjoint: AbstractAdjoint,
    is_live: Bool[Array, ""] | None = None,
) -> tuple[ProcessState, Engagement, Removed]:
    """Take in the pose at the start of a period, remove, and look for material.

    Args:
        plan: Sizes of the process.
        cutter: The cutter.
        state: State after the period before.
        index: Index k of the period, which runs from pose k - 1 to pose k, shape ().
        pose: Pose k - 1 at the start, shape (3,).
        predicted: Poses expected in the middle of the sub-steps, shape (substep, 3).
        adjoint: How the run is differentiated.
        is_live: Whether the period counts, shape (); behind the last row of a padded
            path nothing is looked up. None for a path that is not padded.

    Returns:
        The new state, the engagement of this period, and what was removed.
    """
    if plan.chip == "point_cloud":
        state, removed = remove_at_once(plan, cutter, state, index - 1, pose, adjoint)
        angle, weight = cloud_engagement(plan, cutter, state, pose, predicted)
        tooth = jnp.arange(cutter.flute_count, dtype=jnp.int32) - (index - 1)
        tooth = jnp.mod(tooth, cutter.flute_count)[None, None, :, None]
        tooth = jnp.broadcast_to(tooth, angle.shape)
        # The cloud judges at the rim alone.
        samples = EdgeSamples(angle, tooth, weight, jnp.ones_like(weight))
        return state, Engagement(samples, repeated(pose, (0,))), removed
    state, removed = advance_removal(plan, cutter, state, index - 1, pose, adjoint)
    engage = lambda: compute_engagement(plan, cutter, state, index, predicted, adjoint)
    return state, when_live(is_live, engage), removed


def compute_engagement(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    state: ProcessState,
    index: Int[Array, ""],
    predicted: Pose,
    adjoint: AbstractAdjoint,
    part: Substeps | None = None,
) -> Engagement:
    """Return where the teeth of a period meet material, after its removal.

    For the chip model "near_far"; arguments as for `advance_process`, and `part` for
    the sub-steps if these are not all: predicted and recent poses are then theirs.
    """
    if plan.profile is None:
        found = upright_engagement(
            plan, cutter, state, index, predicted.tip, adjoint, part
        )
    else:
        found = engagement_in_space(
            plan, cutter, state, index, predicted, adjoint, part
        )
    bottom = None
    if plan.bottom > 0:
        bottom = bottom_engagement(
            plan,
            cutter,
            state.stock,
            index,
            predicted.tip,
            state.recent.tip[0],
            adjoint.tied_to(state.track),
            part,
        )
    return Engagement(found, thinned_poses(plan, state), bottom)


def substep_wrench(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    law: AbstractForceLaw,
    bottom_law: AbstractForceLaw | None,
    pose: Pose,
    earlier: Pose,
    thinned: Pose,
    samples: EdgeSamples,
    bottom: BottomEngagement | None,
) -> Float[Array, "angle 6"]:
    """Return force and moment on the tool at the angles of one sub-step.

    Args:
        plan: Sizes of the process.
        cutter: The cutter.
        law: The force law.
        bottom_law: The law of the bottom edge; derived from `law` if None.
        pose: Pose in the middle of the sub-step, shape (3,).
        earlier: Poses at the same sub-step of earlier periods, newest first, shape
            (tooth, 3).
        thinned: Older poses, shape (circle, 3).
        samples: The side edges in this sub-step, shape (angle, kept, element).
        bottom: The engagement of the bottom edges in this sub-step, if there is one.

    Returns:
        Force on the tool in `work` [N], then its moment about the tip by levers along
        the axis [N m], shape (angle, 6); their mean is that of the sub-step.

    Differentiability: kinks where the deciding earlier pose changes and where a chip
    ends; the edge force changes smoothly there.
    """
    if plan.profile is None:
        old = _earlier_tips(plan, earlier)
        wrench = upright_wrench(plan, cutter, law, pose.tip, old, thinned.tip, samples)
        if bottom is not None:
            under = law.for_bottom() if bottom_law is None else bottom_law
            force = bottom_force(plan, cutter, under, pose.tip, earlier.tip, bottom)
            wrench = wrench + jnp.pad(force, ((0, 0), (0, 3)))
        return wrench
    return wrench_in_space(
        plan, cutter, law, bottom_law, pose, earlier, thinned, samples
    )


def substep_chip(
    plan: ProcessPlan,
    cutter: AbstractCutter,
    pose: Pose,
    earlier: Pose,
    thinned: Pose,
    samples: EdgeSamples,
) -> Float[Array, "angle kept element"]:
    """Return the unclipped chip thickness of one sub-step [m]; see `substep_wrench`."""
    angle = samples.angle
    if plan.profile is None:
        old = _earlier_tips(plan, earlier)
        return upright_chip(plan, cutter, pose.tip, old, thinned.tip, angle)[0]
    return chip_in_space(plan, cutter, pose, earlier, thinned, angle, samples.tooth)[0]


def _earlier_tips(plan: ProcessPlan, earlier: Pose) -> Float[Array, "tooth 3"]:
    """Return the tips that bound a chip: for a point cloud only the newest does."""
    return earlier.tip[:1] if plan.chip == "point_cloud" else earlier.tip


def substep_middles(plan: ProcessPlan, dtype: jnp.dtype) -> Float[Array, " substep"]:
    """Return the middle of each sub-step as a share of the tooth period."""
    return (jnp.arange(plan.substeps, dtype=dtype) + 0.5) / plan.substeps


def substep_ends(plan: ProcessPlan, dtype: jnp.dtype) -> Float[Array, " substep"]:
    """Return the end of each sub-step as a share of the tooth period."""
    return (jnp.arange(plan.substeps, dtype=dtype) + 1) / plan.substeps


def element_heights(
    plan: ProcessPlan, cutter: AbstractCutter, dtype: jnp.dtype
) -> Float[Array, " element"]:
    """Return how far above the tip the middle of every element is [m]."""
    if plan.profile is None:
        return plan.discs.centers(dtype)
    return profile_elements(plan, cutter, dtype).height
