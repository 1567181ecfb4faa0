"""Reading a result dataset: its cases, arrays in display units, headline numbers.

A result of `simulate` has no dimension `case` and is shown as one case called
"predicted"; a result of `correct` has one entry of `case` per method.
"""

from typing import TYPE_CHECKING, Literal, TypeAlias

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from ..toolpath import ContourStatistics

if TYPE_CHECKING:
    import xarray


# Quantity of a figure's horizontal axis.
Abscissa: TypeAlias = Literal["time", "path_length"]
ABSCISSA_LABELS = {"time": "time [s]", "path_length": "path length [mm]"}


class CaseNumbers(eqx.Module):
    """Headline figures of one case.

    Attributes:
        name: Name of the case.
        contour: Contour error over the steps that cut.
        deviation_rms: Root mean square length of the deviation over those steps [m].
        force_mean: Mean over the steps that cut of the force's length [N].
        force_maximum: Largest length of the tooth-mean force [N].
        power_maximum: Largest power of the spindle, as the mean of a tooth period [W].
        removed_volume: Sum of the removed volume [m^3].
    """

    name: str = eqx.field(static=True)
    contour: ContourStatistics
    deviation_rms: float
    force_mean: float
    force_maximum: float
    power_maximum: float
    removed_volume: float


def case_names(dataset: "xarray.Dataset") -> tuple[str, ...]:
    """Return the cases in the dataset's order, ("predicted",) for a simulation."""
    if "case" not in dataset.dims:
        return ("predicted",)
    return tuple(str(name) for name in dataset["case"].values)


def select_case(dataset: "xarray.Dataset", name: str) -> "xarray.Dataset":
    """Return the part of `dataset` that belongs to the case `name`."""
    if "case" not in dataset.dims:
        return dataset
    names = case_names(dataset)
    if name not in names:
        raise ValueError(
            f"Argument `name` must be a case of the result ({', '.join(names)}), but "
            f"is {name!r}."
        )
    return dataset.isel(case=names.index(name))


def values_of(
    dataset: "xarray.Dataset", variable: str, case: str
) -> Float[np.ndarray, "..."]:
    """Return a variable of one case as float64, steps first.

    Args:
        dataset: The result.
        variable: Name of the variable.
        case: Name of the case.

    Returns:
        Its values in SI, shape (step,), (step, axis) or (axis,).
    """
    array = select_case(dataset, case)[variable]
    rows = array.transpose("step", ..., missing_dims="ignore").values
    return np.asarray(rows, dtype=np.float64)


def cutting_of(dataset: "xarray.Dataset", case: str) -> Bool[np.ndarray, " step"]:
    """Mask of the steps that cut; all of them where the dataset does not say."""
    if "is_cutting" not in dataset:
        return np.ones(dataset.sizes["step"], dtype=bool)
    return values_of(dataset, "is_cutting", case) > 0.5


def abscissa(
    dataset: "xarray.Dataset", case: str, over: Abscissa
) -> Float[np.ndarray, " step"]:
    """Time [s] or length of the desired path [mm] at each step, shape (step,)."""
    if over == "time":
        return values_of(dataset, "time", case)
    steps = np.diff(values_of(dataset, "desired", case), axis=0)
    return 1e3 * np.concatenate([[0.0], np.linalg.norm(steps, axis=1).cumsum()])


def place_text(dataset: "xarray.Dataset", case: str, row: int) -> str:
    """Time and place of a step of a case on the desired path, as text."""
    time = values_of(dataset, "time", case)[row]
    return f"at {time:.3f} s, {position_text(values_of(dataset, 'desired', case)[row])}"


def position_text(position: np.ndarray) -> str:
    """Return a position [m] in millimetres."""
    x, y, z = 1e3 * position
    return f"x, y, z = {x:.1f}, {y:.1f}, {z:.1f} mm"


def reference_case(dataset: "xarray.Dataset") -> str:
    """Return the case that the others are compared with: the uncorrected one."""
    names = case_names(dataset)
    return "uncorrected" if "uncorrected" in names else names[0]


def chosen_case(dataset: "xarray.Dataset") -> str:
    """Return the case that became the corrected program; else the reference."""
    name = str(dataset.attrs.get("corrected_case", "corrected"))
    return name if name in case_names(dataset) else reference_case(dataset)


def shown_cases(dataset: "xarray.Dataset") -> tuple[str, ...]:
    """Return the cases that fit a linear scale with the reference case.

    A case whose deviation while cutting is more than twice as large, such as a mirror
    that grows from step to step, would hide all others.
    """
    limit = 2 * case_numbers(dataset, reference_case(dataset)).deviation_rms
    return tuple(
        name
        for name in case_names(dataset)
        if name == reference_case(dataset)
        or not case_numbers(dataset, name).deviation_rms > limit
    )


def is_diverging(dataset: "xarray.Dataset", case: str) -> bool:
    """True if a mirror leaves a larger error than the one that it subtracts.

    Each further mirror then makes it larger still.
    """
    if not case.startswith("mirror"):
        return False
    before = case_numbers(dataset, reference_case(dataset)).contour.rms
    after = case_numbers(dataset, case).contour.rms
    return bool(np.isfinite(before) and not after <= before)


def case_numbers(dataset: "xarray.Dataset", case: str) -> CaseNumbers:
    """Headline figures of one case; NaN where an input is absent."""
    cutting = cutting_of(dataset, case)

    def finite_lengths(name: str) -> Float[np.ndarray, " value"]:
        if name not in dataset:
            return np.zeros(0)
        values = values_of(dataset, name, case)
        length = np.linalg.norm(values, axis=1) if values.ndim == 2 else values
        return length[cutting & np.isfinite(length)]

    force = ContourStatistics.of(finite_lengths("force"))
    speed = float(dataset.attrs.get("spindle_speed", np.nan))
    volume = np.full(1, np.nan)
    if "removed_volume" in dataset:
        volume = values_of(dataset, "removed_volume", case)
    return CaseNumbers(
        name=case,
        contour=ContourStatistics.of(finite_lengths("contour_error")),
        deviation_rms=ContourStatistics.of(finite_lengths("deviation")).rms,
        force_mean=force.mean,
        force_maximum=force.max,
        power_maximum=speed * np.max(finite_lengths("spindle_torque"), initial=0.0)
        if "spindle_torque" in dataset
        else np.nan,
        removed_volume=float(np.nansum(volume))
        if np.isfinite(volume).any()
        else np.nan,
    )
