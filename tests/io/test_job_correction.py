"""`[correction]`: objective, weights and bounds as a job file says them."""

import pytest

from diffmill import (
    CorrectionSettings,
    SimulationSettings,
    UncertaintySettings,
    load_job,
)
from diffmill.settings.correction import MethodSettings, SurfaceErrorSettings
from small_job import PROGRAM, problems_of, small_job

LEANING = "time_s,x_mm,y_mm,z_mm,i,j,k\n0,-9,4,9,0,0.6,0.8\n0.1,-8,4,9,0,0.6,0.8\n"
JOINT = 'command = "joint"'
MILL = 'diameter = "10 mm"\nteeth = 2\n'
FLAT, BALL = f'{MILL}kind = "flat"', f'{MILL}kind = "ball"'


@pytest.fixture
def job_file(tmp_path):
    """Return a function that writes a job with lines of its correction."""
    (tmp_path / "part.ngc").write_text(PROGRAM)
    (tmp_path / "leaning.csv").write_text(LEANING)

    def write(*lines, cutter=FLAT, program="part.ngc"):
        more = "\n".join(["[correction]", *lines])
        text = small_job(cutter, program=program, more=more)
        (tmp_path / "job.toml").write_text(text)
        return tmp_path / "job.toml"

    return write


@pytest.fixture
def settings_of(job_file):
    return lambda *lines: load_job(job_file(*lines)).correction


@pytest.fixture
def problems(job_file):
    return lambda *lines, **more: problems_of(job_file(*lines, **more))


def test_what_a_job_leaves_out_is_what_scripts_leave_out(job_file):
    job = load_job(job_file())
    # This one is for programs: a script's command may be anything.
    assert job.correction == CorrectionSettings(acceleration_factor=2.0)
    # These follow from path, machine and cutter.
    own = job.simulation
    sizes = (
        "angles",
        "substeps",
        "element_height",
        "axial_depth",
        "updates_per_period",
    )
    of_job = {name: getattr(own, name) for name in (*sizes, "plunges", "has_bottom")}
    assert own == SimulationSettings(**of_job)
    assert job.output == type(job.output)()


def test_the_tolerance_band_is_the_tolerance_unless_given(settings_of):
    assert settings_of("").tolerance_band == 0
    assert settings_of('tolerance = "10 um"').tolerance_band == pytest.approx(1e-5)
    both = settings_of('tolerance = "10 um"', 'tolerance_band = "20 um"')
    assert both.tolerance_band == pytest.approx(2e-5)
    assert both.tolerance == pytest.approx(1e-5)


def test_values_become_settings_in_si(settings_of):
    settings = settings_of(
        'objective = "surface"',
        'tolerance = "10 um"',
        'max_velocity = "60 mm/s"',
        'max_acceleration = "2 m/s^2"',
        "finishing_only = true",
        "floor_weight = 0",
        'gouge = "20 um"',
        "stay_in_cut = true",
        "uncertainty = { stiffness = 0.2, force = 0.1, draws = 6, "
        'objective = "worst", delay = "5 ms" }',
        "weight = [{ lines = [2, 30], value = 0 }, { lines = [3, 3], value = 2.5 }]",
    )
    assert settings.tolerance == pytest.approx(1e-5)
    assert settings.uncertainty == UncertaintySettings(
        stiffness=0.2, force=0.1, draws=6, objective="worst", delay=5e-3
    )
    assert (settings.gouge, settings.stay_in_cut) == (pytest.approx(2e-5), True)
    assert settings.max_velocity == pytest.approx(0.06)
    assert settings.max_acceleration == pytest.approx(2.0)
    assert settings.sections == ((2, 30, 0.0), (3, 3, 2.5))
    assert settings.objective == SurfaceErrorSettings(floor_weight=0.0)
    assert settings.finishing_only


def test_defaults(settings_of):
    settings = settings_of()
    assert settings.gouge == settings.max_acceleration == float("inf")
    assert (settings.max_steps, settings.uncertainty, settings.sections) == (
        2,
        None,
        (),
    )
    assert settings_of('method = "adam"').max_steps == 60
    assert settings_of('method = "adam"', "max_steps = 7").max_steps == 7


def test_a_weight_of_the_surface_has_no_effect_on_the_path(job_file):
    job = load_job(job_file("wall_weight = 0.5"))
    assert job.correction.objective.name == "path"
    (note,) = [note for note in job.notes if "wall_weight" in note]
    assert note.endswith('works with objective = "surface" only')


def test_a_section_without_moves_is_refused(problems):
    """The program begins at line 2, and goes from there in line 3."""
    weight = "weight = [{{ lines = [{}, {}], value = 0 }}]"
    for first, last in ((500, 600), (1, 2), (5, 2)):
        (found,) = problems(weight.format(first, last))
        assert found.startswith("[correction] weight.lines: found")
        assert f"[{first}, {last}]" in found and found.endswith("of lines 3 to 3")
    (found,) = problems(weight.format(4, 9), program="leaning.csv")
    assert found.endswith("of lines 2 to 3")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('tolerance = "-1 um"', ("tolerance", "at least 0")),
        ("weight = [{ lines = [1, 2], value = -1 }]", ("weight.0.value", "at least 0")),
        ("weight = [{ lines = [1], value = 1 }]", ("weight.0.lines", "2 values")),
        ("weight = [{ value = 1 }]", ("weight.0.lines", "first and last line")),
        ("uncertainty = { force = 1 }", ("uncertainty.force", "less than 1")),
        ('uncertainty = { delay = "-1 ms" }', ("uncertainty.delay", "at least 0")),
        ('objective = "both"', ("objective", "'surface'")),
        ("finishing_only = 1", ("finishing_only", "true or false")),
    ],
)
def test_faults_are_named(problems, line, words):
    (problem,) = problems(line)
    assert all(word in problem for word in words), problem


def test_a_new_optimiser_holds_what_it_says(problems, settings_of, monkeypatch):
    monkeypatch.setattr(MethodSettings, "members", dict(MethodSettings.members))

    class Searching(MethodSettings, name="searching"):
        is_optimiser = True

    keys = 'method = "searching"', "horizon = 900", 'gouge = "20 um"'
    whole, limited = problems(*keys)
    assert 'horizon: found 900 beside method = "searching"' in whole
    assert limited.endswith('it works with method = "gauss_newton" only')
    Searching.needs_whole_path, Searching.holds_limits = False, True
    assert settings_of(*keys).gouge == pytest.approx(20e-6)
    (limited,) = problems('method = "adam"', 'gouge = "20 um"')
    assert limited.endswith('method = "gauss_newton" or "searching" only')


def test_what_the_cutter_does_not_allow(problems):
    keys = lambda lines: [line.split()[1] for line in lines]
    surface = 'objective = "surface"'
    weights = ("wall_weight = 0", "floor_weight = 0")
    backwards = "weight = [{ lines = [5, 2], value = 1 }]"
    found = problems(surface, *weights, backwards, cutter=BALL)
    assert keys(found) == ["objective:", "wall_weight:", "weight.lines:"]
    limited = problems('max_velocity = "1 m/s"', 'method = "mirror"', JOINT)
    assert ["method" in line for line in limited] == [True, False]
    assert JOINT in limited[1]
    bounds = ('gouge = "20 um"', "stay_in_cut = true", "horizon = 900")
    found = problems(*bounds, 'method = "adam"', cutter=BALL)
    assert keys(found) == ["horizon:", *2 * ["gouge:", "stay_in_cut:"]]
    assert 'method = "adam"' in found[-1]
    static = ("horizon = 900", "[simulation]", 'mode = "quasistatic"')
    (found,) = problems(*static)
    assert found.startswith("[correction] horizon: found 900 beside [simulation] mode")
    (found,) = problems(surface, program="leaning.csv")
    assert "flat cutter" in found
