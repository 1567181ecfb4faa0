"""Run all groups of figures of the cutting process, or those named.

python experiments/cutting/run.py [closed_form finishing ball ...] [--out FOLDER]
"""

import pathlib
import sys

HERE = pathlib.Path(__file__).parent
# The runner is shared with other experiments, the reference with the tests.
sys.path += [str(HERE.parent / "common"), str(HERE.parents[1] / "tests")]

GROUPS = (
    "chip",
    "closed_form",
    "finishing",
    "ball",
    "walls",
    "rotation",
    "volume",
    "ripple",
    "slopes",
    "deviation",
    "cost",
)


if __name__ == "__main__":
    from reporting import run_groups

    run_groups("diffmill cutting", __doc__, GROUPS, HERE / "results")
