"""Importing what files and figures of a run need while the run computes."""

import contextlib
import io
import threading

import numpy as np


def import_ahead() -> None:
    """Begin to import it in a thread of its own, for which nobody waits.

    These packages take seconds to import, for which a run that computes outside of
    Python has the time.
    """
    threading.Thread(target=_use, daemon=True).start()


def _use() -> None:
    """Use each package a little: what it imports late is imported, too."""
    # What fails here fails again where it is needed, and can be told.
    with contextlib.suppress(Exception):
        import xarray

        xarray.Dataset().to_netcdf(engine="h5netcdf")
    with contextlib.suppress(Exception):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(layout="constrained")
        figure.subplots()
        FigureCanvasAgg(figure).print_png(io.BytesIO())
    with contextlib.suppress(Exception):
        from ...numerics import lowpass

        lowpass(np.zeros((64, 1)), 10.0, 1.0)
