"""Run all groups of figures on the robot's dynamics, or those named.

python experiments/robot/run.py [speed joints reach controller] [--out FOLDER]

Other programs take part where they are installed: pin, mujoco with mujoco-mjx, jaxsim.
"""

import pathlib
import sys

HERE = pathlib.Path(__file__).parent
# The runner is shared with other experiments.
sys.path.append(str(HERE.parent / "common"))

GROUPS = ("speed", "joints", "reach", "controller")


if __name__ == "__main__":
    from reporting import run_groups

    run_groups("diffmill robot", __doc__, GROUPS, HERE / "results")
