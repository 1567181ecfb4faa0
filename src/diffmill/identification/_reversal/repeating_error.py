"""Error of a joint that repeats: a function of its position and direction.

A Gaussian process with a squared exponential covariance, written as a sum of bells a
half of its length apart, so that it is one more set of columns of a regression.
"""

import dataclasses
import math

import numpy as np
from jaxtyping import Float

from .joint_motion import JointMotion

# Bells per length of the process.
_DENSITY = 2.0


@dataclasses.dataclass(frozen=True)
class RepeatingError:
    """Prior of the error that repeats.

        k(q, q') = size^2 exp(-(q - q')^2 / (2 length^2))

    Attributes:
        length: [rad].
        size: Standard deviation [rad].
        by_direction: Whether a part of the same size changes its sign with the bristle.
        first: Where the bells begin [rad].
        last: Where they end [rad].
    """

    length: float
    size: float
    by_direction: bool
    first: float
    last: float

    def columns(
        self, motion: JointMotion, presliding: float
    ) -> Float[np.ndarray, "used bell"]:
        """Bells at the positions of a record, shape (used, bell).

        Args:
            motion: The joint.
            presliding: z of the bristle [rad].
        """
        margin = 2 * self.length
        centres = np.arange(
            self.first - margin, self.last + margin, self.length / _DENSITY
        )
        bells = np.exp(-(((motion.angle[:, None] - centres[None]) / self.length) ** 2))
        if not self.by_direction:
            return bells
        return np.hstack([bells, bells * motion.bristle(presliding)[:, None]])

    def precision(self, count: int) -> Float[np.ndarray, " bell"]:
        """Inverse variance of every bell, shape (count,)."""
        share = 1.0 / (_DENSITY * math.sqrt(math.pi / 2))
        return np.full(count, 1.0 / (self.size**2 * share))
