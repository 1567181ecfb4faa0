"""Strict numerics for the whole test run."""

import os

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")


def pytest_configure(config: pytest.Config) -> None:
    """Compile the fast tests quickly: that, not running, is most of their time."""
    is_fast = config.option.markexpr == "not slow"
    if is_fast and not config.getoption("benchmark_only", default=False):
        given = os.environ.get("XLA_FLAGS", "")
        # What is given counts: the last of two flags does.
        os.environ["XLA_FLAGS"] = f"--xla_backend_optimization_level=0 {given}"
