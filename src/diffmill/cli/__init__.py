"""The command line: `diffmill simulate`, `correct`, `feed`, `identify`, `robot`, ...

Reads a job, runs it and writes a folder of results. The only place that configures
JAX, prints, and turns errors into exit codes: 0 for success, 2 for bad input (nothing
is written), 1 for a run that failed (what it had computed is kept and marked).

Assumes that one job fills the machine: jobs run one after the other. Leaves out
campaigns and other program formats. What computes is imported only once there is
something to compute, so that help is quick.
"""

from ._main import main as main
