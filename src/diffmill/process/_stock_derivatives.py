"""Derivatives of a simulation through the removal of material.

Every end remembers the pose that cut it, or its place in the raw stock, and its
derivative with respect to that pose is known in closed form. So derivatives of samples
go to the poses directly: no tangent of the stock is needed, and in reverse mode a step
keeps only the ends that its samples read.

The removed volume, the final stock and the point cloud of a tool's pass are what needs
the ends of the rays themselves.
`ThroughRays` differentiates them too, by a tangent of the stock, which is a second
stock: it costs where somebody asks for it. `ThroughPoses` holds them constant.
"""

import abc
import dataclasses

import equinox as eqx

from ..workpiece import Pose, PoseTrack, Stock


class AbstractAdjoint(eqx.Module):
    """Policy for derivatives through the stock."""

    @abc.abstractmethod
    def removal_poses(self, poses: Pose) -> Pose:
        """Return the poses as removal should see them."""

    @abc.abstractmethod
    def with_pose_derivatives(self, track: PoseTrack, raw: Stock) -> PoseTrack | None:
        """The track that carries the derivatives of samples, or None.

        Args:
            track: The poses so far.
            raw: The stock before the run.
        """


class ThroughRays(AbstractAdjoint):
    """Differentiate everything: volumes and the final stock by the ends of all rays."""

    def removal_poses(self, poses: Pose) -> Pose:
        """Return the poses unchanged."""
        return poses

    def with_pose_derivatives(self, track: PoseTrack, raw: Stock) -> PoseTrack:
        """Return the poses and the raw stock."""
        return dataclasses.replace(track, raw=raw)


class ThroughPoses(AbstractAdjoint):
    """Differentiate all but volumes, the final stock and point clouds by poses."""

    def removal_poses(self, poses: Pose) -> Pose:
        """Return the poses as constants."""
        return poses.frozen()

    def with_pose_derivatives(self, track: PoseTrack, raw: Stock) -> PoseTrack:
        """Return the poses and the raw stock."""
        return dataclasses.replace(track, raw=raw)


class FrozenStock(AbstractAdjoint):
    """Differentiate as if the stock did not depend on the path.

    Chips follow all poses all the same: theirs is the surface that the last teeth left.
    """

    def removal_poses(self, poses: Pose) -> Pose:
        """Return the poses as constants."""
        return poses.frozen()

    def with_pose_derivatives(self, track: PoseTrack, raw: Stock) -> None:
        """Return None: the ends that samples read are constants."""
        del track, raw
