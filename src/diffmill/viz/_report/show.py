"""The view of the report in a notebook."""

from html import escape

import equinox as eqx

from ..._job import Job
from ...correction import Correction
from ...sim import Solution
from ...workpiece import SurfaceError
from .._cases import chosen_case
from .html import page_html
from .scene import scene_html
from .verdict import verdict

_HEIGHT_PX = 1040


class NotebookView(eqx.Module):
    """A page that a notebook shows in a frame of its own.

    Attributes:
        page: The page, which needs no other file.
    """

    page: str = eqx.field(static=True)

    def _repr_html_(self) -> str:
        """Frame with the page; its script reaches nothing outside it."""
        return (
            f'<iframe sandbox="allow-scripts" srcdoc="{escape(self.page)}" '
            f'style="width:100%;height:{_HEIGHT_PX}px;border:0"></iframe>'
        )


def show(
    result: Solution | Correction,
    job: Job | None = None,
    *,
    surfaces: dict[str, SurfaceError] | None = None,
) -> NotebookView:
    """Arm, part and path of a result, which turn in a notebook, below the verdict.

    Args:
        result: A solution, or a correction with all of its cases.
        job: Its job, for the arm, the tool and the raw part.
        surfaces: Surface errors by case, such as `Correction.surfaces`, which colour
            the part; "predicted" is the case of a solution.

    Returns:
        The view; a notebook shows it where it is the last value of a cell.

    Raises:
        ValueError: The result has under three steps.
    """
    dataset = result.to_dataset()
    scene = scene_html(dataset, chosen_case(dataset), surfaces=surfaces, job=job)
    if not scene:
        raise ValueError("Argument `result` must have three steps at least.")
    judged = verdict(dataset)
    text = f"<p><b>{escape(judged.title)}.</b> {escape(judged.text)}</p>"
    name = "result" if job is None else job.name
    return NotebookView(page_html(name, text + scene))
