"""Run all groups of figures of performance, or those named.

python experiments/performance/run.py [deep ...] [--out FOLDER]
"""

import pathlib
import sys

HERE = pathlib.Path(__file__).parent
# The runner is shared with other experiments.
sys.path.append(str(HERE.parent / "common"))

GROUPS = (
    "first",
    "second",
    "step",
    "flags",
    "deep",
    "linear",
    "lengths",
    "long",
    "adaptive",
    "apart",
    "batch",
    "process",
    "expected",
    "device",
    "machine_code",
)


if __name__ == "__main__":
    from diffmill import use_compile_cache
    from reporting import run_groups

    # As commands run; NPROC in the environment gives XLA more threads.
    use_compile_cache()
    run_groups("diffmill performance", __doc__, GROUPS, HERE / "results")
