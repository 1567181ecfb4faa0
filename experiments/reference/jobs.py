"""Six jobs that take the ways of the program between them."""

import pathlib

import numpy as np

import diffmill as dm

CUT = """
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
lower = ["0 mm", "-6 mm", "-3 mm"]
upper = ["12 mm", "6 mm", "0 mm"]
spacing = "0.4 mm"
[simulation]
precision = "float64"
stability = false
"""
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
SLOT = "G21 G17 G90 G94\nG0 X-6 Y1 Z1\nG0 Z-1\nG1 X11 F3000\nG1 Y-4\nG1 X-6\nM2\n"
CORRECTION = '[correction]\nmax_steps = 2\nknot_spacing = "15 ms"\n'
CONTROLLER = """
[controller]
interpolation_cycle = "12 ms"
moving_average = "24 ms"
bandwidth = "8 Hz"
"""


def _flat(more: str = "") -> str:
    return f'[cutter]\nkind = "flat"\ndiameter = "10 mm"\nteeth = 2\n{more}{CUT}'


def _text(folder: pathlib.Path, name: str) -> str:
    """Return a job file, and write the program that it names."""
    program = '[program]\nfile = "part.ngc"\nacceleration = "2 m/s^2"\n'
    (folder / "part.ngc").write_text(SLOT)
    if name == "modes":
        return _flat() + program + MODES + CORRECTION
    if name == "uneven":
        edge = (
            'pitch = ["165 deg", "195 deg"]\nrunout = "8 um"\nhelix_angle = "30 deg"\n'
        )
        return _flat(edge) + program + MODES + CORRECTION
    if name == "controller":
        parts = "horizon = 60\noverlap = 30\n"
        return _flat() + program + ARM + CONTROLLER + CORRECTION + parts
    # A ball that leans by 0.3 rad, half a millimetre deep.
    rows, lean = 90, 0.3
    x, z = np.linspace(-4.0, 9.0, rows), 3 - 3 * np.cos(lean) - 0.5
    axis = f"0,{np.sin(lean):.12f},{np.cos(lean):.12f}"
    lines = [
        f"{k * 3.75e-3:.5f},{x[k]:.6f},{-3 * np.sin(lean):.9f},{z:.9f},{axis}"
        for k in range(rows)
    ]
    (folder / "path.csv").write_text("\n".join(["time_s,x_mm,y_mm,z_mm,i,j,k", *lines]))
    ball = f'[cutter]\nkind = "ball"\ndiameter = "6 mm"\nteeth = 2\n{CUT}'
    return f'{ball}[program]\nfile = "path.csv"\n{ARM}{CORRECTION}'


NAMES = ("tiny", "paper_small", "tilted_ball", "uneven", "modes", "controller")


def reference_job(name: str, folder: pathlib.Path) -> dm.Job:
    """Return one of the jobs, written to a folder."""
    if name in ("tiny", "paper_small"):
        file = dm.examples.copy_example(name, folder)
        text = file.read_text()
        file.write_text(text.replace("[correction]", "[correction]\nmax_steps = 2", 1))
        return dm.load_job(file)
    file = folder / f"{name}.toml"
    file.write_text(_text(folder, name))
    return dm.load_job(file)
