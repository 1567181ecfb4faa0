"""The file of the machined surface's error."""

import pathlib
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ...workpiece import SurfaceError


def write_surface(file: pathlib.Path, surfaces: "dict[str, SurfaceError]") -> None:
    """Write the errors of the machined surface as netCDF, a row for each point.

    Args:
        file: Path of the file.
        surfaces: Surface error by case.
    """
    import xarray

    def rows(name: str) -> np.ndarray:
        return np.concatenate([getattr(item, name) for item in surfaces.values()])

    def about(meaning: str, units: str = "1") -> dict[str, str]:
        return {"units": units, "long_name": meaning}

    counts = [len(item.error) for item in surfaces.values()]
    distance = "distance from the ideal surface, positive where material was left"
    normal = "outward normal of the ideal surface at its nearest place"
    dataset = xarray.Dataset(
        {
            "surface_error": ("point", rows("error"), about(distance, "m")),
            "position": (
                ("point", "axis"),
                rows("points"),
                about("point on the machined surface in work", "m"),
            ),
            "normal": (("point", "axis"), rows("normal"), about(normal)),
            "is_floor": ("point", rows("is_floor"), about("a floor, else a wall")),
            "is_cut": (
                "point",
                rows("is_cut"),
                about("a tool cut the point, else it is left of the raw stock"),
            ),
        },
        coords={
            "case": ("point", np.repeat(list(surfaces), counts)),
            "axis": ["x", "y", "z"],
        },
        attrs={"Conventions": "CF-1.11"},
    )
    file.write_bytes(dataset.to_netcdf(engine="h5netcdf"))
