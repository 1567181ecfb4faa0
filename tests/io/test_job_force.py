import numpy as np
import pytest

from diffmill import JobError, cutting, load_job

PROGRAM = "G21 G17 G90 G94\nG0 X-6 Y5 Z1\nG0 Z-1\nG1 X20 F3000\nG0 Z1\nM2\n"
JOB = """
[cutter]
diameter = "10 mm"
teeth = 2
[spindle]
speed = "8000 rpm"
{force}
[stock]
lower = ["0 mm", "0 mm", "-3 mm"]
upper = ["20 mm", "10 mm", "0 mm"]
spacing = "0.25 mm"
[program]
file = "part.ngc"
[robot]
rigid = true
"""
LINEAR = """[force]
K_tc = "1000 N/mm^2"
K_rc = "300 N/mm^2"
K_ac = "60 N/mm^2"
"""
KIENZLE = """[force]
law = "kienzle"
K_tc11 = "1500 N/mm^2"
K_rc11 = "500 N/mm^2"
K_ac11 = "100 N/mm^2"
m_t = 0.25
"""


@pytest.fixture
def load(tmp_path):
    """Load a job with this table of forces."""

    def load(force, helix=""):
        (tmp_path / "part.ngc").write_text(PROGRAM)
        text = JOB.format(force=force).replace("teeth = 2", f"teeth = 2\n{helix}")
        (tmp_path / "job.toml").write_text(text)
        return load_job(tmp_path / "job.toml")

    return load


def problems_of(load, force):
    with pytest.raises(JobError) as error:
        load(force)
    return error.value.problems


@pytest.mark.parametrize("law", ["", 'law = "linear_edge"\n'])
def test_linear_is_the_default(load, law):
    job = load(LINEAR + law)
    assert isinstance(job.law, cutting.LinearEdgeLaw)
    assert (job.law.K_tc, job.law.K_ae) == (pytest.approx(1e9), 0.0)
    assert job.bottom_law is None
    note, *_ = job.notes
    assert note.startswith("[force.bottom] is left out")


def test_kienzle(load):
    law = load(KIENZLE + 'm_a = 0.1\nK_te = "4 N/mm"\n').law
    assert isinstance(law, cutting.KienzleLaw)
    assert (law.K_tc11, law.K_rc11, law.K_ac11) == pytest.approx((1.5e9, 5e8, 1e8))
    # An exponent that is left out is the tangential one.
    assert (law.m_t, law.m_r, law.m_a) == (0.25, 0.25, 0.1)
    assert law.K_te == pytest.approx(4e3)
    assert law.reference_thickness == 1e-3
    assert law.least_thickness == 1e-6
    law = load(KIENZLE + 'reference_thickness = "1 m"\nleast_thickness = "2 um"\n').law
    assert law.reference_thickness == 1.0
    assert law.least_thickness == pytest.approx(2e-6)


def test_material(load):
    job = load('[force]\nmaterial = "aluminium_3.1325"')
    assert job.law == cutting.material("aluminium_3.1325").law
    note, *_ = job.notes
    assert cutting.material("aluminium_3.1325").source in note
    assert "K_tc 989.8 N/mm^2" in note and "K_te 3 N/mm" in note
    assert "no axial" in load('[force]\nmaterial = "brass_quarter_inch"').notes[0]


@pytest.mark.parametrize(
    ("angle", "sign", "hand"),
    [(30, -1, "right"), (-30, 1, "left"), (0, 1, None)],
)
def test_the_axial_sign_of_a_material_follows_the_hand_of_the_helix(
    load, angle, sign, hand
):
    text = '[force]\nmaterial = "aluminium_7075_t6"'
    table = cutting.material("aluminium_7075_t6").law
    job = load(text, helix=f'helix_angle = "{angle} deg"')
    # A right-hand helix pulls the tool out of its holder, toward the work, along -z.
    assert float(job.law.K_ac) == sign * table.K_ac != 0
    assert float(job.law.K_ae) == sign * table.K_ae != 0
    assert float(job.law.K_tc) == table.K_tc
    notes = [note for note in job.notes if "-hand helix" in note]
    assert len(notes) == (hand is not None)
    assert all(f"{hand}-hand helix" in note for note in notes)
    if sign < 0:
        assert "K_ac = -222 N/mm^2, K_ae = -0.7 N/mm" in notes[0]


def test_signs_that_a_job_states_are_those_of_its_author(load):
    law = load(LINEAR, helix='helix_angle = "30 deg"').law
    assert float(law.K_ac) == float(load(LINEAR).law.K_ac)


def test_coefficients_per_tooth(load):
    law = load(LINEAR.replace('"300 N/mm^2"', '["300 N/mm^2", "0.4 GPa"]')).law
    np.testing.assert_allclose(law.K_rc, [3e8, 4e8])
    law = load(KIENZLE.replace("0.25", "[0.25, 0.3]")).law
    np.testing.assert_allclose(law.m_t, [0.25, 0.3])
    np.testing.assert_allclose(law.m_r, [0.25, 0.3])


def test_bottom(load):
    # Side and bottom may have different laws.
    job = load(LINEAR + KIENZLE.replace("[force]", "[force.bottom]"))
    assert isinstance(job.law, cutting.LinearEdgeLaw)
    assert isinstance(job.bottom_law, cutting.KienzleLaw)
    assert job.bottom_law.K_tc11 == pytest.approx(1.5e9)
    job = load(LINEAR + '[force.bottom]\nmaterial = "aluminium_6082_t6"')
    assert job.bottom_law == cutting.material("aluminium_6082_t6").law
    assert job.notes[0].startswith("[force.bottom] material aluminium_6082_t6")


@pytest.mark.parametrize(
    ("force", "expected"),
    [
        (
            LINEAR + 'material = "aluminium_3.1325"',
            ("[force] material", "together with K_tc, K_rc, K_ac", "not both"),
        ),
        (
            '[force]\nmaterial = "aluminium_3.1325"\nlaw = "linear_edge"',
            ("[force] material", "together with law"),
        ),
        (
            '[force]\nmaterial = "cheese"',
            ("[force] material", "'cheese'", *cutting.materials()),
        ),
        ("[force]\nmaterial = 3", ("[force] material", "3", "text")),
        (
            LINEAR + 'law = "taylor"',
            ("[force] law", "'taylor'", "'linear_edge' or 'kienzle'"),
        ),
        (LINEAR + "law = [1]", ("[force] law", "[1]", "'kienzle'")),
        (
            LINEAR + "m_t = 0.2",
            ("[force] m_t", "unknown key", "K_tc", "material", "bottom"),
        ),
        (
            KIENZLE + 'K_tc = "1 GPa"',
            ("[force] K_tc:", "unknown key", "K_tc11", "material, bottom"),
        ),
        (
            KIENZLE.replace("m_t = 0.25", ""),
            ("[force] m_t", "found nothing", "0.25"),
        ),
        (KIENZLE.replace("0.25", "1.0"), ("[force] m_t", "1.0", "less than 1")),
        (KIENZLE.replace("0.25", "-0.1"), ("[force] m_t", "-0.1", "from 0")),
        (KIENZLE.replace("0.25", "true"), ("[force] m_t", "True", "a number")),
        (KIENZLE.replace("0.25", "[0.2, nan]"), ("[force] m_t", "nan", "a number")),
        (
            KIENZLE + 'least_thickness = "0 mm"',
            ("[force] least_thickness", "'0 mm'", "above 0"),
        ),
        (
            LINEAR.replace('"300 N/mm^2"', '["1 GPa", "2 GPa", "3 GPa"]'),
            ("[force] K_rc", "3 values", "2 teeth"),
        ),
        (LINEAR.replace('"300 N/mm^2"', "[]"), ("[force] K_rc", "an empty list")),
        (
            LINEAR.replace('"300 N/mm^2"', '["1 GPa", "2 N/mm"]'),
            ("[force] K_rc", "'2 N/mm'", "N/mm^2"),
        ),
        (
            LINEAR.replace('"1000 N/mm^2"', '["1 GPa", "-1 GPa"]'),
            ("[force] K_tc", "'-1 GPa'", "above 0"),
        ),
        (
            LINEAR + '[force.bottom]\nK_tc = "1 GPa"\nK_rc = "1 GPa"',
            ("[force.bottom] K_ac", "found nothing"),
        ),
        (
            LINEAR + KIENZLE.replace("[force]", "[force.bottom]") + "bottom = 1",
            ("[force.bottom] bottom", "unknown key"),
        ),
        (
            LINEAR
            + KIENZLE.replace("[force]", "[force.bottom]").replace("0.25", "[0, 0, 0]"),
            ("[force.bottom] m_t", "3 values", "2 teeth"),
        ),
        (LINEAR + "bottom = 3", ("[force.bottom]", "found 3", "a table")),
        ("", ("[force]", "no such table")),
    ],
    ids=lambda value: value[-1] if isinstance(value, tuple) else "",
)
def test_one_fault(load, force, expected):
    (problem,) = problems_of(load, force)
    for part in expected:
        assert part in problem


def test_force_that_is_no_table(load, tmp_path):
    (tmp_path / "part.ngc").write_text(PROGRAM)
    (tmp_path / "job.toml").write_text("force = 3\n" + JOB.format(force=""))
    with pytest.raises(JobError) as error:
        load_job(tmp_path / "job.toml")
    assert error.value.problems == ("[force] found 3, but a table is required",)


def test_faults_of_side_and_bottom_are_both_listed(load):
    force = LINEAR.replace("300 N/mm^2", "300 N") + "[force.bottom]\nmaterial = 'x'"
    side, bottom = problems_of(load, force)
    assert "[force] K_rc" in side
    assert "[force.bottom] material" in bottom
