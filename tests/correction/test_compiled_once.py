"""A sweep of corrections: the first job compiles, the others do not."""

import numpy as np
import pytest
from slides_job import write_slides_job

import diffmill as dm

PROGRAM = "G21 G17 G90 G94\nG0 X-5.5 Y1 Z-0.8\nG1 X1 F1500\nM2\n"
# One number of each kind that is edited in the files of a job; the path keeps its rows.
EDITS = {
    "nothing": ("[correction]", "[correction]"),
    "joint stiffness": ("1.0e6", "0.7e6"),
    "joint damping": ('"2 kN*s/m"', '"1.5 kN*s/m"'),
    "axial depth": ("Z-0.8", "Z-0.85"),
    "feed": ("F1500", "F1501"),
    "K_tc": ("989.8", "850"),
    "diameter": ('"10 mm"', '"10.1 mm"'),
    "spindle speed": ("8000 rpm", "8010 rpm"),
    "largest offset": ("[correction]", "[correction]\nmax_offset = '3 um'"),
    # As many knots as before, at which the spline is the same.
    "knot spacing": ("[correction]", "[correction]\nknot_spacing = '31 ms'"),
}


@pytest.mark.slow
def test_a_sweep_compiles_nothing_after_its_first_job(tmp_path, compilations):
    counts, errors, rows = {}, {}, set()
    for name, (old, new) in EDITS.items():
        folder = tmp_path / name
        folder.mkdir()
        file = write_slides_job(folder, program=PROGRAM)
        for part in folder.iterdir():
            part.write_text(part.read_text().replace(old, new))
        del compilations[:]
        job = dm.load_job(file)
        dm.simulate(job)
        after = dm.correct(job).after
        counts[name] = len(compilations)
        errors[name] = float(np.linalg.norm(after.contour_error))
        rows.add(job.path.step_count)
    assert len(rows) == 1
    assert counts.pop("nothing") > 0
    assert not any(counts.values()), counts
    # Every job but the last is corrected by another command.
    assert len(set(errors.values())) == len(EDITS) - 1
