"""Run all groups of figures on the correction, or those named.

python experiments/correction/run.py [methods details mismatch placement
    feed long controller] [--out FOLDER]
"""

import pathlib
import sys

HERE = pathlib.Path(__file__).parent
# The runner is shared with other experiments.
sys.path.append(str(HERE.parent / "common"))

GROUPS = (
    "methods",
    "details",
    "mismatch",
    "placement",
    "feed",
    "long",
    "controller",
)


if __name__ == "__main__":
    import jax

    import diffmill

    jax.config.update("jax_enable_x64", True)
    diffmill.use_compile_cache()
    from reporting import run_groups

    run_groups("diffmill correction", __doc__, GROUPS, HERE / "results")
