"""Run all groups of learning figures, or those named, and write their tables.

python experiments/learning/run.py [tracked points right ...] [--out FOLDER]
"""

import pathlib
import sys

HERE = pathlib.Path(__file__).parent
# The runner is shared with other experiments.
sys.path.append(str(HERE.parent / "common"))

GROUPS = ("tracked", "flange", "points", "right", "transfer", "robust")


if __name__ == "__main__":
    import jax

    import diffmill as dm
    from reporting import run_groups

    jax.config.update("jax_enable_x64", True)
    dm.use_compile_cache()
    run_groups("diffmill learning", __doc__, GROUPS, HERE / "results")
