"""Classes of settings: keys, strategies and leaves."""

import dataclasses
from typing import Any

import jax
import pytest

from diffmill import CorrectionSettings, load_job
from diffmill.correction import AbstractObjective
from diffmill.settings.base import builds, key
from diffmill.settings.correction import (
    ObjectiveSettings,
    SurfaceErrorSettings,
)
from diffmill.settings.fields import Tolerance
from diffmill.settings.tables import read_settings
from small_job import PROGRAM, small_job


def test_keys_of_an_objective_may_stand_beside_its_name():
    given = CorrectionSettings(objective=SurfaceErrorSettings(wall_weight=0.5))
    beside: Any = {"objective": "surface", "wall_weight": 0.5}
    assert CorrectionSettings(**beside) == given
    changed = dataclasses.replace(given, floor_weight=2.0)
    assert changed.objective == SurfaceErrorSettings(0.5, 2.0)
    assert dataclasses.replace(given, objective="path") == CorrectionSettings()
    with pytest.raises(TypeError, match="wall_weight"):
        CorrectionSettings(**beside | {"objective": "path"})
    with pytest.raises(ValueError, match="'path' or 'surface'"):
        CorrectionSettings(objective="both")


def test_numbers_are_leaves_of_the_tree():
    settings = CorrectionSettings(objective="surface", max_offset=2e-3)
    leaves, tree = jax.tree.flatten(settings)
    assert sorted(leaves) == [0.0, 0.0, 2e-3, 1.0, 1.0]
    assert jax.tree.unflatten(tree, leaves) == settings
    other = CorrectionSettings(objective="surface", max_offset=3e-3)
    assert jax.tree.structure(other) == tree
    assert jax.tree.structure(CorrectionSettings()) != tree
    double = jax.jit(lambda x: jax.tree.map(lambda leaf: 2 * leaf, x))(settings)
    assert double.objective.wall_weight == 2.0 and double.method.case == "corrected"


@pytest.fixture
def height():
    """Return an objective that only this test knows."""

    class HeightSettings(ObjectiveSettings, name="height"):
        """Height of the tip above the path."""

        above: Tolerance = key("height that does not count", default=0.0)

    yield HeightSettings
    del ObjectiveSettings.members["height"]


def test_a_job_names_an_objective_of_a_script(height, tmp_path):
    class Height(AbstractObjective):
        above: float

        def errors(self, problem, motion, lag_weight):
            return motion.actual[:, 2]

    @builds(height)
    def _(settings, job, surface, weights):
        return Height(settings.above)

    (tmp_path / "part.ngc").write_text(PROGRAM)
    lines = '[correction]\nobjective = "height"\nabove = "20 um"'
    flat = 'diameter = "10 mm"\nteeth = 2\nkind = "flat"'
    (tmp_path / "job.toml").write_text(small_job(flat, program="part.ngc", more=lines))
    job = load_job(tmp_path / "job.toml")
    assert job.correction.objective == height(pytest.approx(2e-5))
    found = job.correction.objective.build(job, None, None)
    assert isinstance(found, Height) and found.above == pytest.approx(2e-5)
    faults = []
    read_settings(CorrectionSettings, {"objective": "height", "above": 1}, faults)
    assert faults == [
        "[correction] above: found 1 without a unit, but a length with its unit is "
        'required, such as "10 mm"'
    ]


def test_an_objective_without_a_builder_is_refused(height):
    with pytest.raises(ValueError, match="HeightSettings"):
        height().build(None, None, None)
