"""`[correction]`: objective, weights and bounds as a job file says them."""

from typing import Any

import pytest

from diffmill import CorrectionSettings, UncertaintySettings
from diffmill.config._schema.correction import (
    CorrectionTable,
    check_correction,
    correction_settings,
)
from diffmill.config._schema.table import validated


def read(**raw: Any) -> tuple[Any, list[str]]:
    problems: list[str] = []
    return validated(CorrectionTable, raw, "[correction]", problems), problems


def settings_of(table: CorrectionTable) -> CorrectionSettings:
    return correction_settings(table, is_recorded=False)


def test_values_become_settings_in_si():
    table, problems = read(
        objective="surface",
        tolerance="10 um",
        max_velocity="60 mm/s",
        max_acceleration="2 m/s^2",
        finishing_only=True,
        floor_weight=0,
        gouge="20 um",
        stay_in_cut=True,
        uncertainty={
            "stiffness": 0.2,
            "force": 0.1,
            "draws": 6,
            "objective": "worst",
            "delay": "5 ms",
        },
        weight=[{"lines": [12, 30], "value": 0}, {"lines": [31, 31], "value": 2.5}],
    )
    assert not problems
    settings = settings_of(table)
    assert settings.tolerance == pytest.approx(1e-5)
    assert settings.uncertainty == UncertaintySettings(
        0.2, 0.0, 0.1, False, 6, 0, "worst", 5e-3
    )
    assert (settings.gouge, settings.stay_in_cut) == (pytest.approx(2e-5), True)
    assert settings_of(read()[0]).gouge == float("inf")
    assert settings_of(read()[0]).max_steps == 2
    assert settings_of(read(method="adam")[0]).max_steps == 60
    assert settings_of(read(method="adam", max_steps=7)[0]).max_steps == 7
    assert settings_of(read()[0]).uncertainty is None
    assert settings.max_velocity == pytest.approx(0.06)
    assert settings.max_acceleration == pytest.approx(2.0)
    assert settings_of(read()[0]).max_acceleration == float("inf")
    assert settings.sections == ((12, 30, 0.0), (31, 31, 2.5))
    assert (settings.objective, settings.finishing_only) == ("surface", True)
    assert (settings.wall_weight, settings.floor_weight) == (1.0, 0.0)
    assert settings_of(read()[0]).sections == ()


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        ({"tolerance": "-1 um"}, ("tolerance", "at least 0")),
        (
            {"weight": [{"lines": [1, 2], "value": -1}]},
            ("weight.0.value", "at least 0"),
        ),
        ({"weight": [{"lines": [1], "value": 1}]}, ("weight.0.lines", "2 values")),
        ({"weight": [{"value": 1}]}, ("weight.0.lines", "first and last line")),
        ({"uncertainty": {"force": 1}}, ("uncertainty.force", "less than 1")),
        ({"uncertainty": {"delay": "-1 ms"}}, ("uncertainty.delay", "at least 0")),
        ({"objective": "both"}, ("objective", "'surface'")),
        ({"max_products": 3}, ("max_products", "found 3", "at least 4")),
        ({"finishing_only": 1}, ("finishing_only", "true or false")),
    ],
)
def test_faults_are_named(raw, words):
    _, problems = read(**raw)
    assert len(problems) == 1
    assert all(word in problems[0] for word in words), problems[0]


def test_what_the_cutter_does_not_allow(simple_end_mills):
    table, _ = read(
        objective="surface",
        wall_weight=0,
        floor_weight=0,
        weight=[{"lines": [5, 2], "value": 1}],
    )
    flat, ball = simple_end_mills
    found: list[str] = []
    check_correction(table, ball, True, found)
    assert [line.split()[1] for line in found] == [
        "objective:",
        "wall_weight:",
        "weight.lines:",
    ]
    table, _ = read(max_velocity="1 m/s", method="mirror", command="joint")
    limited: list[str] = []
    check_correction(table, flat, True, limited)
    assert ["method" in line for line in limited] == [True, False]
    assert 'command = "joint"' in limited[1]
    found = []
    check_correction(
        read(gouge="20 um", stay_in_cut=True, method="adam", horizon=900)[0],
        ball,
        True,
        found,
    )
    assert [line.split()[1] for line in found] == [
        "horizon:",
        "gouge:",
        "stay_in_cut:",
        "gouge:",
        "stay_in_cut:",
    ]
    assert 'method = "adam"' in found[-1]
    found = []
    check_correction(read(objective="surface")[0], flat, True, found)
    assert found == []
    check_correction(read(objective="surface")[0], flat, False, found)
    assert "flat cutter" in found[0]


@pytest.fixture
def simple_end_mills():
    from diffmill.cutter import ball_end_mill, flat_end_mill

    sizes = {"diameter": 0.01, "teeth": 2, "helix_angle": 0.0}
    return flat_end_mill(**sizes), ball_end_mill(**sizes)
