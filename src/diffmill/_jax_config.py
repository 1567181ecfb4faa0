"""JAX's settings: those of a command or of a campaign's worker, and the compile cache.

A script has settings of its own: it asks for the cache, and for nothing else.
"""

import contextlib
import ctypes
import errno
import os
import pathlib
import sys
import tempfile

# Folder of traced programs within that of compiled ones.
PROGRAMS = "programs"
# The newer emitters of fused loops compile a third longer, for code that is no faster.
# A tooth period is hundreds of operations of under a microsecond: handing them out one
# by one takes as long as they do. Loops over so few bytes become one function each,
# which fusions of the library YNN cannot be part of.
# An unknown flag ends a process, so they are set only where they are known.
_FLAGS = (
    "--xla_cpu_use_fusion_emitters=false",
    "--xla_cpu_experimental_ynn_fusion_type=",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=10000000",
)
_KNOWN = "0.10."
# Level of XLA's log that hides its boxes on slow compilation; JAX sets 1 at its import.
_QUIET_LOG, _DEFAULT_LOG = 3, "1"


def configure_jax(precision: str = "float64") -> str:
    """Set a precision, quick compiling and a compile cache that persists.

    Args:
        precision: "float64" or "float32".

    Returns:
        A note where compiled programs cannot be kept, else an empty text.
    """
    import jax

    jax.config.update("jax_enable_x64", precision == "float64")
    if "JAX_TRACEBACK_IN_LOCATIONS_LIMIT" not in os.environ:
        # Which line of Python an operation comes from: nobody reads it of a command,
        # and the compiler takes longer with it.
        with contextlib.suppress(AttributeError):
            jax.config.update("jax_traceback_in_locations_limit", 0)
    try:
        use_compile_cache()
    except OSError as error:
        # A cache that cannot be used costs compile time, not the run.
        jax.config.update("jax_enable_compilation_cache", False)
        return (
            f"the compile cache {error.filename} is not used ({error.strerror}), so "
            "that every run compiles anew; JAX_COMPILATION_CACHE_DIR names another "
            "folder"
        )
    return ""


def limit_threads() -> None:
    """Give XLA and LAPACK one thread each, unless the environment says how many.

    A library of LAPACK reads this when it is loaded: NumPy's at its import, SciPy's,
    which XLA calls, at the first call.
    """
    # XLA hands the many small operations of a tooth period from thread to thread, which
    # takes longer than they do: `experiments/performance/run.py step` shows it.
    os.environ.setdefault("NPROC", "1")
    # Nor do threads of LAPACK help systems of six unknowns: they wait, busily, for each
    # other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def use_compile_cache(folder: str | os.PathLike[str] | None = None) -> str:
    """Keep what is compiled in a folder, where later processes find it.

    A script or notebook calls this before anything is computed; commands always keep
    theirs, and both find what the other has compiled. XLA then takes one thread, which
    suits a simulation best, unless `NPROC` in the environment says how many, and so
    does LAPACK unless `OPENBLAS_NUM_THREADS` does. XLA no longer warns of slow
    compilation, unless `TF_CPP_MIN_LOG_LEVEL` sets its level.

    Args:
        folder: The folder; if not given, that of `JAX_COMPILATION_CACHE_DIR`, or
            `diffmill/jax` in the user's cache folder.

    Returns:
        The folder.

    Raises:
        OSError: The folder cannot be written to, or somebody else can write to it.
    """
    import jax

    limit_threads()
    hide_compiler_alarms()
    if jax.__version__.startswith(_KNOWN):
        given = os.environ.get("XLA_FLAGS", "").split()
        # What is given counts: the last of two flags does.
        new = [flag for flag in _FLAGS if flag not in given]
        os.environ["XLA_FLAGS"] = " ".join([*new, *given])
    named = os.environ.get("JAX_COMPILATION_CACHE_DIR") if folder is None else folder
    place = str(cache_folder() if not named else named)
    # A store of another kind, such as a bucket, is none that we can look into.
    if "://" not in place:
        try:
            pathlib.Path(place).mkdir(mode=0o700, parents=True, exist_ok=True)
            _refuse_shared(place)
            with tempfile.TemporaryFile(dir=place):
                pass
        except OSError as error:
            raise OSError(error.errno, error.strerror, place) from error
    jax.config.update("jax_compilation_cache_dir", place)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    return place


def hide_compiler_alarms() -> None:
    """Keep XLA's boxes of asterisks about slow compilation off the standard error.

    The display of progress says that something is compiled, and a fault of the compiler
    is raised. `TF_CPP_MIN_LOG_LEVEL` in the environment, if it is not 1, is left alone.
    """
    if os.environ.get("TF_CPP_MIN_LOG_LEVEL", _DEFAULT_LOG) != _DEFAULT_LOG:
        return
    with contextlib.suppress(ImportError, AttributeError):
        from jaxlib import utils  # pyright: ignore[reportAttributeAccessIssue]

        utils.absl_set_min_log_level(_QUIET_LOG)


def _refuse_shared(place: str) -> None:
    """Refuse a folder to which somebody else can write: its programs are executed."""
    if os.name == "nt":
        return
    for folder in (place, os.path.join(place, PROGRAMS)):
        if not os.path.lexists(folder):
            continue
        found = os.stat(folder)
        if found.st_uid != os.geteuid():
            raise OSError(errno.EPERM, "it belongs to another user", place)
        if found.st_mode & 0o022:
            text = "others can write to it: chmod -R go-w makes it yours alone"
            raise OSError(errno.EPERM, text, place)


def cache_folder() -> pathlib.Path:
    """Return the folder for compiled programs in the user's cache folder."""
    home = pathlib.Path.home()
    if sys.platform == "win32":
        root = pathlib.Path(os.environ.get("LOCALAPPDATA", home / "AppData" / "Local"))
    elif sys.platform == "darwin":
        root = home / "Library" / "Caches"
    else:
        root = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    return root / "diffmill" / "jax"


def give_back_memory() -> None:
    """Return freed memory to the system.

    A compiled program takes several times its final size while it is made, or read.
    Where the C library has no such function nothing is done.
    """
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
