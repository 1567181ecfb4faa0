import json
import math
import os
import pathlib

import numpy as np
import pytest
from helpers import PAPER_LAW
from references import circles
from references.trochoid import TrochoidCut
from slot_force import mean_lines

from diffmill.cutting import LinearEdgeLaw
from diffmill.identification import fit_mean_forces

ROOT = pathlib.Path(__file__).parents[2]
DATA = ROOT / os.environ.get("DIFFMILL_REFERENCE_DATA", "../shared/data")
FEEDS = np.array([0.05, 0.1, 0.15, 0.2]) * 1e-3
PAPER = {name: getattr(PAPER_LAW, name) for name in LinearEdgeLaw.NAMES}


@pytest.mark.parametrize(
    ("entry", "exit"), [(0.0, math.pi), (0.0, 1.1), (2.0, math.pi)]
)
def test_quadratures_of_the_force_give_the_coefficients_back(entry, exit):
    mean = [
        circles.thin_chip_mean_force(PAPER_LAW, f, entry, exit, 2e-3, teeth=3)
        for f in FEEDS
    ]
    fit = fit_mean_forces(
        FEEDS,
        np.stack(mean),
        teeth=3,
        axial_depth=2e-3,
        entry_angle=entry,
        exit_angle=exit,
    )
    for name, wanted in PAPER.items():
        assert fit.coefficients[name] == pytest.approx(wanted, rel=1e-3), name
    np.testing.assert_allclose(fit.r_squared, 1, atol=1e-9)


def test_standard_errors_cover_the_truth():
    truth = np.array(list(PAPER.values()))
    feeds = np.linspace(0.02e-3, 0.2e-3, 12)
    mean = mean_lines(feeds, truth, leave=2.0)
    draw = np.random.default_rng(0)
    off, shared, fit = [], [], None
    for _ in range(200):
        noisy = mean + draw.normal(size=mean.shape) * np.array([[3.0, 1.0, 0.3]])
        fit = fit_mean_forces(feeds, noisy, teeth=2, axial_depth=3e-3, exit_angle=2.0)
        found = np.array(list(fit.coefficients.values()))
        off.append(found - truth)
        shared.append(
            np.abs(off[-1]) < 2 * np.array(list(fit.standard_errors.values()))
        )
    within = np.mean(shared, axis=0)
    assert (within > 0.87).all() and (within < 0.99).all()
    assert fit is not None
    seen = np.corrcoef(np.stack(off).T)
    np.testing.assert_allclose(fit.correlation, seen, atol=0.3)


def test_the_published_line_fit_of_a_measurement():
    path = DATA / "forces" / "measured_slot_means.json"
    if not path.exists():
        pytest.skip("no reference data")
    data = json.loads(path.read_text())
    mean = data["mean_N"]
    # The record's Fx is the book's Fy, and its Fy the book's Fx.
    force = np.column_stack([mean["Fy"], mean["Fx"], mean["Fz"]])
    fit = fit_mean_forces(
        np.array(data["feed_per_tooth_mm"]) * 1e-3, force, teeth=2, axial_depth=3e-3
    )
    for name, value in fit.coefficients.items():
        unit = 1e6 if name.endswith("c") else 1e3
        assert value == pytest.approx(data["coefficients"][name] * unit, rel=1e-3)


def test_one_feed_is_no_line():
    with pytest.raises(ValueError):
        fit_mean_forces([1e-4, 1e-4], np.ones((2, 3)), teeth=2, axial_depth=1e-3)


def test_known_is_what_errs_little_beside_the_force():
    """An edge coefficient of zero may be known, a large one may not be."""
    force = mean_lines(FEEDS, np.array([900e6, 300e6, 150e6, 0, 0, 0]))
    draw = np.random.default_rng(0).normal(size=force.shape)
    size = {"teeth": 2, "axial_depth": 3e-3}
    quiet = fit_mean_forces(FEEDS, force + 0.3 * draw, **size)
    assert all(quiet.identifiable.values()) and abs(quiet.coefficients["K_te"]) < 200
    loud = fit_mean_forces(FEEDS, force + 40 * draw, **size)
    assert not any(loud.identifiable.values())
    two = fit_mean_forces(FEEDS[:2], force[:2], **size)
    assert not any(two.identifiable.values())


@pytest.mark.parametrize(
    ("side", "width", "entry", "leave"),
    [
        ("slot", math.nan, 0.0, math.pi),
        ("up", 3e-3, 0.0, math.acos(1 - 3 / 5)),
        ("down", 3e-3, math.pi - math.acos(1 - 3 / 5), math.pi),
    ],
)
def test_teeth_on_trochoids_bend_the_line(side, width, entry, leave):
    """Means of exact trochoids: with the radius most of the error of circles goes."""
    K = np.array(list(PAPER.values()))
    speed, count = 600.0, 20_000
    time = 2 * math.pi / speed * (np.arange(count) + 0.5) / count
    size = {"side": side, "radial_depth": width, "slices": 1}
    mean = [
        TrochoidCut(K, f, 2e-3, speed, 5e-3, 2, **size).force(time).mean(axis=0)
        for f in FEEDS
    ]
    shape = {"entry_angle": entry, "exit_angle": leave}
    fits = [
        fit_mean_forces(
            FEEDS, np.array(mean), teeth=2, axial_depth=2e-3, **shape, radius=radius
        )
        for radius in (None, 5e-3)
    ]
    wanted = np.array([PAPER[name] for name in ("K_tc", "K_rc", "K_ac")])
    off = [
        np.array([fit.coefficients[n] for n in ("K_tc", "K_rc", "K_ac")]) / wanted - 1
        for fit in fits
    ]
    assert np.abs(off[0]).max() > 0.008 and np.abs(off[1]).max() < 0.003
    residual = [np.abs(fit.residual).max() for fit in fits]
    assert residual[1] < 0.3 * residual[0]
    np.testing.assert_allclose(
        fits[1].predicted(FEEDS) + fits[1].residual, mean, rtol=1e-12
    )
