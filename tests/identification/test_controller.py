"""Bandwidth and dead time from a path in the air with noise of 5 um."""

import json

import numpy as np
import pytest
from scipy.signal import lfilter

from diffmill.cli import main
from diffmill.config import load_identification
from diffmill.identification import ControllerStudy, StudyError

RNG = np.random.default_rng(5)


def command(time):
    """Return short moves with speeds up to 50 mm/s and 0.5 m/s^2, in x and y."""
    x = 8e-3 * (1 - np.cos(2 * np.pi * 0.9 * time)) / 2
    y = 3e-3 * np.sin(2 * np.pi * 1.7 * time) ** 3
    rows = np.stack([x, y, 0 * time], axis=1)
    return rows * np.clip(time / 0.3, 0, 1)[:, None] ** 2


def served(time, bandwidth, dead_time, zeta):
    """Return what a servo makes of it, by small steps of its differential equation."""
    h = 0.1e-3
    fine = np.arange(0, time[-1] + h, h)
    target = command(np.maximum(fine - dead_time, 0))
    w = 2 * np.pi * bandwidth
    y, v, out = np.zeros(3), np.zeros(3), []
    for u in target:
        out.append(y.copy())
        if zeta is None:
            y = y + h * w * (u - y)
        else:
            v = v + h * (w**2 * (u - y) - 2 * zeta * w * v)
            y = y + h * v
    return np.stack([np.interp(time, fine, x) for x in np.array(out).T], axis=1)


def write(folder, time, actual, more=""):
    head = "time_s,x_mm,y_mm,z_mm"
    for name, rows in (("commanded", command(time)), ("actual", actual)):
        table = np.column_stack([time, 1e3 * rows])
        np.savetxt(
            folder / f"{name}.csv", table, delimiter=",", header=head, comments=""
        )
    text = 'kind = "controller"\n[air_path]\ncommanded = "commanded.csv"\n'
    (folder / "air.toml").write_text(text + 'actual = "actual.csv"\n' + more)
    return folder / "air.toml"


@pytest.mark.parametrize(
    ("bandwidth", "dead_time", "zeta"),
    [
        (8.0, 20e-3, 0.7),
        pytest.param(15.0, 12e-3, 1.0, marks=pytest.mark.slow),
        pytest.param(2.65, 8e-3, None, marks=pytest.mark.slow),
    ],
)
def test_it_is_found_within_five_per_cent(tmp_path, bandwidth, dead_time, zeta):
    time = 4e-3 * np.arange(1500)
    actual = served(time, bandwidth, dead_time, zeta) + np.array([[1e-3, -2e-3, 0]])
    actual = actual + 5e-6 * RNG.normal(size=actual.shape)
    more = 'order = "first"\n' if zeta is None else ""
    file, out = write(tmp_path, time, actual, more), tmp_path / "out"
    assert main(["identify", str(file), "--out", str(out)]) == 0
    found = json.loads((out / "identified.json").read_text())
    assert found["bandwidth_Hz"] == pytest.approx(bandwidth, rel=0.05)
    assert found["dead_time_s"] == pytest.approx(dead_time, rel=0.05)
    assert found["residual_rms_m"] == pytest.approx(5e-6, rel=0.1)
    if zeta is not None:
        assert found["damping_ratio"] == pytest.approx(zeta, rel=0.05)
    assert "[controller]\nbandwidth" in (out / "identified.toml").read_text()


def test_a_path_that_stands_is_refused(tmp_path):
    time = 4e-3 * np.arange(100)
    file = write(tmp_path, time, np.zeros((100, 3)))
    (tmp_path / "commanded.csv").write_text((tmp_path / "actual.csv").read_text())
    with pytest.raises(StudyError, match="a path that moves"):
        load_identification(file).run()


def test_a_gap_of_the_record_is_left_out(tmp_path):
    time = 4e-3 * np.arange(750)
    actual = served(time, 6.0, 20e-3, 0.6)
    file = write(tmp_path, time, actual + 5e-6 * RNG.normal(size=actual.shape))
    lines = (tmp_path / "actual.csv").read_text().splitlines(keepends=True)
    (tmp_path / "actual.csv").write_text("".join(lines[:201] + lines[300:]))
    study = load_identification(file)
    assert isinstance(study, ControllerStudy)
    np.testing.assert_array_equal(np.flatnonzero(~study.is_recorded), range(200, 299))
    assert "99 instants between rows more than 10 ms apart" in study.notes[0]
    found = study.run()
    assert found.bandwidth == pytest.approx(6.0, rel=0.03)
    assert found.damping_ratio == pytest.approx(0.6, rel=0.03)


def coloured(draw, shape, size=5e-6, rho=0.95):
    """Return noise of a tracker, correlated over some twenty rows [m]."""
    white = draw.normal(size=(300 + shape[0], *shape[1:]))
    noise = np.asarray(lfilter([np.sqrt(1 - rho**2)], [1, -rho], white, axis=0))
    return size * noise[300:]


def study(actual, time):
    rows = np.ones(len(time), bool)
    return ControllerStudy(
        "air", time[1] - time[0], command(time), actual, rows, "second", ()
    )


@pytest.mark.slow
@pytest.mark.parametrize("rho", [0.0, 0.95])
def test_intervals_hold_with_coloured_noise(rho):
    time = 4e-3 * np.arange(1500)
    clean = served(time, 8.0, 20e-3, 0.7)
    truth, off = np.array([8.0, 0.7, 20e-3]), []
    for seed in range(40):
        draw = np.random.default_rng(seed)
        fit = study(clean + coloured(draw, clean.shape, 20e-6, rho), time).run()
        found = np.array([fit.bandwidth, fit.damping_ratio, fit.dead_time])
        names = ("bandwidth", "damping_ratio", "dead_time")
        off.append((found - truth) / [fit.standard_errors[name] for name in names])
        assert fit.are_servos_alike
    held = (np.abs(off) < 1.96).mean(axis=0)
    assert (held >= 0.85).all()
    assert (np.std(off, axis=0) > 0.5).all()


def test_servos_that_differ_are_refused(tmp_path):
    """Axes of 5, 7 and 6 Hz: one servo of their mean would be no servo of any."""
    time, servos = 4e-3 * np.arange(1500), (5.0, 7.0, 6.0)
    actual = np.stack(
        [served(time, f, 20e-3, 0.7)[:, i] for i, f in enumerate(servos)], axis=1
    )
    actual = actual + coloured(np.random.default_rng(0), actual.shape)
    fit = study(actual, time).run()
    assert not fit.are_servos_alike and not fit.is_identifiable
    # The third axis does not move.
    np.testing.assert_allclose(fit.bandwidth_by_axis[:2], servos[:2], rtol=0.05)
    assert np.isnan(fit.bandwidth_by_axis[2])
    file, out = write(tmp_path, time, actual), tmp_path / "out"
    assert main(["identify", str(file), "--out", str(out)]) == 0
    assert "[controller]" not in (out / "identified.toml").read_text()
    said = " ".join((out / "summary.txt").read_text().split())
    assert "One servo for all axes does not suit this record" in said
