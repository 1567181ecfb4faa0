"""A small job on three slides as soft as an arm, which several modules run whole."""

import pathlib

from small_job import arm_text, body, job_text, slide

SPRING = {"stiffness": "1.0e6 N/m", "damping": "2 kN*s/m"}
ARM = arm_text(
    *(slide(name, axis, **SPRING) for axis, name in enumerate("xyz")),
    body("80 kg"),
    {"kind": "tool", "name": "tool"},
    name="slides",
)
PROGRAM = """G21 G17 G90 G94
G0 X-5.5 Y1 Z1
G0 Z-0.8
G1 X6 F3000
G1 Y4
G1 X-5.5
M2
"""
ROBOT = {"file": "arm.toml", "work_in_base": {"position": 3 * ["0 mm"]}}
JOB = job_text(
    {
        "stock.lower": ["0 mm", "0 mm", "-2 mm"],
        "program.acceleration": "0.5 m/s^2",
        "robot": ROBOT,
        "simulation": {"substeps": 4},
        "correction": {},
    }
)


def with_machine(text: str, machine: str) -> str:
    """Text of a job with another machine in place of its robot."""
    robot, rest = text.index("[robot]"), text.index("[simulation]")
    return text[:robot] + machine + text[rest:]


def write_slides_job(
    folder: pathlib.Path, *lines: str, program: str = PROGRAM
) -> pathlib.Path:
    """Write robot, program and job; lines go to the table of the correction."""
    (folder / "arm.toml").write_text(ARM)
    (folder / "part.ngc").write_text(program)
    file = folder / "job.toml"
    file.write_text(JOB + "".join(f"{line}\n" for line in lines))
    return file
