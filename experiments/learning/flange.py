"""The same with a flange spring that no parameter of the model describes."""

import dataclasses

import diffmill as dm
from diffmill.robot import FlangeSpring
from loop import drawn, judge, load, table, tracked

SPRING = FlangeSpring(
    mass=30.0,
    center_of_mass=(0.0, 0.0, 0.12),
    inertia=(0.5, 0.5, 0.2),
    rotary_stiffness=(6e5, 6e5, 1e6),
)


def measure(report):
    """Print the table."""
    job = load()
    machines = []
    for machine in drawn(job):
        assert machine.robot is not None
        robot = SPRING.mounted_on(machine.robot)
        other = dataclasses.replace(machine, robot=robot, nominal=None)
        machines.append(dm.sim.mismatched(job, other))
    found = table(report, job, machines, tracked, rounds=2)
    judge(report, found, [(6.0, 7.0), (4.5, 5.5)])
