"""Jobs of the small parts on one of the arms."""

import pathlib
import tempfile
from collections.abc import Mapping, Sequence

import numpy as np

import diffmill as dm
from parts import PARTS

ARMS = ("reis_rv130_like", "kuka_kr210_like")

# Round corners, and a speed whose slope jumps.
ROUND = 'corner_tolerance = "0.1 mm"'
TEMPLATE = """
[cutter]
kind = "{cutter}"
diameter = "10 mm"
teeth = 2
helix_angle = "0 deg"
flute_length = "22 mm"
[spindle]
speed = "8000 rpm"
[force]
K_tc = "989.8 N/mm^2"
K_rc = "337.3 N/mm^2"
K_ac = "66.9 N/mm^2"
K_te = "3.0 N/mm"
K_re = "15.4 N/mm"
K_ae = "4.5 N/mm"
[stock]
lower = {lower}
upper = {upper}
spacing = "{spacing} mm"
[program]
file = "part.ngc"
acceleration = "0.5 m/s^2"
rapid_feed = "100 mm/s"
{timing}
[robot]
{model}
work_in_base = {{ position = {place}, rpy = ["0 deg", "0 deg", "0 deg"] }}
{robot}
[simulation]
precision = "float64"
[correction]
{correction}
"""


def part_job(
    name: str,
    arm: str = ARMS[0],
    *,
    correction: Mapping[str, str] | None = None,
    robot: str = "",
    timing: str = ROUND,
) -> dm.Job:
    """Return the job of a part.

    Args:
        name: One of `PARTS`.
        arm: A built-in model.
        correction: Settings of `[correction]` beside the defaults, as TOML values.
        robot: Lines of the table `[robot]`, or tables below it.
        timing: Lines of the table `[program]`: corners and jerk.
    """
    part = PARTS[name]()
    text = job_text(
        arm,
        part.cutter,
        part.lower,
        part.upper,
        correction={"compare": '"all"', **(correction or {})},
        robot=robot,
        timing=timing,
    )
    with tempfile.TemporaryDirectory() as folder:
        file = pathlib.Path(folder) / f"{name}.toml"
        file.write_text(text)
        (file.parent / "part.ngc").write_text(part.program)
        return dm.load_job(file)


def job_text(
    arm: str,
    cutter: str,
    lower: Sequence[float],
    upper: Sequence[float],
    *,
    correction: Mapping[str, str] | None = None,
    robot: str = "",
    spacing_mm: float = 0.2,
    timing: str = ROUND,
) -> str:
    """Return a job whose block [mm] has the middle of its top at the tip, at home.

    An arm that is no built-in model is sought in the file `<arm>.toml` beside the job,
    and has its tip at the origin.
    """
    if arm in dm.robot.built_in_models():
        model = dm.robot.load(arm)
        tip = 1e3 * np.asarray(dm.robot.forward_kinematics(model, model.home))[:3, 3]
        line = f'model = "{arm}"'
    else:
        tip, line = np.zeros(3), f'file = "{arm}.toml"'
    middle = (np.asarray(lower) + np.asarray(upper)) / 2
    settings = {"knot_spacing": '"30 ms"', "max_offset": '"1 mm"', **(correction or {})}
    return TEMPLATE.format(
        cutter=cutter,
        lower=_lengths(lower),
        upper=_lengths(upper),
        spacing=spacing_mm,
        model=line,
        place=_lengths(tip - [middle[0], middle[1], upper[2]]),
        robot=robot,
        timing=timing,
        correction="\n".join(f"{key} = {value}" for key, value in settings.items()),
    )


def _lengths(values: object) -> str:
    return "[" + ", ".join(f'"{x:.3f} mm"' for x in np.asarray(values)) + "]"
