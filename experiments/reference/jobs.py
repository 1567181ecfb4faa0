"""Six jobs that take the ways of the program between them."""

import pathlib

import numpy as np

import diffmill as dm
from small_job import small_job

FLAT = 'diameter = "10 mm"\nteeth = 2'
UNEVEN = '\npitch = ["165 deg", "195 deg"]\nrunout = "8 um"\nhelix_angle = "30 deg"'
BALL = 'kind = "ball"\ndiameter = "6 mm"\nteeth = 2'
SLOT = "G21 G17 G90 G94\nG0 X-6 Y4 Z1\nG0 Z-1\nG1 X5 F3000\nG1 Y-7\nM2\n"
MODES = """
[[machine.modes]]
frequency = "60 Hz"
damping_ratio = 0.1
direction = [1, 0, 0]
stiffness = "2 N/um"
[[machine.modes]]
frequency = "75 Hz"
damping_ratio = 0.1
direction = [0, 1, 0.2]
stiffness = "2.5 N/um"
"""
ARM = """
[robot]
model = "reis_rv130_like"
work_in_base = { position = ["1514 mm", "-8.5 mm", "936 mm"], \
rpy = ["0 deg", "0 deg", "0 deg"] }
"""
CONTROLLER = """
[controller]
interpolation_cycle = "12 ms"
moving_average = "24 ms"
bandwidth = "8 Hz"
"""
SETTINGS = """
[simulation]
precision = "float64"
stability = false
[correction]
max_steps = 2
knot_spacing = "15 ms"
"""
SEGMENTS = "horizon = 60\noverlap = 30\n"
# Cutter, program, and what replaces the rigid machine.
SMALL = {
    "tilted_ball": (BALL, "path.csv", ARM + SETTINGS),
    "uneven": (FLAT + UNEVEN, "part.ngc", MODES + SETTINGS),
    "modes": (FLAT, "part.ngc", MODES + SETTINGS),
    "controller": (FLAT, "part.ngc", ARM + CONTROLLER + SETTINGS + SEGMENTS),
}
NAMES = ("tiny", "paper_small", *SMALL)


def reference_job(name: str, folder: pathlib.Path) -> dm.Job:
    """Return one of the jobs, written to a folder."""
    if name not in SMALL:
        file = dm.examples.copy_example(name, folder)
        text = file.read_text()
        file.write_text(text.replace("[correction]", "[correction]\nmax_steps = 2", 1))
        return dm.load_job(file)
    cutter, program, more = SMALL[name]
    (folder / "part.ngc").write_text(SLOT)
    (folder / "path.csv").write_text(_leaning_path())
    text = small_job(cutter, program=program, more=more)
    file = folder / f"{name}.toml"
    file.write_text(text.replace("[robot]\nrigid = true\n", ""))
    return dm.load_job(file)


def _leaning_path() -> str:
    """Return the path of a ball that leans by 0.3 rad, half a millimetre deep."""
    lean, x = 0.3, np.linspace(-4.0, 9.0, 90)
    y, z = 4 - 3 * np.sin(lean), 3 - 3 * np.cos(lean) - 0.5
    axis = f"0,{np.sin(lean):.12f},{np.cos(lean):.12f}"
    rows = [f"{k * 3.75e-3:.5f},{x[k]:.6f},{y:.9f},{z:.9f},{axis}" for k in range(90)]
    return "\n".join(["time_s,x_mm,y_mm,z_mm,i,j,k", *rows])
