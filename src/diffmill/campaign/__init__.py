"""Campaigns: many jobs that differ in a few keys, in worker processes, one dataset.

`config.load_campaign` reads what varies: sweeps over a grid, draws of distributions,
starts of the optimiser. `run_campaign` computes every job once, on Dask workers that it
starts here or on a scheduler that is given by its address, and keeps a file for each as
soon as it is done. What has been kept is not computed again: a hash of all that a job
says names its file, so that an interrupted or extended campaign goes on from there.

Assumes that a job does not depend on another, and that workers elsewhere see the same
folders. A job that fails is an entry with its message. Left out: choosing the next job
by the results of those before.
"""

from ._run import run_campaign as run_campaign
