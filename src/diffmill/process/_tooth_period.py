"""The begin of a tooth period: the pose enters the history, removal, then the look."""

from jaxtyping import Array, Bool, Int

from ..workpiece import Pose
from ._engagement.edge_samples import Engagement
from ._live_rows import when_live
from ._process import Process
from ._state import ProcessState, Removed


def advance_process(
    process: Process,
    state: ProcessState,
    index: Int[Array, ""],
    pose: Pose,
    predicted: Pose,
    is_live: Bool[Array, ""] | None = None,
) -> tuple[ProcessState, Engagement, Removed]:
    """Take in the pose at the start of a period, remove, and look for material.

    Args:
        process: The process.
        state: State after the period before.
        index: Index k of the period, which runs from pose k - 1 to pose k, shape ().
        pose: Pose k - 1 at the start, shape (3,).
        predicted: Poses expected in the middle of the sub-steps, shape (substep, 3).
        is_live: Whether the period counts, shape (); behind the last row of a padded
            path nothing is looked up. None for a path that is not padded.

    Returns:
        The new state, the engagement of this period, and what was removed.
    """
    engagement = process.engagement
    state, removed = engagement.advance(process, state, index - 1, pose)
    engage = lambda: engagement.engage(process, state, index, predicted)
    return state, when_live(is_live, engage), removed
