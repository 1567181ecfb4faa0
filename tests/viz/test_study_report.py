"""The report of a study: what it says, that it is escaped, and that it fits a phone."""

import numpy as np
import pytest
from browser import browser

from diffmill.viz import StudyReport, StudyTable, Verdict, plot_jacobian, save_figure

from .test_report import read

HEADER = ("quantity", "value", "standard error", "95 %", "unit", "remark")
ROW = ("K_tc of a long name", "989.8", "3.2", "983.5 to 996.1", "N/mm^2", "<i>x</i>")


@pytest.fixture
def report(tmp_path):
    """Write a report with a picture and return its path."""
    save_figure(plot_jacobian(np.eye(5)), tmp_path / "left_out_1.png")
    study = StudyReport(
        kind="Identification",
        title="<b>slot</b>",
        asked=("what was asked", "of which file"),
        verdict=Verdict(True, "Found", "1 of 1 values."),
        tables=(
            StudyTable("Estimates", HEADER, (ROW, ROW), "A note.", best=1),
            StudyTable("Nothing", HEADER, ()),
        ),
        assumptions=("The arm is <linear>.",),
        warnings=("The sign may be wrong.",),
        text="K_tc  989.8",
        source='kind = "<mean>"',
        captions={"left": "Not this.", "left_out": "Rows that the fit did not see."},
    )
    return study.write(tmp_path, ["left_out_1"])


def test_it_says_what_was_asked_found_and_assumed(report):
    page = read(report)
    for part in (
        "Found . 1 of 1 values.",
        "what was asked of which file",
        "989.8 3.2 983.5 to 996.1 N/mm^2 <i>x</i>",
        "A note.",
        "The arm is <linear>.",
        "The sign may be wrong.",
        "Left out 1. Rows that the fit did not see.",
        "<b>slot</b>",
        'kind = "<mean>"',
    ):
        assert part.replace(" ", "") in page.text.replace(" ", "")
    titles = [attributes["id"] for tag, attributes in page.tags if tag == "section"]
    expected = ["what-was-asked", "estimates", "assumptions", "figures"]
    assert titles == [*expected, "as-text", "file"]
    assert "i" not in {tag for tag, _ in page.tags}
    images = [attributes for tag, attributes in page.tags if tag == "img"]
    assert [one["src"][:22] for one in images] == ["data:image/png;base64,"]


@pytest.mark.parametrize("look", [{}, {"dark": True}, {"width": 390, "height": 844}])
def test_it_fits_the_page_without_a_complaint(tmp_path, report, look):
    with browser(tmp_path / "browser") as page:
        page.open(report, **look)
        assert page.value(
            "document.documentElement.scrollWidth <= "
            "document.documentElement.clientWidth"
        )
        assert page.complaints == []
