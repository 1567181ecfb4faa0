"""An input shaper: the program as it is, but without what makes a mode ring.

A path that is given twice, half a period T_d of a damped mode apart, with the shares

    A_1 = 1 / (1 + K),   A_2 = K / (1 + K),   K = exp(-zeta pi / sqrt(1 - zeta^2)),

leaves the mode at rest wherever the path is at rest: the second half undoes what the
first has begun. It knows nothing of the cut, and takes a curve off its course by about
v^2 T_d^2 / (32 r) inward.

Reference: Singer and Seering, Preshaping Command Inputs to Reduce System Vibration,
Journal of Dynamic Systems, Measurement, and Control 112 (1990).
"""

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._job import Job
from ..._types import FloatRows3, RealScalarLike
from ...robot import damped_modes
from ...sim import JobKinematics


def shaped(
    positions: FloatRows3,
    time_step: RealScalarLike,
    *,
    frequency: RealScalarLike,
    damping_ratio: RealScalarLike,
) -> Float[np.ndarray, "step 3"]:
    """Path that leaves a mode at rest, without a delay in the mean [m], (step, 3).

    Args:
        positions: The path [m], shape (step, 3); at rest before and after it.
        time_step: Time between its rows [s].
        frequency: At which the damped mode rings [Hz].
        damping_ratio: Of the mode, below 1 [-].

    Returns:
        The path to command [m], shape (step, 3).

    **Differentiability**: none, a host function.
    """
    zeta, half = float(damping_ratio), 0.5 / float(frequency)
    K = math.exp(-zeta * math.pi / math.sqrt(1 - zeta**2))
    second = K / (1 + K)
    # The path is known beforehand: the first part comes as early as the second late.
    early = second * half
    path = np.asarray(positions)
    time = float(time_step) * np.arange(path.shape[0])

    def at(moment: Float[np.ndarray, " step"]) -> Float[np.ndarray, "step 3"]:
        return np.stack([np.interp(moment, time, x) for x in path.T], axis=1)

    return (1 - second) * at(time + early) + second * at(time + early - half)


def shaped_program(job: Job, desired: Float[Array, "step 3"]) -> Float[Array, "step 3"]:
    """Program of a job shaped for the slowest mode of its arm [m], shape (step, 3).

    Args:
        job: The job; of a robot its pose in the middle of the path counts.
        desired: The program [m], shape (step, 3).

    Returns:
        The path to command [m], shape (step, 3); the program if no mode rings.

    **Differentiability**: none, a host function.
    """
    job = job.as_known
    if job.modes is not None:
        ratios = np.asarray(job.modes.damping_ratios)
        frequencies = np.asarray(job.modes.frequencies) * np.sqrt(1 - ratios**2)
    else:
        joints, _ = JobKinematics(job).joints(desired)
        modes = damped_modes(job.robot, joints[joints.shape[0] // 2])  # pyright: ignore[reportArgumentType]
        ratios, frequencies = modes.damping_ratios, modes.frequencies
    if frequencies.size == 0:
        return desired
    slowest = int(np.argmin(frequencies))
    path = shaped(
        np.asarray(desired),
        float(job.tooth_period),
        frequency=frequencies[slowest],
        damping_ratio=ratios[slowest],
    )
    return jnp.asarray(path, desired.dtype)
