"""Run all groups of figures, or those named, and write their tables.

python experiments/figures/run.py [accuracy depth volume ...] [--out FOLDER]
"""

import pathlib
import sys

HERE = pathlib.Path(__file__).parent
# The runner is shared with other experiments, the reference with the tests.
sys.path += [str(HERE.parent / "common"), str(HERE.parents[1] / "tests")]

GROUPS = (
    "accuracy",
    "depth",
    "volume",
    "coupling",
    "gradient",
    "integrator",
    "speed",
    "paper",
    "machines",
)


if __name__ == "__main__":
    from reporting import run_groups

    run_groups("diffmill figures", __doc__, GROUPS, HERE / "results")
