"""Small pieces of HTML: escaped text, tables, figures and the page around them.

Everything that comes from a job, a program or a result passes `escape` here.
"""

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

_STYLE = """
:root { --ink: #1d2330; --soft: #5b6475; --line: #e3e6ec; --accent: #0072b2;
  --paper: #ffffff; --wash: #f6f7f9; --warn: #b3261e; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue",
  Arial, sans-serif; }
main { max-width: 60rem; margin: 0 auto; padding: 3rem 1.5rem 4rem; }
header p.kind { margin: 0; color: var(--accent); font-weight: 600; font-size: .85rem;
  letter-spacing: .06em; text-transform: uppercase; }
h1 { font-size: 2.1rem; line-height: 1.15; margin: .2rem 0 .6rem;
  letter-spacing: -.015em; overflow-wrap: anywhere; }
h2 { font-size: 1.3rem; margin: 3rem 0 .8rem; padding-top: 1rem;
  border-top: 1px solid var(--line); letter-spacing: -.01em; }
p.lead { font-size: 1.1rem; color: var(--soft); margin: 0 0 1.6rem; max-width: 46rem; }
.numbers { display: flex; flex-wrap: wrap; gap: 1rem; margin: 1.4rem 0; padding: 0; }
.numbers div { flex: 1 1 11rem; background: var(--wash); border-radius: .6rem;
  padding: .9rem 1.1rem; }
.numbers b { display: block; font-size: 1.75rem; line-height: 1.2; font-weight: 650;
  font-variant-numeric: tabular-nums; white-space: nowrap; }
.numbers span { color: var(--soft); font-size: .87rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .92rem;
  font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: .42rem .7rem; border-bottom: 1px solid var(--line);
  vertical-align: top; }
th { color: var(--soft); font-weight: 600; vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
table.text td, table.text th { text-align: left; overflow-wrap: anywhere; }
table:not(.text) td:first-child { white-space: nowrap; }
tr.best td { font-weight: 650; }
td i { display: inline-block; width: .75rem; height: .75rem; border-radius: .2rem;
  margin-right: .55rem; vertical-align: -.05rem; }
p.note { color: var(--soft); font-size: .88rem; }
figure { margin: 1.6rem 0 2.4rem; break-inside: avoid; }
figure img { width: 100%; height: auto; display: block; }
figcaption { font-size: .92rem; color: var(--soft); margin-top: .6rem;
  max-width: 48rem; }
figcaption b { color: var(--ink); }
pre { background: var(--wash); border-radius: .6rem; padding: 1rem 1.2rem;
  font: .82rem/1.5 ui-monospace, "DejaVu Sans Mono", Menlo, Consolas, monospace;
  overflow-x: auto; white-space: pre-wrap; overflow-wrap: anywhere; }
.banner { border-left: .35rem solid var(--warn); background: #fdeeec;
  padding: .9rem 1.1rem; border-radius: .3rem; margin: 1.2rem 0; }
.banner b { color: var(--warn); }
ul.notes li { margin: .3rem 0; }
@media print {
  body { font-size: 10pt; } main { max-width: none; padding: 0; }
  .screen { display: none; } h2 { break-after: avoid; margin-top: 1.6rem; }
  .numbers div, .banner, pre { print-color-adjust: exact;
    -webkit-print-color-adjust: exact; }
  @page { margin: 16mm; }
}
"""


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
        is_text: Whether the cells are words (left) or numbers (right).
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
        body.append(f"<tr{mark}>" + "".join(f"<td>{c}</td>" for c in cells) + "</tr>")
    kind = ' class="text"' if is_text else ""
    return (
        f'<div class="scroll"><table{kind}><thead><tr>{head}</tr></thead><tbody>'
        + "\n".join(body)
        + "</tbody></table></div>"
    )


def numbers_html(items: Sequence[tuple[str, str]]) -> str:
    """Return large numbers with a line of explanation below each."""
    blocks = [
        f"<div><b>{escape(number)}</b><span>{escape(meaning)}</span></div>"
        for number, meaning in items
    ]
    return f'<div class="numbers">{"".join(blocks)}</div>'


def image_html(path: Path, title: str, caption: str) -> str:
    """Return a figure with the PNG at `path` inside the page."""
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return (
        f'<figure><img alt="{escape(title)}" src="data:image/png;base64,{data}">'
        f"<figcaption><b>{escape(title)}.</b> {escape(caption)}</figcaption></figure>"
    )


def section_html(title: str, *blocks: str) -> str:
    """Return a titled section, or nothing when all blocks are empty."""
    content = "\n".join(block for block in blocks if block)
    return f"<section><h2>{escape(title)}</h2>\n{content}</section>" if content else ""


def page_html(title: str, body: str) -> str:
    """Return a complete page that needs no other file."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style></head>\n"
        f"<body><main>{body}</main></body></html>\n"
    )
