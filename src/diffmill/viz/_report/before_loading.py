"""Checks of a result before its program is loaded into a machine."""

from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np

from ..._job import Job
from ...robot import Robot
from .._cases import chosen_case, place_text, reference_case, select_case, values_of
from .._figure.joints import shown_units
from .._style import length_text
from .verdict import departure_text, tolerance_band, untimed_programs, verdict

if TYPE_CHECKING:
    import xarray

# Of a joint: distance to a limit [deg or mm], and share of its fastest motion, beyond
# which the operator looks at it.
_NEAR_LIMIT, _NEAR_SPEED = 5.0, 0.8
# Volumes that are rounding [m^3].
_NO_VOLUME = 1e-15


class LoadingCheck(eqx.Module):
    """One thing to be sure of before a program is loaded.

    Attributes:
        name: What is checked.
        finding: What the result says of it.
        is_good: True if nothing speaks against loading, False if something does; None
            where the operator has to look.
    """

    name: str = eqx.field(static=True)
    finding: str = eqx.field(static=True)
    is_good: bool | None = eqx.field(static=True)


def checks_before_loading(
    dataset: "xarray.Dataset", job: Job | None
) -> list[LoadingCheck]:
    """Checks of the corrected program, or of the given one where none was corrected.

    Args:
        dataset: A result of `simulate` or `correct`.
        job: The job; None leaves out what only it knows.
    """
    found = [_tolerance(dataset), _chatter(dataset, job)]
    if job is not None and job.robot is not None and "motor_positions" in dataset:
        found += [_limits(dataset, job.robot), _speeds(dataset, job.robot)]
    found += [_surface(dataset), _collision(dataset, job)]
    departure = departure_text(dataset)
    if departure:
        found.append(LoadingCheck("departure from the program", departure, None))
    for name, reason in untimed_programs(dataset).items():
        text = f"{reason[0].upper()}{reason[1:]}."
        found.append(LoadingCheck(f"times of {name}", text, None))
    if chosen_case(dataset) != reference_case(dataset):
        text = "At 100 %: the times of the blocks are a part of the correction."
        found.append(LoadingCheck("override", text, None))
    return found


def _tolerance(dataset: "xarray.Dataset") -> LoadingCheck:
    judged = verdict(dataset)
    return LoadingCheck("contour error", f"{judged.title}.", judged.is_held)


def _chatter(dataset: "xarray.Dataset", job: Job | None) -> LoadingCheck:
    name = "chatter"
    if dataset.attrs.get("stability_has_chatter"):
        return LoadingCheck(name, "The cut is unstable, see the warnings.", False)
    if job is not None and job.simulation.stability == "none":
        text = "Not examined: [simulation] stability is none."
        return LoadingCheck(name, text, None)
    return LoadingCheck(name, "No vibration has the time to double.", True)


def _limits(dataset: "xarray.Dataset", robot: Robot) -> LoadingCheck:
    case = chosen_case(dataset)
    q = values_of(dataset, "motor_positions", case)
    lower, upper = (
        np.asarray(x, float) for x in (robot.joint_lower, robot.joint_upper)
    )
    scale, units = shown_units(robot)
    room = np.minimum(q - lower, upper - q) * scale
    row, joint = np.unravel_index(np.nanargmin(room), room.shape)
    least = float(room[row, joint])
    if not np.isfinite(least):
        return LoadingCheck("joint limits", "The robot's file states none.", None)
    place = place_text(dataset, case, int(row))
    text = f"{robot.joint_names[joint]} comes closest, to {least:.3g} {units[joint]} "
    text += f"of its limit, {place}."
    return LoadingCheck("joint limits", text, _judged(least > _NEAR_LIMIT, least > 0))


def _speeds(dataset: "xarray.Dataset", robot: Robot) -> LoadingCheck:
    name, case = "joint speeds", chosen_case(dataset)
    limits = None
    if robot.joint_speed is not None:
        limits = np.asarray(robot.joint_speed, float)
    if limits is None or not np.isfinite(limits).any():
        return LoadingCheck(name, "The robot's file states no limits.", None)
    q, time = (values_of(dataset, key, case) for key in ("motor_positions", "time"))
    rate = np.abs(np.diff(q, axis=0) / np.diff(time)[:, None])
    share = rate / limits
    row, joint = np.unravel_index(np.nanargmax(share), share.shape)
    most = float(share[row, joint])
    place = place_text(dataset, case, int(row) + 1)
    text = f"{robot.joint_names[joint]} moves with {100 * most:.3g} % of its largest "
    text += f"speed, {place}."
    return LoadingCheck(name, text, _judged(most < _NEAR_SPEED, most <= 1))


def _judged(is_clear: bool, is_allowed: bool) -> bool | None:
    """True if all is clear, None if it is only just allowed, False if it is not."""
    return True if is_clear else None if is_allowed else False


def _surface(dataset: "xarray.Dataset") -> LoadingCheck:
    name = "gouge"
    if "surface_deepest" not in dataset:
        return LoadingCheck(name, "The surface was not compared.", None)
    case, band = chosen_case(dataset), tolerance_band(dataset)
    deepest = float(select_case(dataset, case)["surface_deepest"])
    text = f"The machined surface is up to {length_text(deepest)} too deep."
    return LoadingCheck(name, text, deepest <= 1.5 * band if band else None)


def _collision(dataset: "xarray.Dataset", job: Job | None) -> LoadingCheck:
    name, case = "shank and holder", chosen_case(dataset)
    warnings = [
        line.removeprefix("warning: ")
        for line in str(dataset.attrs.get("notes", "")).splitlines()
        if line.startswith("warning: ") and "holder" in line
    ]
    if warnings:
        return LoadingCheck(name, "; ".join(warnings), False)
    if "shank_volume" in dataset:
        volume = values_of(dataset, "shank_volume", case)
        if bool((volume > _NO_VOLUME).any()):
            text = "The shank above the flutes is in the stock."
            return LoadingCheck(name, text, False)
    if job is None or job.holder is None:
        return LoadingCheck(
            name, "No holder is stated; the shank is clear of the stock.", None
        )
    return LoadingCheck(name, "Both are clear of the stock.", True)
