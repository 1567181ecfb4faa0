"""Example jobs that come with the package: a TOML file beside its G-code.

`tiny` is one slot on a machine given by its modes, and done within a minute.
`paper` is the test part of the published experiment with sizes of our own;
`paper_small` has the same features, smaller, and is cut in a fraction of the time.
These two are cut by the built-in robot `reis_rv130_like` at its home pose; their
programs come from the generator `experiments/paper_part/generate.py` of the repository.

`measured_slot` is a measurement for `diffmill identify`, with its source.

Assumes nothing and computes nothing: these are files. They use only what a job file
can say; other parts, robots and materials are left out.
"""

from ._copy import (
    EXAMPLES as EXAMPLES,
    copy_example as copy_example,
)
