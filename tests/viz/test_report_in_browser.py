"""The report in a real browser: it draws, answers to the mouse, fits, and prints."""

import itertools

import numpy as np
import pytest
from browser import browser
from matplotlib.image import imread

from diffmill.viz import write_figures, write_report

from .synthetic import force_record, surface_error

LOOKS = {
    "light": {},
    "dark": {"dark": True},
    "phone": {"width": 390, "height": 844},
    "print": {"width": 673, "media": "print"},
}


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    with browser(tmp_path_factory.mktemp("browser")) as found:
        yield found


@pytest.fixture(scope="module")
def report(tmp_path_factory, correction, job):
    folder = tmp_path_factory.mktemp("report")
    count = correction.sizes["step"]
    joints = np.stack([np.linspace(0, 0.1, count)] * 3, axis=1)
    maps = {"uncorrected": surface_error(), "corrected": surface_error(0.05)}
    result = correction.assign(
        joint_positions=(("case", "step", "joint"), np.stack([joints] * 5)),
        contour_mean=(("case", "axis"), np.zeros((5, 3))),
        part_rms=(("case", "part"), np.full((5, 4), 1e-6)),
        part_max=(("case", "part"), np.full((5, 4), 2e-6)),
        part_rows=(("part",), np.full(4, 20, np.int32)),
        max_acceleration=(("case",), np.ones(5)),
    ).assign_coords(part=["entry", "exit", "corner", "plateau"])
    result.attrs |= {f"corrected_setting_number_{k}": float(k) for k in range(12)}
    result.attrs["tolerance_band"] = 2e-6
    figures = write_figures(folder, result, forces=force_record(), surfaces=maps)
    return write_report(folder, result, figures, surfaces=maps, job=job)


def drawn(page, name):
    """Return the pixels of a canvas, shape (pixel, 4)."""
    return np.array(
        page.value(
            f"Array.from(document.getElementById('{name}').getContext('2d')"
            ".getImageData(0, 0, 300, 300).data)"
        )
    ).reshape(-1, 4)


@pytest.mark.parametrize("look", LOOKS)
def test_it_draws_without_an_error_or_a_request(page, report, look):
    page.open(report, **LOOKS[look])
    for name in ("scene", "history"):
        pixels = drawn(page, name)
        assert len(np.unique(pixels, axis=0)) > 20, name
    assert page.complaints == []
    fetched = [url for url in page.requests if not url.startswith("data:")]
    assert fetched == [report.as_uri()]


@pytest.mark.parametrize("look", LOOKS)
def test_nothing_is_wider_than_the_page(page, report, look):
    page.open(report, **LOOKS[look])
    too_wide = page.value(
        "[...document.querySelectorAll('table, pre, canvas, img, .banner')]"
        ".filter(one => one.checkVisibility() && (one.getBoundingClientRect().right >"
        " document.documentElement.clientWidth || one.scrollWidth > one.clientWidth + 1"
        " || one.parentElement.scrollWidth > one.parentElement.clientWidth + 1))"
        ".map(one => one.outerHTML.slice(0, 200))"
    )
    assert too_wide == []
    assert page.value(
        "document.documentElement.scrollWidth <= document.documentElement.clientWidth"
    )


@pytest.mark.parametrize("look", ["light", "dark"])
def test_text_stands_out_from_what_is_behind_it(page, report, look):
    """The contrast that WCAG 2 asks for, 4.5 to 1 (its level AA)."""
    page.open(report, **LOOKS[look])
    low = page.value(
        """(() => {
          const light = (text) => {
            const [r, g, b] = text.match(/[\\d.]+/g).map(Number).map((v) => v / 255)
              .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
            return 0.2126 * r + 0.7152 * g + 0.0722 * b;
          };
          const behind = (one) => {
            for (let at = one; at; at = at.parentElement) {
              const found = getComputedStyle(at).backgroundColor;
              if (!found.endsWith(", 0)")) return found;
            }
            return "rgb(255, 255, 255)";
          };
          return [...document.querySelectorAll("p, b, td, th, li, button, output, pre")]
            .map((one) => [one.tagName, one.className, [getComputedStyle(one).color,
              behind(one)].map(light).sort((a, b) => b - a)])
            .filter(([, , [high, low]]) => (high + 0.05) / (low + 0.05) < 4.5);
        })()"""
    )
    assert low == []


def test_slider_curves_and_path_show_one_moment(page, report):
    page.open(report)
    said = "document.getElementById('readout').textContent"
    page.value(
        "(() => { const one = document.getElementById('moment'); one.value = 150;"
        " one.dispatchEvent(new Event('input')); })()"
    )
    page.settle()
    before = page.value(said)
    assert before.startswith("0.563 s") and "contour error" in before
    box = "document.getElementById('history').getBoundingClientRect().toJSON()"
    page.value("document.getElementById('history').scrollIntoView()")
    place = page.value(box)
    page.mouse(
        "mouseMoved",
        place["x"] + 0.75 * place["width"],
        place["y"] + 0.5 * place["height"],
    )
    row = int(page.value("document.getElementById('moment').value"))
    assert row > 200 and page.value(said) != before


def test_it_turns_and_shows_the_case_that_is_asked_for(page, report, tmp_path):
    page.open(report)
    page.value("document.getElementById('scene').scrollIntoView()")
    page.settle()
    place = page.value(
        "document.getElementById('scene').getBoundingClientRect().toJSON()"
    )
    x, y = place["x"] + 0.5 * place["width"], place["y"] + 0.5 * place["height"]
    pictures = []
    steps = {
        "at first": lambda: None,
        "turned": lambda: drag(page, x, y, 120),
        "other case": lambda: page.value(
            "document.querySelector('[data-case=\"0\"]').click()"
        ),
        "arm": lambda: page.value("document.querySelector('[data-view=arm]').click()"),
    }
    for act in steps.values():
        act()
        page.settle()
        page.screenshot(tmp_path / "scene.png")
        pictures.append(imread(tmp_path / "scene.png")[:400])
    for before, after in itertools.pairwise(pictures):
        assert np.mean(np.abs(before - after).max(axis=2) > 0.1) > 0.002
    assert "uncorrected" in page.value("document.getElementById('readout').textContent")
    assert page.complaints == []


def drag(page, x, y, length):
    page.mouse("mousePressed", x, y, button="left", clickCount=1)
    page.mouse("mouseMoved", x + length, y, button="left", buttons=1)
    page.mouse("mouseReleased", x + length, y, button="left", clickCount=1)


@pytest.mark.parametrize("dark", [False, True])
def test_it_prints_on_pages(page, report, dark):
    page.open(report, dark=dark)
    text = page.pdf()
    assert text.startswith(b"%PDF") and 4 <= text.count(b"/Type /Page\n") <= 15
    assert page.complaints == []
