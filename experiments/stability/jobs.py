"""Ten cuts, half of them unstable, and cuts drawn by chance."""

import dataclasses
import pathlib
from typing import NamedTuple

import numpy as np

import diffmill as dm

# A mode in x and one in y.
MODES = """
[machine]
[[machine.modes]]
frequency = "{0[0]:.4g} Hz"
damping_ratio = {2[0]:.4g}
direction = [1, 0, 0]
stiffness = "{1[0]:.4g} N/um"
[[machine.modes]]
frequency = "{0[1]:.4g} Hz"
damping_ratio = {2[1]:.4g}
direction = [0, 1, 0]
stiffness = "{1[1]:.4g} N/um"
"""
# As soft and as slow as those of an arm.
ARM_LIKE = MODES.format((60, 75), (1.2, 1.3), (0.04, 0.04))
JOB = """
[cutter]
kind = "flat"
diameter = "10 mm"
teeth = 2
flute_length = "22 mm"
{pitch}
[spindle]
speed = "{speed:.5g} rpm"
[force]
K_tc = "989.8 N/mm^2"
K_rc = "337.3 N/mm^2"
K_ac = "66.9 N/mm^2"
K_te = "3.0 N/mm"
K_re = "15.4 N/mm"
K_ae = "4.5 N/mm"
[stock]
lower = ["0 mm", "0 mm", "-2 mm"]
upper = ["40 mm", "20 mm", "0 mm"]
spacing = "0.5 mm"
[program]
file = "part.ngc"
acceleration = "10 m/s^2"
corner_tolerance = "0 mm"
{machine}
[simulation]
precision = "float64"
substeps = 16
"""
UNEVEN = 'pitch = ["165 deg", "195 deg"]'


class Cut(NamedTuple):
    """One of the ten cuts.

    Attributes:
        name: What it is.
        lines: Its program, `{z}` for the depth; None for that of the example `paper`.
        depth: Depth of the cut [mm].
        box: Least and largest x and y of the tip where the march is judged [mm].
        pitch: Line of the cutter's pitch.
        damping: Of the example, times what it states.
        machine: Tables of the machine.
        speed: Of the spindle [rpm].
    """

    name: str
    lines: str | None
    depth: float
    box: tuple[float, float, float, float]
    pitch: str = ""
    damping: float = 1.0
    machine: str = ARM_LIKE
    speed: float = 8000.0

    def job(self, folder: pathlib.Path) -> dm.Job:
        """Return the job, written to a folder."""
        if self.lines is None:
            job = dm.load_job(dm.examples.copy_example("paper", folder, force=True))
            assert job.robot is not None
            damping = self.damping * np.asarray(job.robot.joint_damping)
            robot = job.robot.with_drives(damping=damping)
            return dataclasses.replace(job, robot=robot)
        lines = self.lines.format(z=-self.depth, z2=-2 * self.depth)
        (folder / "part.ngc").write_text(f"G21 G17 G90 G94\n{lines}\nM2\n")
        text = JOB.format(machine=self.machine, pitch=self.pitch, speed=self.speed)
        (folder / "job.toml").write_text(text)
        return dm.load_job(folder / "job.toml")

    def window(self, desired: np.ndarray) -> np.ndarray:
        """Return the rows of the steady cut in which the march is judged."""
        x, y, z = 1e3 * desired.T
        low_x, high_x, low_y, high_y = self.box
        is_in = (x > low_x) & (x < high_x) & (y > low_y) & (y < high_y)
        return np.flatnonzero(is_in & (z < 0))


# Beside a corner of the stock all programs begin as deep as any of them goes: what is
# compiled for one then serves all.
START = "G0 X-4.5 Y-4.5 Z-0.6\nG0 X-5.5\n"
SLOT = START + "G0 Y10 Z{z}\nG1 X28 F3000"
# The work lies to the right of the feed.
DOWN = START + "G0 X-6 Y22 Z{z}\nG1 X26 F3000"
SLOT_IN_Y = START + "G0 Y-6\nG0 X20 Z{z}\nG1 Y24 F3000"
# Legs with an exact stop at every corner.
CORNERS = START + "G0 Y6 Z{z}\nG1 X8 F3000\nG1 Y13\nG1 X21"
# The second half is twice as deep.
STEPS = START + "G0 Y10 Z{z}\nG1 X8 F3000\nG1 X8.5 Z{z2}\nG1 X25\nG1 X25.5 Z{z}\nG1 X27"
ALONG, LEG, DEEP = (4, 27, -9, 30), (9, 20, 12.9, 13.1), (10, 24, 9, 11)
IN_Y, LEFT = (19, 21, 3, 14), (-2, 0, 10, 18)
CUTS = (
    Cut("slot, 0.35 mm", SLOT, 0.35, ALONG),
    Cut("slot, 0.55 mm", SLOT, 0.55, ALONG),
    Cut("slot along y, 0.35 mm", SLOT_IN_Y, 0.35, IN_Y),
    Cut("down-milling, 0.6 mm", DOWN, 0.6, ALONG),
    Cut("corners and stops, 0.3 mm", CORNERS, 0.3, LEG),
    Cut("corners and stops, 0.6 mm", CORNERS, 0.6, LEG),
    Cut("steps of depth, 0.28 and 0.56 mm", STEPS, 0.28, DEEP),
    Cut("paper", None, 1.0, LEFT),
    Cut("paper, damping of the robot's file", None, 1.0, LEFT, damping=0.4),
    Cut("uneven teeth, slot, 0.55 mm", SLOT, 0.55, ALONG, pitch=UNEVEN),
)


def drawn(count: int, seed: int) -> tuple[Cut, ...]:
    """Return cuts of drawn kinds and depths, each on a drawn machine.

    Args:
        count: How many.
        seed: Of the draws.
    """
    rng = np.random.default_rng(seed)
    kinds = (
        ("slot", SLOT, ALONG),
        ("slot along y", SLOT_IN_Y, IN_Y),
        ("down-milling", DOWN, ALONG),
        ("corners and stops", CORNERS, LEG),
    )
    cuts = []
    for number in range(count):
        kind, lines, box = kinds[rng.integers(len(kinds))]
        modes = MODES.format(
            rng.uniform(40, 120, 2),
            rng.uniform(0.3, 1.5, 2),
            rng.uniform(0.02, 0.06, 2),
        )
        depth, speed = rng.uniform(0.15, 0.6), rng.uniform(6000, 10000)
        name = f"{number}: {kind}, {depth:.2f} mm"
        cuts.append(Cut(name, lines, depth, box, machine=modes, speed=speed))
    return tuple(cuts)
