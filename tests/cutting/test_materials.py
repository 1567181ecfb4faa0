import importlib.resources
import json
import os
import pathlib
import tomllib

import pytest
from helpers import PAPER_LAW

from diffmill import cutting

ROOT = pathlib.Path(__file__).parents[2]
DATA = ROOT / os.environ.get("DIFFMILL_REFERENCE_DATA", "../shared/data")
COLLECTION = DATA / "forces" / "coefficients.json"
NAMES = cutting.LinearEdgeLaw.NAMES


def coefficients(name):
    law = cutting.material(name).law
    return [getattr(law, coefficient) for coefficient in NAMES]


def test_the_papers_aluminium():
    wanted = [getattr(PAPER_LAW, coefficient) for coefficient in NAMES]
    assert coefficients("aluminium_3.1325") == pytest.approx(wanted)


def test_names_are_listed_when_one_is_unknown():
    names = tuple(cutting.materials())
    assert names == tuple(sorted(names))
    with pytest.raises(ValueError, match="cheese") as error:
        cutting.material("cheese")
    for name in names:
        assert name in str(error.value)


@pytest.mark.parametrize("name", cutting.materials())
def test_every_row_is_plausible_and_has_its_source(name):
    K_tc, K_rc, K_ac, K_te, K_re, K_ae = coefficients(name)
    # Plastics to hard steel, N/mm^2 and N/mm: a wrong unit is out of it.
    assert 100e6 < K_tc < 6000e6
    assert 0 < K_rc < K_tc
    assert 0 <= K_ac < K_tc
    assert 1e3 < K_te < 100e3
    assert 1e3 < K_re < 100e3
    assert 0 <= K_ae < K_re
    source = cutting.material(name).source
    for part in ("cutter: ", "conditions: "):
        assert part in source
    assert ("no axial coefficients" in source) == (K_ac == 0)


def test_rows_hold_what_is_read():
    file = importlib.resources.files("diffmill.cutting").joinpath("materials.toml")
    known = {"class", "source", "cutter", "conditions", "lacks"}
    known |= {f"K_{i}c_MPa" for i in "tra"} | {f"K_{i}e_N_per_mm" for i in "tra"}
    for row in tomllib.loads(file.read_text(encoding="utf-8")).values():
        assert set(row) <= known
        assert {"K_tc_MPa", "K_rc_MPa", "source", "cutter", "conditions"} <= set(row)


@pytest.mark.skipif(not COLLECTION.is_file(), reason="no reference data")
def test_every_row_is_in_the_verified_collection():
    data = json.loads(COLLECTION.read_text())
    entries = [e for e in data["entries"] if e["verified"] and not e.get("suspect")]
    known = [[value or 0.0 for value in entry["values"]] for entry in entries]
    for K_tc, K_te, K_rc, K_re, _ in data["AMMP"]["rows"].values():
        known.append([K_tc / 1e6, K_rc / 1e6, 0.0, K_te / 1e3, K_re / 1e3, 0.0])
    scales = [1e6] * 3 + [1e3] * 3
    for name in cutting.materials():
        row = [
            value / scale
            for value, scale in zip(coefficients(name), scales, strict=True)
        ]
        assert any(row == pytest.approx(other, rel=1e-9) for other in known), name
