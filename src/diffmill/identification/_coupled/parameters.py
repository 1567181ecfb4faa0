"""Parameters of arm and cut that are fitted to a coupled record, by name.

Steps are taken in logarithms, so that a fit starts from what is finite and not 0, and
keeps its sign.
"""

import math
from collections.abc import Sequence

from ..._job import Job
from .model import parameter_values


def fitted_names(
    job: Job, fit: Sequence[str] | None, has_force: bool
) -> tuple[str, ...]:
    """Names of the parameters to fit.

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
        fit = [name for name in usual if _has_scale(values[name])]
        if not fit:
            raise ValueError(
                "Argument `job` must have a parameter that is finite and not 0 to "
                "start from, but has none."
            )
    wanted: list[str] = []
    for name in fit:
        # What is zero or infinite has no scale.
        group = [
            n
            for n, value in values.items()
            if n == name or (n.startswith(f"{name} ") and _has_scale(value))
        ]
        if not group:
            raise ValueError(
                f'Argument `fit` may have "K", "D", {", ".join(values)}, but has '
                f'"{name}".'
            )
        wanted += group
    lost = [n for n in wanted if not _has_scale(values[n])]
    if lost:
        raise ValueError(
            "What is fitted must be finite and not 0 in the job, where the fit starts, "
            f"but {lost[0]} is {values[lost[0]]:g}."
        )
    return tuple(dict.fromkeys(wanted))


def fixed_parameter_note(job: Job, has_force: bool) -> tuple[str, ...]:
    """Sentence about parameters that are usually fitted, but have no start.

    Args:
        job: The job, with a robot.
        has_force: Whether the force was measured.

    Returns:
        A sentence, or none.
    """
    values = parameter_values(job)
    without_start = [
        f"{name} is {values[name]:g}"
        for name in _usual_names(values, has_force)
        if not _has_scale(values[name])
    ]
    if not without_start:
        return ()
    return (
        "Not fitted, since a fit starts from a finite number that is not 0: in the job "
        f"{', '.join(without_start)}.",
    )


def _has_scale(value: float) -> bool:
    """True if a fit can start from a value; it keeps its sign."""
    return value != 0 and math.isfinite(value)


def _usual_names(values: dict[str, float], has_force: bool) -> list[str]:
    """Names of the parameters to fit if nothing else is asked for."""
    return [name for name in values if has_force or name[:2] in ("K ", "D ")]
