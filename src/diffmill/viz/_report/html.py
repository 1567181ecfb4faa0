"""Small pieces of HTML: escaped text, tables, figures and the page around them.

Everything that comes from a job, a program or a result passes `escape` here.
"""

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple

_STYLE = Path(__file__).with_name("page.css")
# The page may use what is in it and nothing else.
_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'"
)


def table_html(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    is_text: bool = False,
    colours: Sequence[str] | None = None,
    best: int | None = None,
) -> str:
    """Return a table; every cell is escaped.

    Args:
        header: Column titles.
        rows: Cells as text, one sequence per row.
        is_text: True if the cells are words (left), not numbers (right).
        colours: Colour of the swatch before each row, as hexadecimal RGB.
        best: Index of the row to print in bold.
    """
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    body = []
    for index, row in enumerate(rows):
        cells = [escape(cell) for cell in row]
        if colours is not None:
            cells[0] = f'<i style="background:{escape(colours[index])}"></i>{cells[0]}'
        mark = ' class="best"' if index == best else ""
        # A phone shows a row as a card: every cell under its own title.
        labelled = [
            f'<td data-label="{escape(title)}">{cell}</td>'
            for title, cell in zip(header, cells, strict=True)
        ]
        body.append(f"<tr{mark}>" + "".join(labelled) + "</tr>")
    kind = ' class="text"' if is_text else ""
    return (
        f'<div class="scroll"><table{kind}><thead><tr>{head}</tr></thead><tbody>'
        + "\n".join(body)
        + "</tbody></table></div>"
    )


class LargeNumber(NamedTuple):
    """A number with its unit, and its meaning."""

    number: str
    meaning: str


def numbers_html(items: Sequence[LargeNumber]) -> str:
    """Return large numbers with a line of explanation below each."""
    blocks = [
        f"<div><b>{escape(item.number)}</b><span>{escape(item.meaning)}</span></div>"
        for item in items
    ]
    return f'<div class="numbers">{"".join(blocks)}</div>'


def image_html(path: Path, title: str, caption: str) -> str:
    """Return a figure with the PNG at `path` inside the page."""
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return (
        f'<figure><img alt="{escape(title)}" src="data:image/png;base64,{data}">'
        f"<figcaption><b>{escape(title)}.</b> {escape(caption)}</figcaption></figure>"
    )


def items_html(lines: Sequence[str]) -> str:
    """Return lines as a list, or nothing."""
    if not lines:
        return ""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f'<ul class="notes">{items}</ul>'


def section_html(title: str, *blocks: str, is_folded: bool = False) -> str:
    """Return a titled section, or nothing when all blocks are empty.

    Args:
        title: Its title.
        blocks: Its content.
        is_folded: True if it opens when the reader asks for it.
    """
    content = "\n".join(block for block in blocks if block)
    if not content:
        return ""
    if is_folded:
        content = f"<details><summary>show</summary>{content}</details>"
    anchor = escape(_anchor(title))
    return f'<section id="{anchor}"><h2>{escape(title)}</h2>\n{content}</section>'


def contents_html(titles: Sequence[str]) -> str:
    """Return links to sections."""
    links = [f'<a href="#{escape(_anchor(t))}">{escape(t)}</a>' for t in titles]
    return f'<nav aria-label="contents">{"".join(links)}</nav>'


def _anchor(title: str) -> str:
    """Name of a section within the page."""
    return title.lower().replace(" ", "-")


def page_html(title: str, body: str) -> str:
    """Return a complete page that needs no other file."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(title)}</title>\n"
        f"<style>{_STYLE.read_text(encoding='utf-8')}</style></head>\n"
        f"<body><main>{body}</main></body></html>\n"
    )
