"""Chips of the teeth in a tooth period, for a figure of single chips."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...process import Engagement, Process
from ...workpiece import Pose


class TurnChips(eqx.Module):
    """Chips of the teeth in some periods, sample by sample.

    Attributes:
        angle: Of the samples [rad], shape (*period, substep, angle, kept, disc).
        tooth: The tooth that each is of, same shape.
        chip: Chip thickness in the stock [m], shape (*period, substep, angle, kept,
            element).
        weight: Occupancy, same shape.
    """

    angle: Float[Array, "*period substep angle kept disc"]
    tooth: Int[Array, "*period substep angle kept disc"]
    chip: Float[Array, "*period substep angle kept element"]
    weight: Float[Array, "*period substep angle kept element"]


def turn_chips(
    process: Process, cut: Engagement, middles: Pose, recent: Pose
) -> TurnChips:
    """Chips of the teeth in a period whose poses are known.

    Args:
        process: The process.
        cut: The engagement in the period.
        middles: Poses in the middle of its sub-steps, shape (substep, 3).
        recent: Those of earlier periods, newest first, shape (tooth, substep, 3).
    """
    chip = jax.vmap(
        lambda samples, pose, earlier: process.engagement.chip(
            process, samples, pose, earlier, cut.decimated
        )
    )(cut.samples, middles, process.earlier(recent, middles))
    samples = cut.samples
    chip = jnp.clip(chip, 0, process.cutter.diameter / 2) * samples.chip_share
    return TurnChips(samples.angle, samples.tooth, chip, samples.occupancy)
