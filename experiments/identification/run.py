"""Run all groups of identification figures, or those named, and write their tables.

python experiments/identification/run.py [coverage measured ...] [--out FOLDER]

`measured`, `kinematics` and `reversal` need the folder of reference data in
DIFFMILL_REFERENCE_DATA.
"""

import pathlib
import sys

HERE = pathlib.Path(__file__).parent
# The runner is shared with other experiments.
sys.path += [str(HERE.parent / "common"), str(HERE.parents[1] / "tests")]

GROUPS = (
    *("coverage", "measured", "load_tests", "coupled", "kinematics", "reversal"),
    "speed",
)


if __name__ == "__main__":
    import jax

    from reporting import run_groups

    jax.config.update("jax_enable_x64", True)
    run_groups("diffmill identification", __doc__, GROUPS, HERE / "results")
