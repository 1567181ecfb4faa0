"""Measured records, prepared and set beside the simulation.

What it models: a record of three forces over time with what is doubtful in it marked
sample by sample; the removal of offset and drift; the cuts in it; its alignment with
the spindle; the ways in which a dynamometer can be mounted.
Assumptions: forces are calibrated; the record was sampled at one rate, except for
gaps; the amplifier drifts along a straight line between two tare sections.
Left out: the dynamometer's own dynamics. Files are read by `diffmill.io.load_record`.
Nothing here is applied unasked: functions return new records or proposals.
"""

from ._record import Record as Record
from ._saturation import find_saturated as find_saturated
