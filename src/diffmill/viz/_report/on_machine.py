"""Files to load on the machine, and settings to make there."""

from typing import TYPE_CHECKING

import numpy as np

from ..._job import Job
from .._cases import case_numbers, chosen_case, reference_case
from .._style import length_text
from .verdict import written_errors

if TYPE_CHECKING:
    import xarray

# Files that say the motion and leave base and tool to the robot's controller.
_ROBOT_FILES = (".src", ".mod")


def machine_lines(dataset: "xarray.Dataset", job: Job | None) -> list[str]:
    """Lines on the files to load, and on the zero, tool and spindle that they need.

    Args:
        dataset: A result of `correct`; of another there are no lines.
        job: The job.
    """
    chosen, reference = chosen_case(dataset), reference_case(dataset)
    if job is None or chosen == reference:
        return []
    rms = lambda case: case_numbers(dataset, case).contour.rms
    if rms(chosen) > rms(reference):
        return ["Nothing to load: the corrected command is worse than the program."]
    written = written_errors(dataset, "rms")
    names = [f"corrected{suffix}" for suffix in job.output.suffixes]
    if not names:
        return []
    files = [
        f"{name} ({length_text(written[name])} rms, read back and run)"
        if name in written
        else name
        for name in names
    ]
    ends = [1e3 * job.stock.ray_ends(k).points[:, k] for k in range(3)]
    block = ", ".join(
        f"{axis} {np.min(along):.4g} to {np.max(along):.4g}"
        for axis, along in zip("xyz", ends, strict=True)
    )
    cutter, speed = job.cutter, float(job.spindle_speed) * 30 / np.pi
    times = " G-code states them as inverse time (G93)."
    lines = [
        f"Load in place of the programmed path: {' or '.join(files)}.",
        f"Zero: that of the program; from there the stock reaches over {block} mm.",
        f"Tool: {2e3 * cutter.nominal_radius:g} mm, {cutter.flute_count} teeth, at "
        f"{speed:.5g} rpm; the coordinates are those of its tip.",
        "The times of the blocks are a part of the correction: an override of the feed "
        f"other than 100 % undoes it.{times if '.ngc' in job.output.suffixes else ''}",
    ]
    if ".apt" in job.output.suffixes:
        lines.append(
            "APT states feeds instead of times: its file is not run, and what it "
            "leaves is not known."
        )
    if any(suffix in _ROBOT_FILES for suffix in job.output.suffixes):
        lines.append(
            "The comment at the head of the robot's file says what it states beside "
            "the motion; what it does not of base, tool, approach and spindle is set "
            "on the controller."
        )
    elif job.robot is not None:
        lines.append(
            'A robot may need another file: [output] formats = ["krl"] or ["rapid"].'
        )
    return lines
