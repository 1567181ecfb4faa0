"""Parameters of arm and cut that are fitted to a coupled record, by name.

Steps are taken in logarithms, so that a fit starts from what is positive and finite.
"""

import math
from collections.abc import Sequence

from ..._job import Job
from .model import parameter_values


def fitted_names(
    job: Job, fit: Sequence[str] | None, has_force: bool
) -> tuple[str, ...]:
    """Return the names of what is fitted.

    Args:
        job: The job, with a robot.
        fit: What the user asks for, or None for all that can be fitted.
        has_force: Whether the force was measured.

    Returns:
        Names of `Job.parameter_names`.

    Raises:
        ValueError: A name does not exist, or its value gives no start.
    """
    values = parameter_values(job)
    if fit is None:
        usual = _usual_names(values, has_force)
        fit = [name for name in usual if 0 < values[name] < math.inf]
        if not fit:
            raise ValueError(
                "Argument `job` must have a parameter that is positive and finite to "
                "start from, but has none."
            )
    wanted: list[str] = []
    for name in fit:
        # What is zero or infinite has no scale.
        group = [
            n
            for n, value in values.items()
            if n == name or (n.startswith(f"{name} ") and 0 < value < math.inf)
        ]
        if not group:
            raise ValueError(
                f'Argument `fit` may hold "K", "D", {", ".join(values)}, but holds '
                f'"{name}".'
            )
        wanted += group
    lost = [n for n in wanted if not 0 < values[n] < math.inf]
    if lost:
        raise ValueError(
            "What is fitted must be positive and finite in the job, where the fit "
            f"starts, but {lost[0]} is {values[lost[0]]:g}."
        )
    return tuple(dict.fromkeys(wanted))


def kept_note(job: Job, has_force: bool) -> tuple[str, ...]:
    """Say which parameters are usually fitted, but have no scale to start from.

    Args:
        job: The job, with a robot.
        has_force: Whether the force was measured.

    Returns:
        A sentence, or none.
    """
    values = parameter_values(job)
    kept = [
        f"{name} is {values[name]:g}"
        for name in _usual_names(values, has_force)
        if not 0 < values[name] < math.inf
    ]
    if not kept:
        return ()
    return (
        "Not fitted, since a fit starts from a positive and finite number: in the job "
        f"{', '.join(kept)}.",
    )


def _usual_names(values: dict[str, float], has_force: bool) -> list[str]:
    """Return the names of what is fitted if nothing else is asked for."""
    return [name for name in values if has_force or name[:2] in ("K ", "D ")]
