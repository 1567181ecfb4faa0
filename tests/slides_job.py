"""A small job on three slides as soft as an arm, which several modules run whole."""

import pathlib

AXIS = """
[[elements]]
kind = "prismatic"
name = "{name}"
axis = {axis}
stiffness = "1.0e6 N/m"
damping = "2 kN*s/m"
"""
ARM = (
    'name = "slides"\n'
    + AXIS.format(name="x", axis=[1, 0, 0])
    + AXIS.format(name="y", axis=[0, 1, 0])
    + AXIS.format(name="z", axis=[0, 0, 1])
    + """
[[elements]]
kind = "body"
mass = "80 kg"
inertia = ["1 kg*m^2", "1 kg*m^2", "1 kg*m^2"]
[[elements]]
kind = "tool"
name = "tool"
"""
)
PROGRAM = """G21 G17 G90 G94
G0 X-5.5 Y1 Z1
G0 Z-0.8
G1 X6 F3000
G1 Y4
G1 X-5.5
M2
"""
JOB = """
[cutter]
kind = "flat"
diameter = "10 mm"
teeth = 2
[spindle]
speed = "8000 rpm"
[force]
K_tc = "989.8 N/mm^2"
K_rc = "337.3 N/mm^2"
K_ac = "66.9 N/mm^2"
[stock]
lower = ["0 mm", "0 mm", "-2 mm"]
upper = ["8 mm", "8 mm", "0 mm"]
spacing = "0.5 mm"
[program]
file = "part.ngc"
acceleration = "0.5 m/s^2"
[robot]
file = "arm.toml"
work_in_base = { position = ["0 mm", "0 mm", "0 mm"] }
[simulation]
substeps = 4
[correction]
"""


def write_slides_job(
    folder: pathlib.Path, *lines: str, program: str = PROGRAM
) -> pathlib.Path:
    """Write robot, program and job; lines go to the table of the correction."""
    (folder / "arm.toml").write_text(ARM)
    (folder / "part.ngc").write_text(program)
    file = folder / "job.toml"
    file.write_text(JOB + "".join(f"{line}\n" for line in lines))
    return file
