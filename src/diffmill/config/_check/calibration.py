"""What a job with a calibrated robot assumes of its controller."""

import numpy as np

from ..._job import Job


def calibration_note(job: Job) -> str:
    """Note of what the controller knows, and of what touching off leaves.

    Args:
        job: A job whose controller does not know the machine.
    """
    known = job.nominal
    assert known is not None and job.robot is not None
    errors = 1e6 * np.asarray(known.probe_errors(job.robot))
    rms = np.sqrt(np.mean(errors**2))
    return (
        "[robot.calibration]: the controller is taken to know the robot without it; "
        f"touched off at {len(errors)} points, the links leave {rms:.3g} um rms and "
        f"{errors.max():.3g} um at most, which a correction takes away"
    )
