"""Traced programs that are kept on disk, and what is never taken for another one."""

import os
import pathlib
import subprocess
import sys
from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

from diffmill.numerics import CachedJit, clamp, materialise

# A function of the package that is kept; JAX's log says what is traced.
_CHILD = """
import jax, jax.numpy as jnp
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
from diffmill.robot import forward_kinematics, inverse_kinematics, load
robot = load("reis_rv130_like")
q = jnp.asarray([0.1, -1.5, 1.2, 0.2, 0.8, 0.1])
T = forward_kinematics(robot, q)
jax.config.update("jax_log_compiles", True)
found = inverse_kinematics(robot, T, q + 0.05)
print([float(x) for x in found.q], bool(found.converged))
"""


def _run_child(cache: pathlib.Path) -> tuple[str, bool]:
    """Return what a process says, and whether it traced the search."""
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(cache)}
    command = [sys.executable, "-c", _CHILD]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout, "tracing of_arrays" in ran.stderr


@pytest.mark.slow
def test_a_second_process_traces_nothing_and_a_damaged_file_is_written_again(tmp_path):
    first, has_traced = _run_child(tmp_path)
    assert has_traced
    assert _run_child(tmp_path) == (first, False)
    for path in (tmp_path / "programs").iterdir():
        whole = path.read_bytes()
        path.write_bytes(whole[: len(whole) // 2])
    assert _run_child(tmp_path) == (first, True)
    assert _run_child(tmp_path) == (first, False)


@pytest.fixture
def programs(tmp_path) -> Iterator[pathlib.Path]:
    """Return the folder in which programs are kept during a test."""
    before = getattr(jax.config, "jax_compilation_cache_dir")  # noqa: B009
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path / "programs"
    jax.config.update("jax_compilation_cache_dir", before)


def test_each_program_is_kept_once(programs):
    for _ in range(2):
        kept = CachedJit(clamp)
        for value in (0.5, 2.5):
            limits = jnp.asarray(0.0), jnp.asarray(1.0)
            assert float(kept(limits[0], jnp.asarray(value), limits[1])) == min(
                value, 1
            )
    assert len(list(programs.iterdir())) == 1


def test_other_sizes_types_constants_and_settings_are_other_programs(programs):
    x, flag = jnp.arange(3.0), True
    trees = [
        x,
        jnp.arange(4.0),
        x.astype(jnp.float32),
        (x,),
        [x],
        {"a": x},
        {"b": x},
        (x, 1),
        (x, 2),
        (x, 1.0),
        (x, flag),
        (x, None),
        (x, jnp.sin(x)),
    ]
    for _ in range(2):
        kept = CachedJit(materialise)
        for tree in trees:
            result = kept(tree)
            assert jax.tree.structure(result) == jax.tree.structure(tree)
            first, *_ = jax.tree.leaves(result)
            assert jnp.array_equal(first, jax.tree.leaves(tree)[0])
    assert len(list(programs.iterdir())) == len(trees)
    with jax.numpy_dtype_promotion("standard"):
        CachedJit(materialise)(x)
    with jax.default_matmul_precision("float32"):
        CachedJit(materialise)(x)
    assert len(list(programs.iterdir())) == len(trees) + 2


def test_what_is_defined_elsewhere_is_not_kept(programs):
    class Mine(eqx.Module):
        x: jax.Array

    assert CachedJit(materialise)(Mine(jnp.ones(2))).x.tolist() == [1.0, 1.0]
    assert CachedJit(lambda x: 2 * x)(jnp.ones(2)).tolist() == [2.0, 2.0]
    assert not programs.exists()


def test_nothing_is_kept_where_nothing_can_be_written(programs):
    programs.write_text("a file where the folder should be")
    assert CachedJit(materialise)(jnp.ones(2)).tolist() == [1.0, 1.0]


def test_what_jax_does_not_export_runs_all_the_same(programs):
    """As a check of a linear solver on the host, in derivatives of a balance."""

    def called_back(x: jax.Array) -> jax.Array:
        shape = jax.ShapeDtypeStruct(x.shape, x.dtype)
        return jax.pure_callback(lambda x: 2 * x, shape, x)

    # As if it were one of the package.
    called_back.__module__ = materialise.__module__
    called_back.__qualname__ = "called_back"
    assert CachedJit(called_back)(jnp.ones(2)).tolist() == [2.0, 2.0]
    assert not programs.exists()
