"""Small arms with known answers."""

import numpy as np
import pytest

import machines
from diffmill.robot import (
    FixedRotation,
    FixedTranslation,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    build,
    load,
    rpy_matrix,
)


@pytest.fixture(scope="session")
def arm():
    """The built-in milling robot."""
    return load("reis_rv130_like")


@pytest.fixture(scope="session")
def planar_arm():
    """A 2R arm in the vertical x-z plane."""
    return machines.planar_arm()


@pytest.fixture(scope="session")
def soft_arm():
    """Motor, virtual and sliding joints mixed, soft enough to bend visibly."""
    rng = np.random.default_rng(5)

    def body(mass):
        root = rng.normal(size=(3, 3)) * 0.1
        return RigidBody(
            mass, rng.normal(size=3) * 0.1, root @ root.T + 0.05 * np.eye(3)
        )

    return build(
        [
            RevoluteJoint("turn", (0, 0, 1), stiffness=4e3, damping=20.0),
            body(8.0),
            FixedTranslation((0.2, 0.0, 0.4)),
            RevoluteJoint("tilt", (1, 1, 0), stiffness=6e3, is_virtual=True),
            FixedRotation(rpy_matrix(0.2, -0.4, 0.7)),
            RevoluteJoint("lift", (0, 1, 0), stiffness=5e3, damping=20.0),
            body(5.0),
            FixedTranslation((0.5, 0.0, 0.0)),
            PrismaticJoint("slide", (1, 0, 0.3), stiffness=2e4, damping=50.0),
            body(3.0),
            RevoluteJoint("roll", (1, 0, 0), stiffness=2e3, damping=5.0),
            body(2.0),
            FixedTranslation((0.1, 0.05, -0.2)),
        ],
        name="soft",
    )


@pytest.fixture
def rng():
    return np.random.default_rng(20240817)


def central_difference(function, point, step):
    """Return the derivative of a vector function, one column per coordinate."""
    point = np.asarray(point, dtype=float)
    columns = []
    for shift in np.eye(point.size) * step:
        ahead, behind = function(point + shift), function(point - shift)
        columns.append((np.asarray(ahead) - np.asarray(behind)) / (2 * step))
    return np.stack(columns, axis=-1)


@pytest.fixture(scope="session")
def difference():
    """Central differences."""
    return central_difference
