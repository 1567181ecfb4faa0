"""A small job, of which a test writes the tables that it is about."""

# A short move beside the block.
PROGRAM = "G21 G17 G90 G94\nG0 X-9 Y4 Z1\nG1 X-8 F6000\nM2\n"

# A spindle on turning springs, which the last link of the milling arm holds.
FLANGE_SPRING = """
[robot.flange_spring]
rotary_stiffness = ["2e6 N*m/rad", "3e6 N*m/rad", "4e6 N*m/rad"]
mass = "30 kg"
center_of_mass = ["0 mm", "0 mm", "170 mm"]
inertia = ["0.75 kg*m^2", "0.75 kg*m^2", "0.2 kg*m^2"]
"""


def small_job(cutter, *, program="part.ngc", more=""):
    """Return the text of a job with some lines of its cutter and more tables."""
    return f"""
[cutter]
{cutter}
[spindle]
speed = "8000 rpm"
[force]
K_tc = "989.8 N/mm^2"
K_rc = "337.3 N/mm^2"
K_ac = "66.9 N/mm^2"
[stock]
lower = ["0 mm", "0 mm", "-3 mm"]
upper = ["8 mm", "8 mm", "0 mm"]
spacing = "0.5 mm"
[program]
file = "{program}"
[robot]
rigid = true
{more}
"""
