"""Verdict on the tolerance of a result, and on the causes of its error."""

from typing import TYPE_CHECKING, Literal

import equinox as eqx
import numpy as np

from ...settings.correction import CorrectionSettings
from .._cases import (
    case_numbers,
    chosen_case,
    cutting_of,
    place_text,
    position_text,
    reference_case,
    select_case,
    values_of,
)
from .._style import case_style, length_text
from .case_parts import case_parts

if TYPE_CHECKING:
    import xarray

# A bound counts as reached from this share of it: the optimiser keeps a reserve.
_REACHED_SHARE = 0.98
# Attributes of the error of a written file begin with a word for its name.
_WRITTEN = {"corrected": "written", "moved": "moved", "stream": "stream"}
# The surface breaks a tolerance where it lies so many times as deep in the part: the
# meshes that are compared are off by some micrometres at edges.
_DEPTH_PER_TOLERANCE = 1.5
# Without a tolerance its depth is named from so many times the largest contour error.
_DEPTH_PER_ERROR = 3.0
# Volumes that are rounding [m^3].
_NO_VOLUME = 1e-15
# Title of the verdict on a cut in which vibrations grow, whatever its errors are.
_UNSTABLE = "The cut is unstable (chatter)"
# A part of the path is named if its share of the error is so much above its length.
_NAMED_EXCESS = 0.1


class Verdict(eqx.Module):
    """The contour error of one case against a tolerance.

    Attributes:
        is_held: True if the error stays within it at every step that cuts, and the
            surface does not lie much deeper in the part; None if there is nothing to
            judge, or no tolerance was stated and there is no fault.
        title: Verdict in a few words.
        text: Largest error, its place and its causes.
    """

    is_held: bool | None = eqx.field(static=True)
    title: str = eqx.field(static=True)
    text: str = eqx.field(static=True)


def tolerance_band(dataset: "xarray.Dataset") -> float:
    """Return the stated tolerance of a result [m], 0 if there is none."""
    return float(dataset.attrs.get("tolerance_band", 0.0))


def written_errors(
    dataset: "xarray.Dataset", measure: Literal["rms", "max"]
) -> dict[str, float]:
    """Errors of the written files that were read back and run, by name [m].

    Args:
        dataset: A result of `correct`.
        measure: The root mean square contour error, or the largest.
    """
    return {
        f"{file}.{str(key).removeprefix(prefix)}": float(value)
        for file, prefix in ((f, f"{w}_{measure}_") for f, w in _WRITTEN.items())
        for key, value in dataset.attrs.items()
        if str(key).startswith(prefix)
    }


def loaded_errors(
    dataset: "xarray.Dataset", measure: Literal["rms", "max"]
) -> dict[str, float]:
    """Errors of those written files that are loaded into the machine, by name [m].

    A moved program and a stream serve controllers that cannot take these; of a program
    whose times may not be kept the error on the machine is not known.

    Args:
        dataset: A result of `correct`.
        measure: The root mean square contour error, or the largest.
    """
    written, untimed = written_errors(dataset, measure), untimed_programs(dataset)
    loaded = [n for n in written if n.startswith("corrected.") and n not in untimed]
    return {name: written[name] for name in loaded}


def untimed_programs(dataset: "xarray.Dataset") -> dict[str, str]:
    """Corrected programs whose times a controller may not keep, and why, by name.

    Args:
        dataset: A result of `correct`.
    """
    prefix = "written_untimed_"
    return {
        f"corrected.{str(key).removeprefix(prefix)}": str(reason)
        for key, reason in dataset.attrs.items()
        if str(key).startswith(prefix)
    }


def verdict(dataset: "xarray.Dataset", *, is_complete: bool = True) -> Verdict:
    """Verdict on the tolerance of a result.

    Args:
        dataset: A result of `simulate` or `correct`; its attribute `tolerance_band`
            is the largest contour error that is allowed [m]. It holds for the corrected
            programs, too, where they have been run.
        is_complete: True if the run reached its end.
    """
    case, band = chosen_case(dataset), tolerance_band(dataset)
    if not is_complete:
        return Verdict(None, "No verdict", "The run did not reach its end.")
    error = _cutting_error(dataset, case)
    if not error.size:
        return Verdict(None, "No verdict", "Nothing was cut.")
    chatter = _chatter(dataset)
    largest, label = float(error.max()), case_style(case).label
    text = f"{chatter}Largest contour error of the {label} path: "
    text += f"{length_text(largest)}{_place(dataset, case)}."
    expected = dataset.attrs.get("expected_contour_error_rms_m")
    model = _over_draws(dataset, case) or _learnt_text(dataset)
    model = model or (
        " All of it is predicted for a machine that is exactly as modelled"
        f"{_mismatch_text(dataset)}; [simulation] scatter or [correction.uncertainty] "
        "give the error of one that is not."
    )
    model += _truth_text(dataset)
    deepest, deepest_place = 0.0, ""
    if "surface_deepest" in dataset:
        deepest = float(select_case(dataset, case)["surface_deepest"])
    if "surface_deepest_at" in dataset:
        at = values_of(dataset, "surface_deepest_at", case)
        deepest_place = f" ({position_text(at)})"
    deep = (
        f" But the machined surface lies up to {length_text(deepest)} inside "
        f"the part{deepest_place}, cut at steps that the contour error does not count: "
        "[correction] gouge bounds it."
    )
    shank = (
        " But the shank above the flutes is in the stock, and no force counts it: "
        "errors come out too small. Longer flutes or less depth are the cure."
    )
    has_shank = "shank_volume" in dataset and bool(
        (values_of(dataset, "shank_volume", case) > _NO_VOLUME).any()
    )
    if not band:
        text += (
            " No tolerance was stated: [correction] tolerance_band or --tolerance-band "
            "states one, and the report gets a verdict."
        )
        text += model if expected is None else ""
        faults = {
            _UNSTABLE: ("", bool(chatter)),
            "The shank is in the stock": (shank, has_shank),
            "The tool cuts into the part": (deep, deepest > _DEPTH_PER_ERROR * largest),
        }
        present = {name: more for name, (more, is_there) in faults.items() if is_there}
        title = next(iter(present), "No tolerance stated")
        is_held = False if present else None
        return Verdict(is_held, title, text + "".join(present.values()))
    files = loaded_errors(dataset, "max")
    text += _written_text(dataset, band)
    if dataset.attrs.get("written_not_run"):
        text += " The written programs were not run: what they leave is not known."
    if expected is not None:
        text += (
            f" Of machines that scatter as [simulation] scatter says, "
            f"{length_text(expected)} rms is to be expected."
        )
    else:
        text += model
    text += deep if deepest > band else ""
    text += shank if has_shank else ""
    # Written so that a number that is not finite does not count as held.
    errors = (largest, *files.values(), deepest / _DEPTH_PER_TOLERANCE)
    is_held = all(value <= band for value in errors) and not (has_shank or chatter)
    share = 100 * float(np.mean(error <= band))
    # 99.97 % is not "100 %" of a path that leaves the band.
    shown = "all" if largest <= band else f"{min(share, 99.9):.1f} %"
    title = f"{'Within' if is_held else 'Not within'} {length_text(band)}"
    whose = "The command" if case != reference_case(dataset) else "The path"
    text += f" {whose} is within the tolerance at {shown} of the steps that cut."
    return Verdict(is_held, _UNSTABLE if chatter else title, text)


def _chatter(dataset: "xarray.Dataset") -> str:
    """Sentence on growing vibrations and their effect on the figures, if there are."""
    if not dataset.attrs.get("stability_has_chatter"):
        return ""
    text = "A vibration"
    if "stability_frequency" in dataset.attrs:
        growth = 100 * (float(dataset.attrs["stability_largest_radius"]) - 1)
        frequency = float(dataset.attrs["stability_frequency"])
        text += f" at {frequency:.1f} Hz"
        text += f" grows by up to {growth:.2g} % per tooth period and"
    return (
        f"{text} goes on growing until the tool leaves the material: the errors below "
        "are those of a cut that chatters, and no corrected path calms it (see the "
        "warnings). "
    )


def _written_text(dataset: "xarray.Dataset", band: float) -> str:
    """Sentences on the error of each written file, and on files that are not judged."""
    written, loaded = (
        found(dataset, "max") for found in (written_errors, loaded_errors)
    )
    untimed = untimed_programs(dataset)
    text, outside = "", []
    for name, error in written.items():
        size = f"{length_text(error)}" if np.isfinite(error) else "not finite"
        text += f" Of {name}, read back and run: {size}"
        text += ", if its times are kept; not judged." if name in untimed else "."
        is_other = name not in loaded and name not in untimed
        outside += [name] if is_other and not error <= band else []
    if outside:
        text += (
            f" Outside the tolerance, but not judged, is {' and '.join(outside)}: the "
            "file to load is the corrected program."
        )
    return text


def _cutting_error(dataset: "xarray.Dataset", case: str) -> np.ndarray:
    """Return the sizes of the finite contour errors where the tool cuts [m]."""
    if "contour_error" not in dataset:
        return np.zeros(0)
    error = np.abs(values_of(dataset, "contour_error", case))
    return error[cutting_of(dataset, case) & np.isfinite(error)]


def _learnt_text(dataset: "xarray.Dataset") -> str:
    """Sentence on the machine as measured parts have shown it; empty without any."""
    expected = dataset.attrs.get("learnt_expected_rms")
    if expected is None:
        return ""
    return (
        " It is predicted for the machine as measured parts show it; with what they do "
        f"not show of it, {length_text(float(expected))} rms is expected."
    )


def _over_draws(dataset: "xarray.Dataset", case: str) -> str:
    """Sentence on the error over the draws that the command was made for."""
    count = dataset.attrs.get(f"{case}_draws")
    if count is None:
        return ""
    least, largest = (
        length_text(float(dataset.attrs[f"{case}_draw_rms_{end}"]))
        for end in ("least", "largest")
    )
    return (
        f" Over the {count:.0f} draws of [correction.uncertainty] it leaves "
        f"{least} to {largest} rms, as the optimiser weights it."
    )


def _mismatch_text(dataset: "xarray.Dataset") -> str:
    """Clause on the error of the command where stiffness or forces are off."""
    names = ("mismatch_share", "mismatch_rms_stiffness", "mismatch_rms_force")
    if any(name not in dataset.attrs for name in names):
        return ""
    share, *errors = (float(dataset.attrs[name]) for name in names)
    stiffness, force = (
        f"up to {length_text(rms)} rms" if np.isfinite(rms) else "no result"
        for rms in errors
    )
    return (
        f": with all stiffness {share:.0%} off the command leaves {stiffness}, with "
        f"all force coefficients {share:.0%} off {force}"
    )


def _truth_text(dataset: "xarray.Dataset") -> str:
    """Sentence on the error of the command on machines that are not the model."""
    if "truth_draws" not in dataset.attrs:
        return ""
    median, largest, before = (
        float(dataset.attrs[f"truth_rms_{name}"])
        for name in ("median", "largest", "uncorrected")
    )
    if not np.isfinite(largest):
        return " On a machine that [truth] draws about the model the run fails."
    program = f"leaves {length_text(before)}"
    if not np.isfinite(before):
        program = "fails on one of them at least"
    return (
        f" On {dataset.attrs['truth_draws']:.0f} machines with reversal, links, springs"
        f" and forces beside the model ([truth]) it leaves {length_text(median)} "
        f"rms, {length_text(largest)} on the worst, where the program {program}."
    )


def _place(dataset: "xarray.Dataset", case: str) -> str:
    """Time and place of the largest contour error, as text."""
    if "desired" not in dataset:
        return ""
    error = np.abs(values_of(dataset, "contour_error", case))
    row = int(np.nanargmax(np.where(cutting_of(dataset, case), error, np.nan)))
    return f", {place_text(dataset, case, row)}"


def unsettled_text(dataset: "xarray.Dataset") -> str:
    """Sentence on an optimiser that had not settled, where more steps may help."""
    is_short = dataset.attrs.get("corrected_outcome") == "steps ran out"
    # Steps do not calm a cut that is unstable.
    has_chatter = bool(dataset.attrs.get("stability_has_chatter"))
    if not is_short or has_chatter or verdict(dataset).is_held:
        return ""
    return (
        "The optimiser ended after [correction] max_steps, before it settled: more "
        "steps may gain more."
    )


def departure_text(dataset: "xarray.Dataset") -> str:
    """Return the largest offsets of the corrected command, in the cut and in the air.

    Nothing where there is no corrected command.

    Args:
        dataset: A result of `simulate` or `correct`.
    """
    case = chosen_case(dataset)
    if case == reference_case(dataset) or "commanded" not in dataset:
        return ""
    of_case = lambda name: values_of(dataset, "commanded", name)
    offset = of_case(case) - of_case(reference_case(dataset))
    cuts = cutting_of(dataset, case)
    offsets = []
    for rows, where in ((cuts, "where the tool cuts"), (~cuts, "in the air")):
        of_rows = np.where(rows[:, None], np.abs(offset), -1.0)
        row, axis = np.unravel_index(np.argmax(of_rows), of_rows.shape)
        size = float(offset[row, axis])
        if rows.any():
            offsets.append(
                f"{'+' * (size > 0)}{length_text(size)} in {'xyz'[axis]} {where} "
                f"({place_text(dataset, case, int(row))})"
            )
    return (
        "The corrected command departs from the program by up to "
        f"{' and '.join(offsets)}."
    )


def limits(
    dataset: "xarray.Dataset", settings: CorrectionSettings | None
) -> tuple[str, ...]:
    """Sentences on the limits of the error.

    Args:
        dataset: A result of `simulate` or `correct`.
        settings: Settings of the correction, for its bounds.
    """
    case = chosen_case(dataset)
    causes = []
    if dataset.attrs.get("stability_has_chatter", 0):
        causes.append(
            "The cut is unstable (chatter): vibrations grow until the tool leaves the "
            "material, which depth of cut, spindle speed or damping change and a "
            "corrected path does not. See the warnings."
        )
    if case != reference_case(dataset) and settings is not None:
        causes += _bounds_reached(dataset, case, settings)
    unsettled = unsettled_text(dataset)
    causes += [unsettled] if unsettled else []
    if case != reference_case(dataset) and settings is not None:
        if settings.tolerance and verdict(dataset).is_held is False:
            causes.append(
                "Errors below half of [correction] tolerance did not count: without "
                "it all of them become as small as they can."
            )
        causes += _above_knots(dataset, case, settings.knot_spacing)
    return (*causes, *_constant_share(dataset, case), *_part_share(dataset, case))


def _bounds_reached(
    dataset: "xarray.Dataset", case: str, settings: CorrectionSettings
) -> list[str]:
    """Sentence on each bound that the command reaches."""
    if "commanded" not in dataset or settings.command != "tip":
        return []
    time = values_of(dataset, "time", case)
    desired = values_of(dataset, "desired", case)
    commanded = values_of(dataset, "commanded", case)
    step = (time[-1] - time[0]) / (len(time) - 1)
    offset = np.abs(commanded - desired).max(axis=1)
    speed = np.abs(np.diff(commanded, axis=0)).max(axis=1) / step
    rate = lambda path: np.abs(np.diff(path, 2, axis=0)).max(axis=1) / step**2
    own = float(rate(desired).max(initial=0.0)) if len(time) > 2 else 0.0
    factor = settings.acceleration_factor
    most = settings.max_acceleration
    if np.isfinite(factor):
        most = min(most, factor * own)
    reached = []
    for values, bound, name, unit in (
        (offset, float(settings.max_offset), "max_offset", "m"),
        (speed, settings.max_velocity, "max_velocity", "m/s"),
        (rate(commanded), most, "max_acceleration, or its factor,", "m/s\u00b2"),
    ):
        if not np.isfinite(bound):
            continue
        share = float(np.mean(values >= _REACHED_SHARE * bound))
        if share > 0:
            reached.append(
                f"The command reaches its bound [correction] {name} of {bound:.3g} "
                f"{unit} in {100 * share:.2g} % of the steps: a wider one may gain "
                "more."
            )
    return reached


def _above_knots(
    dataset: "xarray.Dataset", case: str, knot_spacing: float
) -> list[str]:
    """Sentence on a remaining error that is mostly faster than the knots can follow."""
    if "deviation" not in dataset:
        return []
    time = values_of(dataset, "time", case)
    cutting = cutting_of(dataset, case)
    remaining = np.nan_to_num(values_of(dataset, "deviation", case)) * cutting[:, None]
    power = np.sum(np.abs(np.fft.rfft(remaining, axis=0)) ** 2, axis=1)
    step = (time[-1] - time[0]) / (len(time) - 1)
    fastest = 0.5 / knot_spacing
    above = np.fft.rfftfreq(len(time), step) > fastest
    share = float(power[above].sum() / max(power.sum(), 1e-30))
    if share < 0.5:
        return []
    return [
        f"{100 * share:.0f} % of the square of the deviation that is left is faster "
        f"than {fastest:.3g} Hz, half of one over the knots' spacing: only a shorter "
        "[correction] knot_spacing follows it."
    ]


def _constant_share(dataset: "xarray.Dataset", case: str) -> list[str]:
    """Sentence on an error that is mostly a constant vector, such as a sag."""
    if "contour_mean" not in dataset:
        return []
    mean = np.asarray(select_case(dataset, case)["contour_mean"], np.float64)
    square = case_numbers(dataset, case).contour.rms ** 2
    share = float(mean @ mean) / square if square else 0.0
    if not share >= 0.5:
        return []
    x, y, z = (length_text(value) for value in mean)
    return [
        f"{min(100 * share, 100):.0f} % of the square of the contour error is a "
        f"constant vector, {x}, {y}, {z} in x, y, z: a static "
        "bend, which a shift of the program takes out."
    ]


def _part_share(dataset: "xarray.Dataset", case: str) -> list[str]:
    """Sentence on a part of the path with more of the error than of the length."""
    item = next((one for one in case_parts(dataset) if one.name == case), None)
    if item is None:
        return []
    rows = {part: count for part, count in item.rows.items() if count}
    squares = {part: rows[part] * item.rms[part] ** 2 for part in rows}
    total, count = sum(squares.values()), sum(rows.values())
    if not total or len(rows) < 2:
        return []
    excess = {part: squares[part] / total - rows[part] / count for part in rows}
    part = max(excess, key=lambda name: excess[name])
    if excess[part] < _NAMED_EXCESS:
        return []
    return [
        f"{100 * squares[part] / total:.0f} % of the square of the contour error is in "
        f"the {part}, which has {100 * rows[part] / count:.0f} % of the steps."
    ]
