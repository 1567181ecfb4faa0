"""Where the tool was when the teeth before passed, of teeth that stand unevenly.

Evenly spaced teeth passed whole tooth periods ago, in the same sub-step of theirs. Of
others the pose lies between those of two sub-steps, of the periods before or, where
teeth are closer than even ones, of this one.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from ...cutter import AbstractCutter
from ...workpiece import Pose


class TeethBefore(eqx.Module):
    """Weights of the poses of sub-steps in those when the teeth before passed.

    A pose goes straight from the middle of a sub-step to that of the next one.

    Attributes:
        recent: Of those of the periods before, newest first, shape (substep, before,
            tooth, period, substep), for the k-th tooth before each tooth.
        within: Of those of this period, 0 for later ones, shape (substep, before,
            tooth, substep).
    """

    recent: Float[Array, "part before tooth period substep"]
    within: Float[Array, "part before tooth substep"]

    @staticmethod
    def of(cutter: AbstractCutter, substeps: int, dtype: DTypeLike) -> "TeethBefore":
        """Return the weights in all sub-steps of a period.

        Differentiability: in the pitch, with kinks where a delay is a whole number of
        sub-steps.
        """
        periods = cutter.flute_count
        # From the first sub-step of the oldest period.
        last = jnp.arange(substeps, dtype=dtype).reshape(-1, 1, 1) + periods * substeps
        place = jnp.maximum(last - substeps * cutter.delays(dtype)[None], 0)
        nodes = jnp.arange((periods + 1) * substeps, dtype=dtype)[None, None, None]
        weights = jnp.maximum(1 - jnp.abs(place[..., None] - nodes), 0)
        weights = weights.reshape(*place.shape, periods + 1, substeps)
        return TeethBefore(weights[..., -2::-1, :], weights[..., -1, :])

    def poses(self, recent: Pose, now: Pose) -> Pose:
        """Return the poses when the teeth before passed.

        Args:
            recent: Poses of the sub-steps of the periods before, newest first, shape
                (period, substep, 3).
            now: Those of this period, shape (substep, 3); all the first one where they
                are not known yet.

        Returns:
            The poses, shape (substep, before, tooth, 3).
        """

        def between(old: Array, new: Array) -> Array:
            # From one pose on: a tool that stands still has been just there. In full
            # precision, as a GPU would round to TF32.
            ref = new[0]
            old, new = old - ref[None, None], new - ref[None]
            way = jnp.einsum("skjtu,tua->skja", self.recent, old, precision="highest")
            way += jnp.einsum("skju,ua->skja", self.within, new, precision="highest")
            return ref[None, None, None] + way

        return jax.tree.map(between, recent, now)
