"""The results of a campaign as one dataset, indexed by what varies."""

import json
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from ..config import Campaign
from ..io import described
from ..units import base_quantity
from ._task import JobRecord

if TYPE_CHECKING:
    import xarray

_FIGURES = {
    "error_rms": ("m", "root mean square contour error where the tool cuts"),
    "error_p95": ("m", "95 % of the rows that cut have a smaller contour error"),
    "error_max": ("m", "largest contour error where the tool cuts"),
    "force_mean": ("N", "mean length of the force where the tool cuts"),
    "force_max": ("N", "largest length of the force"),
    "removed_volume": ("m3", "removed volume"),
    "program_time": ("s", "time that the program takes"),
    "max_acceleration": ("m s-2", "largest acceleration of the commanded tip"),
}
_STATES = ("done", "failed", "refused", "lost", "missing")


def campaign_dataset(
    campaign: Campaign, digests: list[str], records: dict[str, JobRecord]
) -> "xarray.Dataset":
    """Return the figures of all jobs on the dimensions of a campaign.

    Args:
        campaign: The campaign.
        digests: Hash of every job, in the order of the campaign.
        records: Record of each job, by its hash.
    """
    import xarray

    shape = campaign.shape
    names = tuple(variation.name for variation in campaign.variations)
    absent = JobRecord(status="missing", message="", figures={}, seconds=np.nan)
    rows = [records.get(digest, absent) for digest in digests]

    def grid(values: list[Any], dtype: Any) -> np.ndarray:
        return np.array(values, dtype).reshape(shape)

    about_status = {
        "units": "1",
        "flag_values": np.arange(len(_STATES), dtype=np.int8),
        "flag_meanings": " ".join(_STATES),
    }
    states = grid([_STATES.index(row["status"]) for row in rows], np.int8)
    seconds = grid([row["seconds"] for row in rows], float)
    about_seconds = {"units": "s", "long_name": "time of the run with compilation"}
    variables: dict[str, Any] = {
        "status": (names, states, about_status),
        "message": (names, grid([row["message"] for row in rows], object)),
        "job_hash": (names, grid(digests, object)),
        "run_time": (names, seconds, about_seconds),
    }
    cases = list(dict.fromkeys(case for row in rows for case in row["figures"]))
    coordinates: dict[str, Any] = {}
    dims, size = names, shape
    if campaign.command == "correct" and cases:
        coordinates["case"] = cases
        dims, size = (*names, "case"), (*shape, len(cases))
    for name, (unit, meaning) in _FIGURES.items():
        values = [
            row["figures"].get(case, {}).get(name, np.nan)
            for row in rows
            for case in cases or [""]
        ]
        if not np.isnan(values).all():
            array = np.reshape(values, size)
            variables[name] = (dims, array, {"units": unit, "long_name": meaning})
    for index in range(len(campaign.variations)):
        variables |= _varied(campaign, index)
    is_done = bool(np.all(states == _STATES.index("done")))
    attributes = {
        "campaign": campaign.name,
        "source": campaign.source,
        "job": campaign.job.stem,
        "command": campaign.command,
        "incomplete": np.int32(not is_done),
    }
    dataset = xarray.Dataset(variables, coords=coordinates, attrs=attributes)
    return described(dataset.set_coords([n for n in names if n in dataset]))


def _varied(campaign: Campaign, index: int) -> dict[str, Any]:
    """Values of the keys that vary along a dimension, as variables on it."""
    variation = campaign.variations[index]
    name, changes = variation.name, variation.changes
    if name == "start":
        return {"start": ((name,), np.arange(len(changes)), {"units": "1"})}
    variables: dict[str, Any] = {}
    for key in changes[0]:
        values = [change[key] for change in changes]
        variables |= _variable(re.sub(r"[.-]", "_", key), name, key, values)
    if variation.factors:
        about = {"units": "1", "long_name": "factor of what the job holds"}
        variables[name] = ((name,), np.array(variation.factors), about)
    if name not in variables:
        variables[name] = ((name,), np.arange(len(changes)), {"units": "1"})
    return variables


def _variable(name: str, dim: str, key: str, values: list[Any]) -> dict[str, Any]:
    """Values of a key as variables: quantities of one kind in SI, others as text."""
    lists = [value if isinstance(value, list) else [value] for value in values]
    try:
        quantities = [[base_quantity(one) for one in entry] for entry in lists]
    except ValueError:
        quantities = []
    units = {one.unit for entry in quantities for one in entry}
    if len(units) != 1 or len({len(entry) for entry in quantities}) != 1:
        texts = [v if isinstance(v, str) else json.dumps(v) for v in values]
        return {name: ((dim,), np.array(texts, object), {"key": key})}
    numbers = np.array([[one.number for one in entry] for entry in quantities])
    if not any(isinstance(value, list) for value in values):
        numbers = numbers[:, 0]
    dims = (dim,) if numbers.ndim == 1 else (dim, f"{name}_entry")
    attributes = {"key": key, "units": units.pop() or "1"}
    if name == dim and numbers.ndim > 1:
        # A coordinate has one value per entry: of lists their text.
        texts = np.array([json.dumps(value) for value in values], object)
        return {
            name: ((dim,), texts, {"key": key}),
            f"{name}_values": (dims, numbers, attributes),
        }
    return {name: (dims, numbers, attributes)}
