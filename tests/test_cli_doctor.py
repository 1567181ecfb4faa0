"""The self-test of an installation."""

import re

import pytest

from diffmill import robot
from diffmill.cli import main


@pytest.mark.slow
def test_doctor_tells_what_is_there_and_finds_nothing_wrong(
    capsys, tmp_path, monkeypatch
):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    assert main(["doctor"]) == 0
    told = capsys.readouterr().out
    for word in ("diffmill 0", "jax 0", "cpu", str(tmp_path), "found nothing wrong"):
        assert word in told
    assert len(re.findall(r"^ok .*expected", told, re.MULTILINE)) == 6
    assert "FAILED" not in told


def test_doctor_finds_a_sag_that_is_wrong(capsys, monkeypatch):
    sag = robot.gravity_sag
    monkeypatch.setattr(robot, "gravity_sag", lambda arm, q: 1.001 * sag(arm, q))

    def no_cut(*args, **options):
        raise RuntimeError("no compiler")

    monkeypatch.setattr("diffmill.sim.simulate_process", no_cut)
    assert main(["doctor", "--quiet"]) == 1
    told, errors = capsys.readouterr()
    assert "FAILED sag of an arm" in errors and "no compiler" in errors
    assert not told
