import math

import numpy as np
import pytest

from diffmill import load_job
from small_job import PROGRAM, problems_of, write_job


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a job with keys of its cutter."""

    def write(**keys):
        changes = {f"cutter.{key}": value for key, value in keys.items()}
        return write_job(tmp_path, {"cutter.teeth": 3}, changes, program=PROGRAM)

    return write


@pytest.fixture
def cutter_of(write):
    return lambda **keys: load_job(write(**keys)).cutter


def test_kinds(cutter_of):
    assert cutter_of().kind == "flat" and cutter_of().is_plain
    ball = cutter_of(kind="ball", helix_angle="30 deg", flute_length="12 mm")
    assert ball.kind == "ball" and ball.corner_radius == pytest.approx(5e-3)
    assert ball.helix_angle == pytest.approx(math.pi / 6)
    assert ball.flute_length == pytest.approx(12e-3)
    bull = cutter_of(kind="bull", corner_radius="1.5 mm")
    assert bull.kind == "bull" and bull.corner_radius == pytest.approx(1.5e-3)


def test_runout_and_pitch(cutter_of):
    tool = cutter_of(
        runout="8 um", runout_angle="90 deg", pitch=["110 deg", "120 deg", "130 deg"]
    )
    assert tool.runout == pytest.approx(8e-6) and not tool.is_plain
    assert tool.runout_angle == pytest.approx(math.pi / 2)
    np.testing.assert_allclose(tool.pitch_angles, np.radians([0, 110, 230]))


def test_rounded_angles_between_teeth_are_even(cutter_of):
    tool = cutter_of(teeth=7, pitch=["51.4286 deg"] * 7)
    assert tool.has_even_pitch


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"kind": "bull"}, ("corner_radius", "found nothing", '"1 mm"')),
        (
            {"kind": "bull", "corner_radius": "5 mm"},
            ("corner_radius", "5 mm", "less than half", '"ball"'),
        ),
        (
            {"kind": "bull", "corner_radius": "0 mm"},
            ("corner_radius", "'0 mm'", "above 0"),
        ),
        ({"corner_radius": "1 mm"}, ("corner_radius", "'flat'", '"bull"')),
        (
            {"kind": "ball", "corner_radius": "1 mm"},
            ("corner_radius", "'ball'", '"bull"'),
        ),
        ({"runout": "-1 um"}, ("runout", "'-1 um'", "at least 0")),
        ({"runout": "5 mm"}, ("runout", "5 mm", "half the diameter")),
        ({"runout_angle": 30}, ("runout_angle", "30", "an angle")),
        ({"dish_angle": "30 deg"}, ("dish_angle", "30 deg", "from 0 deg to 20 deg")),
        ({"dish_angle": "-1 deg"}, ("dish_angle", "-1 deg", "from 0 deg to 20 deg")),
        (
            {"kind": "ball", "dish_angle": "2 deg"},
            ("dish_angle", "2 deg", "'ball' is not hollow"),
        ),
        ({"pitch": ["180 deg", "180 deg"]}, ("pitch", "2 angles", "3 are required")),
        ({"pitch": ["100 deg"] * 3}, ("pitch", "300 deg", "360 deg")),
        ({"pitch": ["-60 deg", "200 deg", "220 deg"]}, ("pitch", "-60 deg", "above 0")),
        ({"pitch": "120 deg"}, ("pitch", "'120 deg'", "a list")),
        ({"pitch": ["120 deg", 2, "120 deg"]}, ("pitch", "2", "an angle")),
    ],
)
def test_one_clear_line_for_a_fault(write, keys, expected):
    (problem,) = problems_of(write(**keys))
    assert problem.startswith(f"[cutter] {expected[0]}")
    for part in expected[1:]:
        assert part in problem


def test_a_fault_elsewhere_does_not_bring_a_second_line(write):
    bull = write(diameter="-1 mm", kind="bull", corner_radius="1 mm")
    assert len(problems_of(bull)) == 1
    assert len(problems_of(write(teeth=0, pitch=["180 deg", "180 deg"]))) == 1
