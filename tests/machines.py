"""Small machines whose answers are known by hand, and the jobs that they run."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from helpers import PAPER_LAW

from diffmill import (
    CorrectionSettings,
    Job,
    SimulationSettings,
    cutter as ct,
    robot as rb,
)

MASS, STIFFNESS = 80.0, np.array([1.5e6, 2.5e6, 4e6])


def slides(ratio=0.5, stiffness=STIFFNESS):
    """Return slides along x, y and z, the mass on the last, each damped by a ratio."""
    joints = [
        rb.PrismaticJoint(
            name,
            tuple(axis),
            stiffness=float(K),
            damping=2 * ratio * math.sqrt(K * MASS),
        )
        for name, axis, K in zip("xyz", np.eye(3), stiffness, strict=True)
    ]
    return rb.build([*joints, rb.RigidBody(MASS, (0, 0, 0), np.eye(3))])


def one_mode(frequency=10.0, ratio=0.02, mass=MASS):
    """Return a slide along x with one mode."""
    omega = 2 * math.pi * frequency
    slide = rb.PrismaticJoint(
        "slide", (1, 0, 0), stiffness=mass * omega**2, damping=2 * ratio * omega * mass
    )
    return rb.build([slide, rb.RigidBody(mass, (0, 0, 0), np.eye(3)), rb.Tool("tool")])


def gantry(damping=600.0, swivel_damping=30.0):
    """Return three soft slides and a swivel about y with a milling spindle."""
    K = MASS * (2 * np.pi * 30.0) ** 2
    joints = [
        rb.PrismaticJoint(n, axis=a, stiffness=K, damping=damping)
        for n, a in (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1)))
    ]
    swivel = rb.RevoluteJoint("b", (0, 1, 0), stiffness=4e4, damping=swivel_damping)
    body = rb.RigidBody(MASS, (0.0, 0.0, 0.1), np.eye(3))
    return rb.build([*joints, swivel, body, rb.Tool("tool", (0.0, 0.0, -0.1))])


def planar_arm():
    """Return a 2R arm in the vertical x-z plane, angles from +x, counterclockwise.

    Lengths 0.7 and 0.5 m, masses 3 and 2 kg at 0.3 and 0.2 m, inertias 0.06 and
    0.03 kg m^2 about the axes of rotation; soft enough to swing far.
    """
    axis = (0.0, -1.0, 0.0)
    return rb.build(
        [
            rb.RevoluteJoint("shoulder", axis, stiffness=900.0, damping=2.0),
            rb.RigidBody(3.0, (0.3, 0.0, 0.0), np.diag([0.05, 0.06, 0.05])),
            rb.FixedTranslation((0.7, 0.0, 0.0)),
            rb.RevoluteJoint("elbow", axis, stiffness=400.0, damping=1.0),
            rb.RigidBody(2.0, (0.2, 0.0, 0.0), np.diag([0.02, 0.03, 0.02])),
            rb.FixedTranslation((0.5, 0.0, 0.0)),
        ],
        name="planar",
    )


def home_frame(robot):
    """Return the frame of a work whose origin is the tip at home."""
    frame = np.eye(4)
    frame[:3, 3] = np.asarray(rb.forward_kinematics(robot, robot.home))[:3, 3]
    return frame


def motors_of(robot, tips, T_base_work):
    """Return the motors that hold the tips, the weight's sag made up for."""
    Ts = jnp.broadcast_to(jnp.asarray(T_base_work)[None], (len(tips), 4, 4))
    Ts = Ts.at[:, :3, 3].add(jnp.asarray(tips) @ T_base_work[:3, :3].T)
    q = rb.inverse_kinematics_path(robot, Ts, robot.home).q
    return jax.vmap(lambda row: rb.motor_positions(robot, row))(q)


def job_of(robot, path, stock, correction=None, **simulation):
    """Return a job of a plain cutter of 10 mm, a tooth period from row to row."""
    usual: dict[str, Any] = {"element_height": 0.5e-3, "axial_depth": 1.5e-3}
    return Job(
        name="slot",
        cutter=ct.flat_end_mill(10e-3, 2),
        law=PAPER_LAW,
        spindle_speed=math.pi / float(path.time[1] - path.time[0]),
        stock=stock,
        path=path,
        robot=robot,
        T_base_work=np.eye(4),
        joint_start=None,
        simulation=SimulationSettings(**usual | simulation),
        correction=correction or CorrectionSettings(),
    )
