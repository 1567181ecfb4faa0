"""`diffmill identify`: what it prints, writes and refuses."""

import dataclasses
import json
import math
import pathlib
import re
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.io
import xarray
from joint_motions import Joint, save_joint
from scipy.spatial.transform import Rotation
from slides_job import JOB, with_machine, write_slides_job
from slot_force import SPEED, K, mean_of_slots, slot_force
from vibrations import receptance, ring_down

from diffmill import config, cutter as ct, identification, load_job, robot as rb, viz
from diffmill.cli import main
from diffmill.cutting import KienzleLaw, LinearEdgeLaw
from diffmill.units import (
    ANGLE,
    FREQUENCY,
    LENGTH,
    LINEAR_STIFFNESS,
    MOMENT,
    ROTARY_STIFFNESS,
    quantity,
)
from small_job import arm_text, body, slide

MEANS = """kind = "mean_forces"
[cutter]
diameter = "10 mm"
teeth = 2
[cut]
axial_depth = "3 mm"
[means]
file = "means.csv"
"""
# Two slides: about each everything is known.
RANGE = {"lower": "-1 m", "upper": "1 m"}
SLIDES = arm_text(
    slide("x", 0, **RANGE, stiffness="4 N/um", damping="400 N*s/m"),
    slide("y", 1, **RANGE, stiffness="9 N/um", damping="900 N*s/m"),
    body("100 kg"),
    name="slides",
)


# An axis whose body swings about it.
AXIS = """name = "axis"
[[elements]]
kind = "revolute"
name = "joint_1"
[[elements]]
kind = "body"
mass = "100 kg"
center_of_mass = ["1 m", "0 m", "0 m"]
inertia = ["1 kg*m^2", "1 kg*m^2", "1 kg*m^2"]
"""


@pytest.fixture
def folder(here):
    (here / "slides.toml").write_text(SLIDES)
    return here


@pytest.fixture
def run(folder, capsys):
    """Return a function that runs a command on a file and returns what it prints."""

    def run(name, text=None, *, command="identify", code=0):
        if text is not None:
            (folder / name).write_text(text)
        assert main([command, name]) == code
        said = capsys.readouterr()
        if command == "identify" and code == 0:
            check_page(folder / f"{pathlib.Path(name).stem}-identify")
        return said.err if code == 2 else said.out

    return run


def check_page(out):
    """Check that a report has every figure, value and section."""
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("<img ") == len(drawn(out))
    for title in ("What was asked", "Estimates", "Assumptions"):
        assert f"<h2>{title}</h2>" in page
    assert "<figcaption><b>" in page and ".</b> </figcaption>" not in page
    assert len(page) < 3e6
    # What no measurement shows has no number.
    cells = re.findall(r'<td data-label="value">(.*?)</td>', page)
    assert cells and all(x == "-" or math.isfinite(float(x)) for x in cells)


def page_row(out, name):
    """Return the cells behind the name of an estimate."""
    page = (out / "report.html").read_text(encoding="utf-8")
    row = page.split(f'<td data-label="quantity">{name}</td>')[1].split("</tr>")[0]
    return re.findall(r"<td[^>]*>(.*?)</td>", row)


def flat(text):
    """Return a text without its line breaks."""
    return " ".join(text.split())


def results(folder, name):
    out = folder / f"{name}-identify"
    facts = json.loads((out / "identified.json").read_text())
    return out, facts, tomllib.loads((out / "identified.toml").read_text())


def save(file, head, *columns):
    """Write columns, or rows of several, below the names in a head."""
    cells = np.column_stack(columns)
    np.savetxt(file, cells, delimiter=",", header=head, comments="")


def noisy(force, draw=None):
    """Return a force with noise of a twentieth of its root mean square."""
    draw = np.random.default_rng(0) if draw is None else draw
    size = 0.05 * np.sqrt(np.mean(force**2))
    return force + size * draw.normal(size=force.shape)


def slots(folder, time, feeds, change=lambda force, i: force):
    """Write records of slots at some feeds, each changed; return their entries."""
    made = (change(slot_force(time, feed), i) for i, feed in enumerate(feeds))
    return "".join(
        record(folder, f"slot{i}.txt", time, force, feed)
        for i, (force, feed) in enumerate(zip(made, feeds, strict=True))
    )


def record(folder, name, time, force, feed, head="time_s,Fx_N,Fy_N,Fz_N"):
    """Write a record of a slot; return the entry that names it."""
    save(folder / name, head, time, force)
    return f'[[record]]\nfile = "{name}"\nfeed_per_tooth = "{1e3 * feed} mm"\n'


def drawn(out):
    return {file.stem for file in out.glob("*.png")}


def write_means(folder):
    feeds = np.array([0.05e-3, 0.1e-3, 0.15e-3, 0.2e-3])
    force = mean_of_slots(feeds, 3e-3)
    force = force + 0.3 * np.random.default_rng(0).normal(size=force.shape)
    # The dynamometer is turned: its x is y of the feed.
    save(folder / "means.csv", "fz_mm,Fx_N,Fy_N,Fz_N", 1e3 * feeds, force[:, [1, 0, 2]])


TURNED = MEANS + '[fit]\naxes = ["y", "x", "z"]\n'


def test_means_are_fitted_and_axes_are_proposed_not_changed(folder, run):
    write_means(folder)
    text = run("means.toml", MEANS)
    assert 'The axes ["y", "x", "z"] make more sense' in text
    assert "Nothing was changed" in text
    out, facts, toml = results(folder, "means")
    assert facts["axes"] == ["x", "y", "z"] and toml == {}
    printed = run("turned.toml", TURNED)
    assert "make more sense" not in printed
    # Student's t of two degrees of freedom, from a printed table.
    assert "within 4.3 standard errors: 4 feeds leave 2 degrees" in printed
    out, facts, toml = results(folder, "turned")
    for name, value in zip(LinearEdgeLaw.NAMES, K, strict=True):
        assert abs(facts["coefficients_SI"][name] / value - 1) < 0.05
        error = facts["coefficients_SI"][name] - value
        assert abs(error) < 4 * facts["standard_errors_SI"][name]
    assert toml["force"]["K_tc"].endswith("N/mm^2")
    check_digits(toml["force"], facts, out)
    assert 0 < toml["correction"]["uncertainty"]["force"] < 0.05
    assert drawn(out) == {"mean_forces", "correlation"}
    assert (out / "summary.txt").is_file()


def check_digits(force, facts, out):
    """Check that coefficients have as many digits as their standard errors allow."""
    text = (out / "identified.toml").read_text()
    for name, given in force.items():
        number, unit = given.split()
        scale = 1e-6 if unit == "N/mm^2" else 1e-3
        error = scale * facts["standard_errors_SI"][name]
        decimals = len(number.partition(".")[2])
        # Two digits of the error, and no more.
        assert decimals == max(0, 1 - int(f"{error:.1e}".partition("e")[2]))
        rounded = round(scale * facts["coefficients_SI"][name], decimals)
        assert float(number) == pytest.approx(rounded, abs=1.1 * 10**-decimals)
        (line,) = [x for x in text.splitlines() if x.startswith(f"{name} = ")]
        assert float(line.split("+- ")[1]) == pytest.approx(error, rel=0.06)


def test_forces_on_the_workpiece_are_reversed_and_said(folder, run):
    """A dynamometer below the part gives the coefficients of the force on the tool."""
    write_means(folder)
    rows = np.loadtxt(folder / "means.csv", delimiter=",", skiprows=1)
    save(folder / "means.csv", "fz_mm,Fx_N,Fy_N,Fz_N", rows * [1, -1, -1, -1])
    said = flat(run("below.toml", TURNED + 'force_on = "workpiece"\n'))
    assert "the recorded force, on the workpiece, was reversed first" in said
    _, facts, toml = results(folder, "below")
    assert facts["force_on"] == "workpiece" and "K_tc" in toml["force"]
    assert facts["coefficients_SI"]["K_tc"] == pytest.approx(K[0], rel=0.05)
    # As recorded the summary names the way to say so.
    said = flat(run("plain.toml", TURNED))
    assert 'force_on = "workpiece"' in said and results(folder, "plain")[2] == {}


def test_what_is_found_is_kept_where_no_figure_can_be_drawn(
    folder, capsys, monkeypatch
):
    def fails(figure, file):
        raise RuntimeError("no font")

    write_means(folder)
    (folder / "means.toml").write_text(TURNED)
    monkeypatch.setattr(viz, "save_figure", fails)
    assert main(["identify", "means.toml"]) == 1
    said = capsys.readouterr()
    assert "K_tc" in said.out and "no font" in said.err
    assert "K_tc" in results(folder, "means")[2]["force"]


def test_means_that_other_axes_suit_better_are_comments(folder, run):
    """A mirrored Fx of a slot turns the radial coefficients about, not K_tc."""
    write_means(folder)
    assert "make more sense" in run("mirror.toml", TURNED.replace('"y"', '"-y"'))
    out, facts, toml = results(folder, "mirror")
    found = facts["coefficients_SI"]
    assert found["K_tc"] > 0 > found["K_rc"] and toml == {}
    assert '# K_rc = "-' in (out / "identified.toml").read_text()


LINES = 10.0 + 0.25 * np.arange(81)
# One mode of 2 N/um at 20 Hz.
RECEPTANCE = receptance(LINES, [(20.0, 0.03, 2e6)])


@pytest.mark.parametrize("form", ["uff", "mat"])
def test_complex_responses_are_read_and_a_wrong_phase_is_named(folder, capsys, form):
    """As a function of a universal file, and as a vector."""
    f = LINES
    H = RECEPTANCE * (1 + 0.002 * np.random.default_rng(0).normal(size=f.size))

    def identified(response, name):
        if form == "mat":
            content = {"freq": f[None], "FRF_xx": response[None]}
            scipy.io.savemat(folder / f"{name}.mat", content)
        else:
            (folder / f"{name}.uff").write_text(universal(f, response))
        (folder / f"{name}.toml").write_text(
            'kind = "frequency_response"\n[[frequency_response]]\n'
            f'file = "{name}.{form}"\ndirection = [1, 0, 0]\n'
        )
        code = main(["identify", f"{name}.toml"])
        said = capsys.readouterr()
        return code, flat(said.out + said.err)

    code, said = identified(H, "right")
    assert code == 0 and "wrong sign" not in said
    (mode,) = results(folder, "right")[2]["machine"]["modes"]
    assert quantity(mode["stiffness"], LINEAR_STIFFNESS) == pytest.approx(2e6, rel=0.01)
    assert quantity(mode["frequency"], FREQUENCY) == pytest.approx(20, rel=1e-3)
    code, said = identified(np.conj(H), "conjugate")
    assert code == 2 and "The phase has the wrong sign" in said
    code, said = identified(-H, "reversed")
    assert code == 0 and "The response has the wrong sign" in said
    assert results(folder, "reversed")[2] == {}


def universal(frequency, response):
    """Return a universal file of a receptance at point 1 in x, dataset 58."""
    step = frequency[1] - frequency[0]
    head = [
        *["    -1", "    58", "tip", *["NONE"] * 4],
        f"{4:5d}{0:10d}{0:5d}{0:10d}" + 2 * f" {'NONE':10}{1:10d}{1:4d}",
        f"{5:10d}{frequency.size:10d}{1:10d}{frequency[0]:13.5e}{step:13.5e}{0.0:13.5e}",
        *[
            f"{kind:10d}{0:5d}{0:5d}{0:5d} {'NONE':20} {'NONE':20}"
            for kind in (18, 8, 13, 0)
        ],
    ]
    flat = np.column_stack([response.real, response.imag]).reshape(-1, 6)
    # Numbers of fixed width may leave no blank before a minus.
    rows = ["".join(f"{value:13.5e}" for value in row) for row in flat]
    return "\n".join([*head, *rows, "    -1"]) + "\n"


def test_means_that_no_material_has_are_comments(folder, run):
    write_means(folder)
    units = 'units = { force = "mN" }\n[fit]'
    said = flat(run("unit.toml", TURNED.replace("[fit]", units)))
    assert "no material that is known lies" in said
    out, facts, toml = results(folder, "unit")
    assert [one["code"] for one in facts["diagnoses"]] == ["implausible_pressure"]
    assert toml == {}
    text = (out / "identified.toml").read_text()
    assert "# No known material has this K_tc" in text


def write_loads(folder, count=8, noise=0.01, move_unit="um"):
    """Write load tests of the slides."""
    draw = np.random.default_rng(0)
    force = draw.uniform(100, 300, (count, 3))
    moved = force / np.array([4.0, 9.0, np.inf])[None]
    moved[:, :2] *= 1 + noise * draw.normal(size=(count, 2))
    if count > 4:
        moved[4] *= -1
    head = "x [mm],y [mm],Fx [N],Fy [N],Fz [N],"
    head += ",".join(f"d{a} [{move_unit}]" for a in "xyz")
    save(folder / "loads.csv", head, np.zeros((count, 2)), force, moved)


LOADS = """kind = "load_tests"
[robot]
file = "slides.toml"
[load_tests]
file = "loads.csv"
"""


def test_load_tests_give_springs_and_name_gross_errors(folder, run):
    write_loads(folder)
    said = run("loads.toml", LOADS)
    assert "Rows 5 of the table contradict the others" in said
    out, facts, toml = results(folder, "loads")
    np.testing.assert_allclose(facts["stiffness_SI"], [4e6, 9e6], rtol=0.02)
    assert facts["outlier_rows"] == [5] and facts["left_out_error"] < 0.05
    assert len(toml["robot"]["joint_stiffness"]) == 2
    assert toml["correction"]["uncertainty"]["gaussian"] is True
    value, error, interval, unit, *_ = page_row(out, "x")
    assert float(value) == pytest.approx(facts["stiffness_SI"][0], rel=1e-3)
    assert float(error) == pytest.approx(facts["standard_errors_SI"][0], rel=0.06)
    low, high = map(float, interval.split(" to "))
    assert high - low == pytest.approx(2 * 1.96 * float(error), rel=0.06)
    assert unit == "N/m"
    page = (out / "report.html").read_text()
    assert "Rows 5 of the table contradict" in page.split('id="warnings"')[1]
    assert drawn(out) == {"stiffness", "residual", "left_out", "correlation"}


def test_springs_far_from_the_model_are_comments(folder, run):
    """All a thousand times too stiff: the displacements were micrometres."""
    write_loads(folder, move_unit="nm")
    said = flat(run("loads.toml", LOADS))
    assert "about 1e+03 times the model's stiffness" in said
    out, facts, toml = results(folder, "loads")
    assert toml == {} and all(facts["identifiable"])
    assert "<b>Not to be used.</b>" in (out / "report.html").read_text()
    assert "# joint_stiffness = [" in (out / "identified.toml").read_text()


def test_tests_that_moved_nothing_are_refused(folder, run):
    write_loads(folder)
    head, *rows = (folder / "loads.csv").read_text().splitlines()
    still = [",".join([*row.split(",")[:5], "0,0,0"]) for row in rows]
    (folder / "loads.csv").write_text("\n".join([head, *still]))
    said = run("loads.toml", LOADS, code=2)
    assert "loads: Argument `displacement` must differ" in said


def test_too_few_tests_are_not_called_those_of_another_robot(folder, run):
    write_loads(folder, count=2, noise=0.4)
    run("loads.toml", LOADS)
    out, facts, _ = results(folder, "loads")
    assert facts["is_consistent"] and not all(facts["identifiable"])
    text = (out / "identified.toml").read_text()
    assert "does not suit the robot" not in text


def test_tests_that_leave_no_scatter_say_so(folder, run):
    write_loads(folder, count=1)
    said = flat(run("loads.toml", LOADS + 'channels = { dz = "none" }\n'))
    assert "its scatter is not known" in said and "inf um" not in said
    assert "load tests that would help most" in said
    assert "No force at this tool turns" not in said
    # No other row predicts the only one.
    assert "left out: nothing" in said
    out, facts, _ = results(folder, "loads")
    assert facts["left_out_error"] is None
    assert not (out / "left_out.png").exists()


def test_an_uncertainty_tells_what_it_leaves_out(folder, run):
    """No load along y: its spring is as in the model, and how sure that is nobody."""
    write_loads(folder)
    run("loads.toml", LOADS + 'channels = { Fy = "none", dy = "none" }\n')
    out, facts, toml = results(folder, "loads")
    assert facts["identifiable"] == [True, False]
    assert 0 < toml["correction"]["uncertainty"]["stiffness"] < 0.1
    assert "# without the error of y: as in" in (out / "identified.toml").read_text()


@pytest.mark.parametrize("noise", [0.01, 0.15])
def test_modes_give_dampers(folder, run, noise):
    """As comments where noise hides what the modes explain."""
    # sqrt(K / m) = 200 and 300 rad/s; D / (2 sqrt(K m)) = 1 % and 1.5 %.
    time = np.arange(0, 1, 5e-4)
    modes = ((100 / np.pi, 0.01, 1.0), (150 / np.pi, 0.015, 0.5))
    signal = ring_down(time, modes)
    draw, text = np.random.default_rng(0), ""
    for name in ("first.txt", "second.txt"):
        noisy = signal + noise * draw.normal(size=time.size)
        rows = "\n".join(f"{t:.4f}\t{v:.6f}" for t, v in zip(time, noisy, strict=True))
        (folder / name).write_text("blow 1\nt\ta\n[s]\t[m/s^2]\n" + rows)
        text += f'[[ring_down]]\nfile = "{name}"\nmodes = 2\n'
        text += 'joint_positions = ["0 mm", "0 mm"]\n'
    said = run(
        "ring.toml", f'kind = "ring_down"\n[robot]\nfile = "slides.toml"\n{text}'
    )
    out, facts, toml = results(folder, "ring")
    found = facts["measured"][0]
    if noise > 0.1:
        assert found["explained"] < 0.9 and toml == {}
        assert "# joint_damping" in (out / "identified.toml").read_text()
        return
    assert "joint_damping" in toml["robot"]
    np.testing.assert_allclose(
        found["frequencies_Hz"], [f for f, *_ in modes], rtol=1e-3
    )
    np.testing.assert_allclose(found["damping_ratios"], [0.01, 0.015], rtol=0.05)
    names = {f"{x}_{i}" for x in ("ring_down", "correlation") for i in (1, 2)}
    names |= {"damping", "damping_correlation"}
    assert drawn(out) == names and "joint dampers" in said


@pytest.mark.slow
def test_a_hammer_test_gives_the_machine_of_a_job(folder, run):
    shapes = np.array([[0.2, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.3, 0.0]])
    ratios = np.array([0.02, 0.04, 0.03])
    machine = rb.TipModes(np.array([60.0, 200.0, 90.0]), ratios, shapes)
    lines = np.arange(20.0, 400.0, 0.5)
    truth = np.asarray(machine.receptance(lines))
    random = np.random.default_rng(0)
    text = 'kind = "frequency_response"\n'
    for axis, count in ((0, 2), (1, 1)):
        H = truth[:, axis, axis]
        noise = random.normal(size=(2, H.size)) * 2e-3 * np.abs(H).max()
        H = H + noise[0] + 1j * noise[1]
        save(folder / f"{axis}.csv", "frequency_Hz,real,imag", lines, H.real, H.imag)
        text += (
            f'[[frequency_response]]\nfile = "{axis}.csv"\nmodes = {count}\n'
            f'units = {{ response = "m/N" }}\n'
            f"direction = {[float(k == axis) for k in range(3)]}\n"
        )
    run("hammer.toml", text)
    file = write_slides_job(folder)
    named = '[machine]\nfile = "hammer-identify/identified.toml"\n'
    file.write_text(with_machine(JOB, named))
    modes = load_job(file).modes
    assert modes is not None
    found = np.asarray(modes.receptance(lines))
    assert np.abs(found - truth).max() < 0.01 * np.abs(truth).max()


TIP = 'kind = "frequency_response"\n[[frequency_response]]\nfile = "tip.csv"\n'


def test_modes_that_explain_little_are_comments(folder, run):
    """Degrees that the file calls radians."""
    f = np.arange(2.0, 60.0, 0.25)
    H = receptance(f, [(20.0, 0.03, 1e6)])
    head = "frequency_Hz,mag [m/N],phase_rad"
    save(folder / "tip.csv", head, f, np.abs(H), np.angle(H, deg=True))
    run("tip.toml", f"{TIP}direction = [1, 0, 0]\n")
    out, facts, toml = results(folder, "tip")
    assert facts["measured"][0]["explained"] < 0.9 and toml == {}
    assert "# [[machine.modes]]" in (out / "identified.toml").read_text()


@pytest.fixture
def identified(tmp_path, monkeypatch):
    """Return the folder of results of a coupled fit, of a job and what it found."""

    def identified(file, fitted):
        job = load_job(file)
        time = np.arange(80) * float(job.tooth_period)
        wave = np.column_stack([np.sin(20 * time), np.cos(20 * time), 0 * time])
        wave[:2] = np.nan
        study = identification.CoupledStudy(
            "run", job, time, 100 * wave, 1e-4 * wave, None, False, False, "huber", ()
        )
        count = len(fitted)
        fit = identification.CoupledStudy.Fit(
            parameters=fitted,
            standard_errors={name: 0.01 * value for name, value in fitted.items()},
            correlation=np.eye(count),
            covariance=1e-4 * np.eye(count),
            identifiable=dict.fromkeys(fitted, True),
            log_scale=np.full(count, math.log(1.1)),
            explained={"force": 0.99, "deviation": 0.98},
            residual_rms={"force": 1.0, "deviation": 1e-6},
            residual={"force": 5 * wave, "deviation": 1e-6 * wave},
            offset=None,
            time_shift=0.0,
            time_shift_error=0.0,
            has_converged=True,
            simulations=3,
            is_explained=True,
            notes=(),
            job=job,
        )
        monkeypatch.setattr(config, "load_identification", lambda *_, **__: study)
        monkeypatch.setattr(identification.CoupledStudy, "run", lambda *_: fit)
        out = tmp_path / "out"
        assert main(["identify", str(file), "--out", str(out)]) == 0
        return out

    return identified


def test_a_coupled_fit_is_told_and_drawn_beside_its_record(tmp_path, identified):
    """Half of the coefficients would be no law: the job's stand beside the fitted."""
    file = write_slides_job(tmp_path)
    job = load_job(file)
    law = {name: float(getattr(job.law, name)) for name in LinearEdgeLaw.NAMES}
    out = identified(file, {n: 1.1 * law[n] for n in ("K_tc", "K_rc", "K_ac")})
    text = (out / "identified.toml").read_text()
    found = tomllib.loads(text)["force"]
    assert set(found) == set(LinearEdgeLaw.NAMES)
    tc, te = (float(found[name].split()[0]) for name in ("K_tc", "K_te"))
    # The fitted has two digits of its error of 1 %; the job's has its own.
    assert tc == pytest.approx(1.1e-6 * law["K_tc"], rel=6e-4)
    assert len(found["K_tc"].split()[0].replace(".", "")) <= 4
    assert te == pytest.approx(1e-3 * law["K_te"], rel=1e-5)
    assert text.count("# as in the job") == 3
    assert drawn(out) == {"force", "deviation", "correlation"}


def test_a_coupled_fit_is_written_as_its_job_takes_it(tmp_path, identified):
    """By the names of its law, and without the joint springs that a tool adds."""
    law = """law = "kienzle"
K_tc11 = "1500 N/mm^2"
K_rc11 = "500 N/mm^2"
K_ac11 = "100 N/mm^2"
m_t = 0.25
reference_thickness = "0.5 mm"
"""
    file = write_slides_job(tmp_path)
    text = file.read_text()
    i, j = text.index("K_tc"), text.index("[stock]")
    text = f"{text[:i]}{law}{text[j:]}"
    tool = '[robot.bending_tool]\noverhang = "40 mm"\nyoung_modulus = "600 GPa"\n'
    file.write_text(text.replace("[simulation]", f"{tool}[simulation]"))
    names = ("K x", "K tool_x", "D tool_y", "K_tc11", "m_t")
    fitted = dict(zip(names, (2e6, 3e5, 2.0, 1.65e9, 0.3), strict=True))
    text = (identified(file, fitted) / "identified.toml").read_text()
    found = tomllib.loads(text)
    assert len(found["robot"]["joint_stiffness"]) == 3
    assert "joint_damping" not in found["robot"]
    assert "# K tool_x, D tool_y: see summary.txt" in text
    assert found["force"]["m_t"] == 0.3
    # The snippet is one for the job that it comes from.
    springs = {"robot.joint_stiffness": found["robot"]["joint_stiffness"]}
    job = load_job(file, changes={"force": found["force"]} | springs)
    assert isinstance(job.law, KienzleLaw) and job.robot is not None
    assert float(job.law.K_tc11) == pytest.approx(1.65e9)
    assert float(job.law.m_r) == pytest.approx(0.25)
    assert float(job.law.reference_thickness) == pytest.approx(0.5e-3)
    assert float(job.robot.joint_stiffness[0]) == pytest.approx(2e6)


def test_what_is_wrong_is_said_once_and_nothing_is_written(folder, run, capsys):
    error = run("bad.toml", 'kind = "mean_forces"\n[cutter]\nteeth = 0\n', code=2)
    for part in ("diameter", "teeth", "[cut]: found no such table"):
        assert part in error
    assert not (folder / "bad-identify").exists()
    error = run("job.toml", '[program]\nfile = "a.ngc"\n', code=2)
    assert "give the file of its measured forces after it" in error
    assert main(["identify", "job.toml", "none.csv"]) == 2
    assert "found no file none.csv" in capsys.readouterr().err


SLOTS = """kind = "force_records"
[cutter]
diameter = "10 mm"
teeth = 2
helix_angle = "30 deg"
[spindle]
speed = "6000 rpm"
[cut]
axial_depth = "2 mm"
"""


def write_records(folder):
    """Write a slot in the formats of four laboratory programs, with a tacho in one."""
    nptdms = pytest.importorskip("nptdms")
    draw, text = np.random.default_rng(0), SLOTS
    for i, suffix in enumerate(("tdms", "mat", "nc", "txt")):
        time, feed = np.arange(0, 0.09, 1e-4), (0.08e-3, 0.16e-3)[i % 2]
        force = noisy(slot_force(time + 3e-4 * i, feed), draw)
        # The dynamometer's own vibration, far above the teeth.
        force += 60 * np.sin(2 * np.pi * 3100 * time)[:, None]
        columns = dict(zip(("Fx", "Fy", "Fz"), force.T, strict=True))
        file, more = folder / f"slot{i}.{suffix}", ""
        if suffix == "tdms":
            pulse = np.mod(SPEED * time - np.deg2rad(30), 2 * np.pi) < 0.5
            names = {**columns, "Tacho": pulse.astype(float)}
            facts = {"unit_string": "N", "wf_increment": 1e-4}
            with nptdms.TdmsWriter(file) as writer:
                writer.write_segment(
                    [nptdms.ChannelObject("Cut", k, v, facts) for k, v in names.items()]
                )
            more = "pulses_per_turn = 1\n"
        elif suffix == "mat":
            scipy.io.savemat(file, {"time_ms": 1e3 * time, **columns})
        elif suffix == "nc":
            variables = {k: ("t", v / 1e3, {"units": "kN"}) for k, v in columns.items()}
            clock = {"time": ("t", time, {"units": "s"})}
            xarray.Dataset(variables, clock).to_netcdf(file)
        else:
            head = (
                "DynoWare\nSampling rate [Hz]:\t10000\nTime\tFx\tFy\tFz\ns\tN\tN\tN\n"
            )
            rows = [
                "\t".join(f"{v:.5f}" for v in (t, *f))
                for t, f in zip(time, force, strict=True)
            ]
            file.write_text(head + "\n".join(rows).replace(".", ","))
        text += (
            f'[[record]]\nfile = "{file.name}"\nfeed_per_tooth = "{1e3 * feed} mm"\n'
        )
        text += more
    fit = 'lowpass = "1.5 kHz"\nhas_offset = false\nhas_drift = false\n'
    return f"{text}[fit]\n{fit}"


def test_check_tells_what_an_identification_would_read(folder, run):
    text = write_records(folder)
    said = run("four.toml", text, command="check")
    assert "a file for `diffmill identify` without faults" in said
    for name in ("slot0.tdms", "slot1.mat", "slot2.nc", "slot3.txt"):
        assert f"{name}: cut from 0 to 0.0899 s at 10000 Hz" in said
    assert "angle was taken from the column for the tacho" in said
    changes = (
        ("pulses_per_turn = 1", "pulses_per_turn = 2", "look at the speed and at"),
        ('"slot1.mat"\n', '"slot1.mat"\ntooth_angle = "3 deg"\n', "without a column"),
        ('"slot1.mat"\n', '"slot1.mat"\ntime_shift = "3 s"\n', "no clock of its own"),
    )
    for old, new, message in changes:
        changed = text.replace(old, new)
        assert message in run("bad.toml", changed, command="check", code=2)
    said = run("bad.toml", 'kind = "ring_downs"\n', command="check", code=2)
    assert "kind: found 'ring_downs'" in said


OFFSET, DRIFT = np.array([5.0, -12.0, 40.0]), np.array([7.0, 0.0, -30.0])


def write_tared(folder, runout=0.0, unit="N"):
    """Write a slot with sections without a cut, an offset, a drift and noise of 1 N."""
    time = np.arange(0, 1, 1e-4)
    is_cut = ((time > 0.15) & (time < 0.85))[:, None]
    force = slot_force(time, 0.1e-3, runout) * [1, 1, -1] * is_cut
    force += OFFSET + DRIFT * time[:, None]
    force += np.random.default_rng(0).normal(size=force.shape)
    head = ",".join(["time_s", *(f"F{axis} [{unit}]" for axis in "xyz")])
    return SLOTS + record(folder, "slot.csv", time, force, 0.1e-3, head)


def numbers_behind(said, head):
    """Return the numbers of three forces in the line behind its head."""
    (line,) = [x for x in said.splitlines() if x.strip().startswith(head)]
    return [float(line.split(f"F{axis} ")[1].split()[0].strip(",")) for axis in "xyz"]


def test_check_tells_channels_offset_drift_and_noise_of_a_record(folder, run):
    text = write_tared(folder)
    said = run("slot.toml", text, command="check")
    assert "time  column `time` [s]: 0 to 0.9999 s" in said
    assert "Fy    column `Fy` [N]: " in said
    found = numbers_behind(said, "offset taken away")
    (line,) = [x for x in said.splitlines() if "offset taken away" in x]
    instant = float(line.split(" at ")[1].split()[0])
    np.testing.assert_allclose(found, OFFSET + DRIFT * instant, atol=0.3)
    np.testing.assert_allclose(numbers_behind(said, "drift taken"), DRIFT, atol=1)
    np.testing.assert_allclose(numbers_behind(said, "noise where"), 1, atol=0.1)
    said = run("slot.toml", text + 'tare = "none"\n', command="check")
    assert "offset taken away: none" in said


def test_a_sensitivity_is_told_by_check_and_a_wrong_one_is_refused(folder, run):
    text = write_tared(folder, unit="pC") + "units = { force = "
    said = run("slot.toml", text + '"4 pC/N" }\n', command="check")
    assert "Fx    column `Fx` [4 pC/N]" in said
    found = numbers_behind(said, "noise where")
    np.testing.assert_allclose(found, 0.25, atol=0.03)
    error = run("slot.toml", text + '"100 N/V" }\n', command="check", code=2)
    assert "[[record]] 1 file: slot.csv: the unit of `force`" in error
    assert "a column in pC" in error


def test_check_tells_what_was_read_of_means_loads_and_vibrations(folder, run):
    write_means(folder)
    said = run("means.toml", MEANS, command="check")
    assert "mean forces at 4 feeds, 0.05 to 0.2 mm per tooth" in said
    assert "feed_per_tooth  column `fz_mm` [mm]: 0.05 to 0.2 mm" in said
    assert "Fz              column `Fz` [N]: " in said
    lists = 'feed_per_tooth = ["0.1 mm", "0.2 mm"]\nFx = ["1 N", "2 N"]\n'
    lists += 'Fy = ["30 N", "50 N"]\nFz = ["-3 N", "-5 N"]\n'
    text = MEANS.replace('file = "means.csv"\n', lists)
    assert "mean Fz: -5 to -3 N" in run("means.toml", text, command="check")
    write_loads(folder)
    said = run("loads.toml", LOADS, command="check")
    assert "8 load tests of slides" in said
    assert "x   column `x` [mm]: 0 to 0 um" in said
    assert "dx  column `dx` [um]: " in said and "Fx  column `Fx` [N]: " in said
    head, H = "frequency_Hz,real [m/N],imag [m/N]", RECEPTANCE
    save(folder / "tip.csv", head, LINES, H.real, H.imag)
    said = run("tip.toml", f'{TIP}lowest = "15 Hz"\n', command="check")
    assert "tip.csv: receptance, 81 lines from 10 to 30 Hz, 61 of them fitted" in said
    assert "real       column `real` [m/N]: " in said
    t = np.arange(0, 1, 5e-4)
    save(folder / "hit.csv", "t_s,a", t, np.exp(-2 * t) * np.cos(200 * t))
    text = 'kind = "ring_down"\n[[ring_down]]\nfile = "hit.csv"\n'
    said = run("hit.toml", text, command="check")
    assert "hit.csv: 2000 samples from 0 to 0.9995 s, modes sought: 1" in said
    assert "signal  column `a` [any unit]: -" in said


def test_check_tells_what_was_read_of_paths_in_the_air(folder, run):
    t = np.arange(0, 2, 0.01)
    for name, lag in (("commanded", 0), ("actual", 3)):
        x, head = 50 * np.sin(2 * (t - 0.01 * lag)), "time_s,x_mm,y_mm,z_mm"
        save(folder / f"{name}.csv", head, t, x, 0 * t, 0 * t)
    text = 'kind = "controller"\n[air_path]\ncommanded = "commanded.csv"\n'
    said = run("air.toml", f'{text}actual = "actual.csv"\n', command="check")
    assert "200 rows every 10 ms, 1.99 s" in said
    assert "actual less commanded: x -" in said and "mm, y 0 to 0 um" in said


REVERSAL = 'kind = "reversal"\n[reversal]\n[[joint_record]]\nfile = "joint.csv"\n'


def test_check_tells_what_was_read_of_joints(folder, run):
    record = Joint().record(np.random.default_rng(0), duration=4.0)
    save_joint(folder / "joint.csv", record)
    said = run("joint.toml", REVERSAL, command="check")
    assert "joint.csv: 1000 rows every 4 ms" in said
    assert "torque_1  column `torque_1_Nm` [Nm]: " in said
    said = run("joint.toml", REVERSAL.replace("joint.csv", "no.csv"), code=2)
    assert "[[joint_record]] 1 file" in said


@pytest.mark.slow
def test_reversals_are_told_and_written_as_drives_of_a_robot(folder, run):
    joint = Joint()
    save_joint(folder / "joint.csv", joint.record(np.random.default_rng(3)))
    said = flat(run("joint.toml", REVERSAL))
    assert "1 records of 1 joints with two encoders, below 10 Hz" in said
    assert "Viscous friction of a link and the delay of its encoder are one" in said
    out, facts, toml = results(folder, "joint")
    drive = toml["drive"]["joint_1"]
    for text, kind, truth in (
        (toml["stiffness"]["joint_1"], ROTARY_STIFFNESS, joint.stiffness),
        (drive["coulomb_friction"], MOMENT, joint.friction),
        (drive["backlash"], ANGLE, joint.backlash),
    ):
        assert quantity(text, kind) == pytest.approx(truth, rel=0.25)
    assert 0 < quantity(drive["presliding"], ANGLE) < 1e-3
    assert facts["joints"]["joint_1"]["delay"] == pytest.approx(joint.delay, rel=0.02)
    assert drawn(out) == {"reversal_joint_1"}
    # The file completes a robot as it is.
    (folder / "arm.toml").write_text(AXIS)
    arm = rb.load(folder / "arm.toml", drives=out / "identified.toml")
    assert arm.friction is not None and arm.friction.presliding is not None
    assert float(arm.friction.presliding[0]) > 0


def test_check_tells_what_was_read_of_arm_and_cut(folder, run):
    file = write_slides_job(folder)
    job = load_job(file)
    time = np.arange(80) * float(job.tooth_period)
    wave = 100 * np.sin(20 * time)
    save(folder / "run.csv", "time_s,Fx_N,Fy_N,Fz_N", time, wave, wave, wave)
    text = f'kind = "coupled"\n[coupled]\njob = "{file.name}"\nfile = "run.csv"\n'
    said = run("run.toml", text, command="check")
    assert "80 rows from 0 to " in said
    assert "Fx    column `Fx` [N]: -" in said


@pytest.mark.slow
def test_runout_is_named_then_fitted_and_written_as_keys(folder, run):
    text = write_tared(folder, runout=8e-6)
    printed = run("slot.toml", text)
    np.testing.assert_allclose(numbers_behind(printed, "noise where"), 1, atol=0.1)
    np.testing.assert_allclose(numbers_behind(printed, "drift taken"), DRIFT, atol=1)
    said = flat(printed)
    assert "a line at the spindle's frequency, 100 Hz, of amplitude Fx 3" in said
    assert 'Fit the run-out by refine = ["runout"] in [fit].' in said
    _, facts, toml = results(folder, "slot")
    (line,) = facts["diagnoses"]
    assert line["code"] == "spindle_line" and "cutter" not in toml
    assert facts["tare"][0]["drift_N_per_s"] == pytest.approx(DRIFT, abs=1)
    said = flat(run("more.toml", text + '[fit]\nrefine = ["runout"]\n'))
    assert "spindle's frequency" not in said
    out, facts, toml = results(folder, "more")
    runout = quantity(toml["cutter"]["runout"], LENGTH)
    assert runout == pytest.approx(8e-6, rel=0.05)
    # Which of the teeth is called 0 is chance.
    angle = math.degrees(quantity(toml["cutter"]["runout_angle"], ANGLE))
    assert abs(math.remainder(angle, 180)) < 10
    assert 'runout_angle = "' in said and facts["diagnoses"] == []
    check_digits(toml["force"], facts, out)


@pytest.mark.slow
def test_records_of_four_programs_are_fitted_together(folder, run):
    text = write_records(folder)
    said = run("four.toml", text)
    _, facts, _ = results(folder, "four")
    for name, value in zip(LinearEdgeLaw.NAMES, K, strict=True):
        assert abs(facts["coefficients_SI"][name] / value - 1) < 0.03
    assert facts["explained"] > 0.99
    # Tooth 0 passes the mark 30 degrees on, or tooth 1 does.
    angle = float(said.split('tooth_angle = "')[1].split(" deg")[0])
    assert min(abs(angle - 30), abs(angle + 150)) < 3
    # With that the first record alone is fitted to its tooth.
    head, one, *_ = text.split("[[record]]")
    text = f'{head}[[record]]{one}tooth_angle = "{angle + 4} deg"\n'
    said = run("one.toml", text + '[fit]\nlowpass = "1.5 kHz"\n')
    off = float(said.split("the tooth is ")[1].split(" deg")[0])
    assert abs(off + 4) < 0.5


@pytest.mark.slow
def test_a_record_of_a_straight_cut_gives_its_coefficients(folder, run):
    cutter = ct.flat_end_mill(10e-3, 2, helix_angle=math.radians(30))
    speed = 6000 * 2 * math.pi / 60 * 1.002
    cut = identification.StraightCut(cutter, speed, 0.1e-3, 2e-3).cut(teeth=96)
    found = identification.EngagementColumns.of_cut(cut)
    grid = found.start + found.spacing * np.arange(len(found.columns))
    time = np.arange(13 * cut.tooth_period, 95 * cut.tooth_period, 1e-4)
    # A right-hand helix pulls toward the work.
    pulled = K * [1, 1, -1, 1, 1, -1]
    clean = (found.columns @ pulled).T
    force = noisy(np.stack([np.interp(time, grid, f) for f in clean], axis=1))
    text = SLOTS + record(folder, "slot.csv", time, force[:, [1, 0, 2]], 0.1e-3)
    # The record has no tare, and is known to need none.
    known = "has_offset = false\nhas_drift = false\n"
    text = run("slot.toml", f'{text}[fit]\naxes = "proposed"\n{known}')
    assert 'axes: ["y", "x", "z"] (the likeliest, as requested)' in text
    assert " 6012." in text and "No section without a cut was found" in text
    out, facts, toml = results(folder, "slot")
    for name, value in zip(LinearEdgeLaw.NAMES, pulled, strict=True):
        assert abs(facts["coefficients_SI"][name] / value - 1) < 0.02
    left_out = facts["left_out"][0]
    assert left_out["error"] < 0.06
    assert left_out["explained"] == pytest.approx(1 - left_out["error"] ** 2)
    assert drawn(out) == {"record", "spectrum", "left_out", "correlation"}
    assert set(toml["force"]) == set(LinearEdgeLaw.NAMES)


@pytest.mark.slow
def test_a_record_in_other_axes_than_the_rest_is_named(folder, run):
    time, feeds = np.arange(0, 0.25, 1e-4), (0.08e-3, 0.1e-3, 0.12e-3)
    turned = lambda force, i: force * [1, -1 if i == 2 else 1, 1]
    said = flat(run("slot.toml", SLOTS + slots(folder, time, feeds, turned)))
    assert said.count("does not agree with the others") == 1
    _, _, place = said.partition("slot2.txt does not agree with the others")
    assert place.startswith(': alone it suits the axes ["x", "-y", "-z"]')


@pytest.mark.slow
def test_means_of_a_cutter_with_other_teeth_are_comments(folder, run):
    time, job = np.arange(0, 0.1, 2e-4), SLOTS.replace("force_records", "mean_forces")
    job += slots(folder, time, (0.05e-3, 0.1e-3, 0.15e-3))
    said = run("slot.toml", job.replace("teeth = 2", "teeth = 4"))
    for i in range(3):
        assert f"warning: slot{i}.txt: The forces repeat 2 times a turn" in said
    _, facts, toml = results(folder, "slot")
    found = [(one["code"], one["record"]) for one in facts["diagnoses"]]
    assert found == [("tooth_count", i) for i in range(3)]
    assert facts["records"] == ["slot0.txt", "slot1.txt", "slot2.txt"]
    assert toml == {}


@pytest.mark.slow
def test_means_of_saturated_records_are_comments(folder, run):
    time, job = np.arange(0, 0.1, 2e-4), SLOTS.replace("force_records", "mean_forces")
    clipped = lambda force, _: np.minimum(force, 0.7 * force.max())
    job += slots(folder, time, (0.05e-3, 0.1e-3, 0.15e-3), clipped)
    run("slot.toml", job)
    out, _, toml = results(folder, "slot")
    assert toml == {}
    assert "Samples of a record are saturated" in (out / "identified.toml").read_text()


@pytest.mark.slow
def test_two_forces_give_what_they_show(folder, run):
    time = np.arange(0, 0.25, 1e-4)
    force = noisy(slot_force(time, 0.1e-3))
    text = SLOTS + record(folder, "slot.txt", time, force * [1, 1, 0], 0.1e-3)
    said = run("slot.toml", text + 'channels = { Fz = "none" }\n')
    assert "does not vary" not in said and "make more sense" not in said
    assert "no axial force was measured: record it too" in said
    _, facts, toml = results(folder, "slot")
    for name, value in zip(LinearEdgeLaw.NAMES, K, strict=True):
        assert facts["identifiable"][name] == (not name.startswith("K_a"))
        if facts["identifiable"][name]:
            assert abs(facts["coefficients_SI"][name] / value - 1) < 0.03
    assert set(toml["force"]) == {"K_tc", "K_rc", "K_te", "K_re"}


POSES = """kind = "kinematics"
[robot]
model = "reis_rv130_like"
[poses]
file = "poses.csv"
difference = "actual - desired"
noise = "15 um"
folds = 3
"""


def write_poses(folder, head="x_mm,y_mm,z_mm,dx_um,dy_um,dz_um"):
    """Write poses of a robot with errors; return its pose at any joint positions."""
    draw = np.random.default_rng(3)
    robot = rb.load("reis_rv130_like")
    errors = dataclasses.replace(
        rb.LinkErrors.none(robot),
        displacement=jnp.asarray(1e-3 * draw.normal(size=(6, 3))),
        rotation=jnp.asarray(1e-3 * draw.normal(size=(6, 3))),
        joint_offsets=jnp.asarray(5e-3 * draw.normal(size=6)),
        tool_position=jnp.array([0.1, 0.0, 0.05]),
    )
    pose = jax.jit(
        jax.vmap(lambda q: rb.forward_kinematics(errors.applied_to(robot), q))
    )
    q = np.asarray(robot.home) + draw.uniform(-0.7, 0.7, (60, 6))
    actual = pose(q)[:, :3, 3] + 15e-6 * draw.normal(size=(60, 3))
    desired = actual - 1e-3 * draw.normal(size=(60, 3))
    columns = 1e3 * desired, 1e6 * (actual - desired), np.rad2deg(q)
    names = ",".join(f"axis_{k}_deg" for k in range(1, 7))
    save(folder / "poses.csv", f"{head},{names}", *columns)
    return pose


def test_link_errors_are_written_as_a_calibration_of_the_robot(folder, run):
    pose = write_poses(folder)
    said = run("poses.toml", POSES)
    assert "60 positions of the tool" in said
    assert "no pose of this robot, tool and instrument determines:" in said
    assert "poses that would help most:" in said
    out, facts, toml = results(folder, "poses")
    left_out = facts["left_out_m"]
    assert left_out["before"]["mean"] > 1e-3 > 50e-6 > left_out["after"]["mean"]
    assert facts["spread_SI"][0] == pytest.approx(15e-6, rel=0.3)
    assert drawn(out) == {"left_out", "prediction", "correlation"}
    # What was written, rounded, says where the tool is: but for the base, the tool.
    table = toml["robot"]["calibration"]
    assert table.keys() == {"displacement", "rotation", "joint_offsets"}
    values = dict(zip(facts["parameters"], facts["values_SI"], strict=True))
    placed = {
        f"{what}_{kind}": jnp.array(
            [values.get(f"{what} {word} {axis}", 0.0) for axis in "xyz"]
        )
        for what in ("base", "tool")
        for kind, word in (("position", "along"), ("rotation", "about"))
    }
    robot = rb.load("reis_rv130_like")
    read = lambda key, kind: jnp.array(
        [[quantity(text, kind) for text in row] for row in table[key]]
    )
    offsets = [quantity(text, ANGLE) for text in table["joint_offsets"]]
    errors = dataclasses.replace(
        rb.LinkErrors.none(robot),
        displacement=read("displacement", LENGTH),
        rotation=read("rotation", ANGLE),
        joint_offsets=jnp.array(offsets),
        **placed,
    )
    found = errors.applied_to(robot)
    q = np.asarray(robot.home) + np.random.default_rng(0).uniform(-0.5, 0.5, (20, 6))
    at = np.asarray(jax.vmap(lambda q: rb.forward_kinematics(found, q))(q))[:, :3, 3]
    wanted = np.asarray(pose(q))[:, :3, 3]
    # Where the instrument takes the base to stand is its start.
    at, wanted = at - at.mean(0), wanted - wanted.mean(0)
    turn = Rotation.align_vectors(at, wanted)[0]
    apart = at - turn.apply(wanted)
    assert np.abs(apart).max() < 60e-6


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ('difference = "actual - desired"\n', "", ("dx, dy, dz", "not its sign")),
        ("noise = ", "# noise = ", ("[poses] noise", "found nothing", "15 um")),
        ('"15 um"', '"15 urad"', ("[poses] noise", "15 urad", "a length")),
        ("folds = 3", "folds = 1", ("[poses] folds", "at least 2")),
        ("folds = 3", "skip_rows = [61]", ("skip_rows", "61", "60 rows")),
        ("folds = 3", 'measured = "distance"', ("fixed_point", "found nothing")),
        ("folds = 3", 'fixed_point = ["1 m", "0 m", "0 m"]',
         ("fixed_point", "found a point", '"position"')),
        ("folds = 3", 'measured = "frame"', ("no column for roll, pitch, yaw",)),
        ("folds = 3", 'channels = { dz = "none" }', ("no column for dz",)),
        ("folds = 3", 'units = { joint = "rad" }', ("`joint`", "no robot has", "deg")),
        ("folds = 3", 'units = { difference = "mm" }', ("`difference`", "no robot")),
        ("folds = 3", '[prior]\ntool = "0 mm"', ("[prior] tool", "above 0")),
        ("folds = 3", "[prior]\nlink = 1", ("[prior] link", "unknown key")),
        ('"reis_rv130_like"', '"reis"', ("[robot] model", "reis")),
    ],
)  # fmt: skip
def test_faults_of_measured_poses(folder, run, old, new, parts):
    write_poses(folder)
    assert old in POSES
    said = flat(run("poses.toml", POSES.replace(old, new), command="check", code=2))
    for part in parts:
        assert part in said


def test_poses_with_a_joint_reversed_are_doubted(folder, run):
    write_poses(folder)
    rows = np.loadtxt(folder / "poses.csv", delimiter=",", skiprows=1)
    head = (folder / "poses.csv").read_text().split("\n")[0]
    rows[:, 7] *= -1
    save(folder / "poses.csv", head, rows)
    said = flat(run("poses.toml", POSES))
    assert "look at units, at the sign and zero of each joint" in said
    assert results(folder, "poses")[2] == {}
