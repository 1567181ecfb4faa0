import json
import math

import numpy as np
import pytest

from diffmill import JobError, load_job
from small_job import PROGRAM, small_job

MILL = {"diameter": "10 mm", "teeth": 3}


@pytest.fixture
def job_file(tmp_path):
    """Return a function that writes a job with keys of its cutter."""
    (tmp_path / "part.ngc").write_text(PROGRAM)

    def write(**keys):
        lines = [f"{key} = {json.dumps(value)}" for key, value in (MILL | keys).items()]
        (tmp_path / "job.toml").write_text(small_job("\n".join(lines)))
        return tmp_path / "job.toml"

    return write


@pytest.fixture
def cutter_of(job_file):
    return lambda **keys: load_job(job_file(**keys)).cutter


@pytest.fixture
def problems_of(job_file):
    def problems(**keys):
        with pytest.raises(JobError) as error:
            load_job(job_file(**keys))
        return error.value.problems

    return problems


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
        (
            {"pitch": ["-60 deg", "200 deg", "220 deg"]},
            ("pitch", "-60 deg", "above 0"),
        ),
        ({"pitch": "120 deg"}, ("pitch", "'120 deg'", "a list")),
        ({"pitch": ["120 deg", 2, "120 deg"]}, ("pitch", "2", "an angle")),
    ],
)
def test_one_clear_line_for_a_fault(problems_of, keys, expected):
    (problem,) = problems_of(**keys)
    assert problem.startswith(f"[cutter] {expected[0]}")
    for part in expected[1:]:
        assert part in problem


def test_a_fault_elsewhere_does_not_bring_a_second_line(problems_of):
    assert len(problems_of(diameter="-1 mm", kind="bull", corner_radius="1 mm")) == 1
    assert len(problems_of(teeth=0, pitch=["180 deg", "180 deg"])) == 1
