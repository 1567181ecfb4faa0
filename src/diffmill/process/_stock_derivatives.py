"""Derivatives of a simulation through the removal of material.

`ThroughRays` differentiates through the ends of the rays themselves. Every mode of
automatic differentiation works, also for the removed volume and the final stock; but
a tangent of the stock is a second stock, and in reverse mode every step keeps what it
read and scatters into it.

`ThroughPoses` treats the stock as a constant. Every end remembers the pose that cut it,
and the derivative of an end with respect to that pose is known in closed form; so a
step carries derivatives from the poses to the samples directly. Both modes of automatic
differentiation work, a step keeps only the ends that its samples read, and no tangent
of the stock exists. Volumes and the final stock have no derivative under
`ThroughPoses`.
"""

import abc

import equinox as eqx

from ..workpiece import Pose, PoseTrack


class AbstractAdjoint(eqx.Module):
    """Policy for derivatives through the stock."""

    @abc.abstractmethod
    def removal_poses(self, poses: Pose) -> Pose:
        """Return the poses as removal should see them."""

    @abc.abstractmethod
    def tied_to(self, track: PoseTrack) -> PoseTrack | None:
        """Return the poses that carry the derivatives of samples, or None."""


class ThroughRays(AbstractAdjoint):
    """Differentiate through the ends of all rays."""

    def removal_poses(self, poses: Pose) -> Pose:
        """Return the poses unchanged."""
        return poses

    def tied_to(self, track: PoseTrack) -> None:
        """Return None: samples read differentiable ends."""
        del track


class ThroughPoses(AbstractAdjoint):
    """Differentiate through the poses that the ends remember."""

    def removal_poses(self, poses: Pose) -> Pose:
        """Return the poses as constants."""
        return poses.frozen()

    def tied_to(self, track: PoseTrack) -> PoseTrack:
        """Return the poses, which carry the derivatives of the samples."""
        return track


class StockHeld(AbstractAdjoint):
    """Differentiate as if the stock did not depend on the path.

    Chips follow all poses all the same: theirs is the surface that the last teeth left.
    """

    def removal_poses(self, poses: Pose) -> Pose:
        """Return the poses as constants."""
        return poses.frozen()

    def tied_to(self, track: PoseTrack) -> None:
        """Return None: the ends that samples read are constants."""
        del track
