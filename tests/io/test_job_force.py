import numpy as np
import pytest

from diffmill import cutting, load_job
from small_job import SLOT_STOCK, problems_of, write_job

LINEAR = {"K_tc": "1000 N/mm^2", "K_rc": "300 N/mm^2", "K_ac": "60 N/mm^2"}
KIENZLE = {
    "law": "kienzle",
    "K_tc11": "1500 N/mm^2",
    "K_rc11": "500 N/mm^2",
    "K_ac11": "100 N/mm^2",
    "m_t": 0.25,
}


@pytest.fixture
def write(tmp_path):
    """Write a job with this table of forces."""
    return lambda force, cutter={}: write_job(
        tmp_path, SLOT_STOCK, {"force": force}, cutter
    )


@pytest.fixture
def load(write):
    return lambda *tables: load_job(write(*tables))


@pytest.mark.parametrize("law", [{}, {"law": "linear_edge"}])
def test_linear_is_the_default(load, law):
    job = load(LINEAR | law)
    assert isinstance(job.law, cutting.LinearEdgeLaw)
    assert (job.law.K_tc, job.law.K_ae) == (pytest.approx(1e9), 0.0)
    assert job.bottom_law is None
    note, *_ = job.notes
    assert note.startswith("[force.bottom] is left out")


def test_kienzle(load):
    law = load(KIENZLE | {"m_a": 0.1, "K_te": "4 N/mm"}).law
    assert isinstance(law, cutting.KienzleLaw)
    assert (law.K_tc11, law.K_rc11, law.K_ac11) == pytest.approx((1.5e9, 5e8, 1e8))
    # An exponent that is left out is the tangential one.
    assert (law.m_t, law.m_r, law.m_a) == (0.25, 0.25, 0.1)
    assert law.K_te == pytest.approx(4e3)
    assert law.reference_thickness == 1e-3
    assert law.least_thickness == 1e-6
    sizes = {"reference_thickness": "1 m", "least_thickness": "2 um"}
    law = load(KIENZLE | sizes).law
    assert law.reference_thickness == 1.0
    assert law.least_thickness == pytest.approx(2e-6)


def test_material(load):
    job = load({"material": "aluminium_3.1325"})
    assert job.law == cutting.material("aluminium_3.1325").law
    note, *_ = job.notes
    assert cutting.material("aluminium_3.1325").source in note
    assert "K_tc 989.8 N/mm^2" in note and "K_te 3 N/mm" in note
    assert "no axial" in load({"material": "brass_quarter_inch"}).notes[0]


@pytest.mark.parametrize(
    ("angle", "sign", "hand"), [(30, -1, "right"), (-30, 1, "left"), (0, 1, None)]
)
def test_the_axial_sign_of_a_material_follows_the_hand_of_the_helix(
    load, angle, sign, hand
):
    table = cutting.material("aluminium_7075_t6").law
    helix = {"cutter.helix_angle": f"{angle} deg"}
    job = load({"material": "aluminium_7075_t6"}, helix)
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
    law = load(LINEAR, {"cutter.helix_angle": "30 deg"}).law
    assert float(law.K_ac) == float(load(LINEAR).law.K_ac)


def test_coefficients_per_tooth(load):
    law = load(LINEAR | {"K_rc": ["300 N/mm^2", "0.4 GPa"]}).law
    np.testing.assert_allclose(law.K_rc, [3e8, 4e8])
    law = load(KIENZLE | {"m_t": [0.25, 0.3]}).law
    np.testing.assert_allclose(law.m_t, [0.25, 0.3])
    np.testing.assert_allclose(law.m_r, [0.25, 0.3])


def test_bottom(load):
    # Side and bottom may have different laws.
    job = load(LINEAR | {"bottom": KIENZLE})
    assert isinstance(job.law, cutting.LinearEdgeLaw)
    assert isinstance(job.bottom_law, cutting.KienzleLaw)
    assert job.bottom_law.K_tc11 == pytest.approx(1.5e9)
    job = load(LINEAR | {"bottom": {"material": "aluminium_6082_t6"}})
    assert job.bottom_law == cutting.material("aluminium_6082_t6").law
    assert job.notes[0].startswith("[force.bottom] material aluminium_6082_t6")


FAULTS = [
    (
        LINEAR | {"material": "aluminium_3.1325"},
        ("[force] material", "together with K_tc, K_rc, K_ac", "not both"),
    ),
    (
        {"material": "aluminium_3.1325", "law": "linear_edge"},
        ("[force] material", "together with law"),
    ),
    ({}, ("[force]: found nothing", 'material = "NAME"', "K_tc = ")),
    ({"material": "cheese"}, ("[force] material", "'cheese'", *cutting.materials())),
    ({"material": 3}, ("[force] material", "3", "text")),
    (
        LINEAR | {"law": "taylor"},
        ("[force] law", "'taylor'", "'linear_edge' or 'kienzle'"),
    ),
    (LINEAR | {"law": [1]}, ("[force] law", "[1]", "'kienzle'")),
    (
        LINEAR | {"m_t": 0.2},
        ("[force] m_t", "unknown key", "K_tc", "material", "bottom"),
    ),
    (
        KIENZLE | {"K_tc": "1 GPa"},
        ("[force] K_tc:", "unknown key", "K_tc11", "material, bottom"),
    ),
    (
        {key: one for key, one in KIENZLE.items() if key != "m_t"},
        ("[force] m_t", "found nothing", "0.25"),
    ),
    (KIENZLE | {"m_t": 1.0}, ("[force] m_t", "1.0", "less than 1")),
    (KIENZLE | {"m_t": -0.1}, ("[force] m_t", "-0.1", "from 0")),
    (KIENZLE | {"m_t": True}, ("[force] m_t", "True", "a number")),
    (KIENZLE | {"m_t": [0.2, np.nan]}, ("[force] m_t", "nan", "a number")),
    (
        KIENZLE | {"least_thickness": "0 mm"},
        ("[force] least_thickness", "'0 mm'", "above 0"),
    ),
    (
        LINEAR | {"K_rc": ["1 GPa", "2 GPa", "3 GPa"]},
        ("[force] K_rc", "3 values", "2 teeth"),
    ),
    (LINEAR | {"K_rc": []}, ("[force] K_rc", "an empty list")),
    (LINEAR | {"K_rc": ["1 GPa", "2 N/mm"]}, ("[force] K_rc", "'2 N/mm'", "N/mm^2")),
    (LINEAR | {"K_tc": ["1 GPa", "-1 GPa"]}, ("[force] K_tc", "'-1 GPa'", "above 0")),
    (
        LINEAR | {"bottom": {"K_tc": "1 GPa", "K_rc": "1 GPa"}},
        ("[force.bottom] K_ac", "found nothing"),
    ),
    (
        LINEAR | {"bottom": KIENZLE | {"bottom": 1}},
        ("[force.bottom] bottom", "unknown key"),
    ),
    (
        LINEAR | {"bottom": KIENZLE | {"m_t": [0, 0, 0]}},
        ("[force.bottom] m_t", "3 values", "2 teeth"),
    ),
    (LINEAR | {"bottom": 3}, ("[force.bottom]", "found 3", "a table")),
    (None, ("[force]", "no such table")),
    (3, ("[force] found 3, but a table is required",)),
]


@pytest.mark.parametrize(("force", "parts"), FAULTS)
def test_one_fault(write, force, parts):
    (problem,) = problems_of(write(force))
    for part in parts:
        assert part in problem


def test_faults_of_side_and_bottom_are_both_listed(write):
    force = LINEAR | {"K_rc": "300 N", "bottom": {"material": "x"}}
    side, bottom = problems_of(write(force))
    assert "[force] K_rc" in side
    assert "[force.bottom] material" in bottom
