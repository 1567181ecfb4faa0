"""Strict numerics for the whole test run."""

import gc
import os
import pathlib
import signal
import zlib
from collections.abc import Iterator

# As the commands do, before NumPy loads its library.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import jax
import jax.monitoring
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")


# The newer emitters of fused loops pass through MLIR: they take as long again as all
# else in the compiler. Tests use all cores already, so that no program is split.
_FAST_COMPILING = (
    "--xla_backend_optimization_level=0",
    "--xla_cpu_use_fusion_emitters=false",
    "--xla_cpu_parallel_codegen_split_count=1",
)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that runs a share of the tests."""
    parser.addoption(
        "--share", metavar="K/N", help="run the K-th of N shares of the tests, from 0"
    )


def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Leave out all tests but those of the share that is asked for."""
    asked = config.getoption("share", default=None)
    if asked is None:
        return
    share, _, count = asked.partition("/")
    if not (share.isdigit() and count.isdigit() and int(share) < int(count)):
        raise pytest.UsageError(f"--share: found {asked!r}, but K/N with K < N is read")
    of = lambda item: zlib.crc32(item.nodeid.encode()) % int(count) == int(share)
    config.hook.pytest_deselected(items=[item for item in items if not of(item)])
    items[:] = [item for item in items if of(item)]


def pytest_configure(config: pytest.Config) -> None:
    """Compile the fast tests quickly: that, not running, is most of their time."""
    is_fast = config.option.markexpr == "not slow"
    if is_fast and not config.getoption("benchmark_only", default=False):
        given = os.environ.get("XLA_FLAGS", "")
        # What is given counts: the last of two flags does.
        os.environ["XLA_FLAGS"] = " ".join([*_FAST_COMPILING, given])


# Tracing makes a great many objects that live on; searching them for those that do not
# is a fifth of the time of tests that trace gradients.
gc.set_threshold(100_000)

# Memory mappings from which on compiled programs are dropped. Each takes some tens, and
# Linux allows a process 65,530: one more ends the interpreter in the compiler.
_MOST_MAPPINGS = 20_000


@pytest.fixture(autouse=True, scope="module")
def drop_programs() -> Iterator[None]:
    """Drop compiled programs behind a module where a process holds many."""
    yield
    _drop_many_programs()


@pytest.fixture(autouse=True)
def drop_large_programs(request: pytest.FixtureRequest) -> Iterator[None]:
    """Drop them behind a slow test, of which a few may fill a process."""
    yield
    if request.node.get_closest_marker("slow"):
        _drop_many_programs()


def _drop_many_programs() -> None:
    maps = pathlib.Path("/proc/self/maps")
    if maps.is_file() and maps.read_bytes().count(b"\n") > _MOST_MAPPINGS:
        jax.clear_caches()


@pytest.fixture
def obeyed_interrupts() -> Iterator[None]:
    """Let SIGINT interrupt: what a shell starts in the background ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def here(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> pathlib.Path:
    """Return a folder of its own, which is the current one; tests share a cache."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path.parent / "cache"))
    return tmp_path


@pytest.fixture
def compilations() -> Iterator[list[str]]:
    """Return a list that grows by one with every program that is compiled."""
    names: list[str] = []

    def listen(event: str, duration_secs: float, **_: str | int) -> None:
        if event.endswith("backend_compile_duration"):
            names.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield names
    jax.monitoring.unregister_event_duration_listener(listen)
