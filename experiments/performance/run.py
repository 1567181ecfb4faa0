"""Run all groups of figures of what a person waits for, or those named.

python experiments/performance/run.py [lengths batch ...] [--out FOLDER]
"""

import pathlib
import sys

HERE = pathlib.Path(__file__).parent
sys.path.append(str(HERE.parent / "common"))

GROUPS = ("lengths", "batch")


if __name__ == "__main__":
    import jax

    from reporting import run_groups

    jax.config.update("jax_enable_x64", True)
    run_groups("diffmill performance", __doc__, GROUPS, HERE / "results")
