"""The report of a study: of an identification, of learning, of a feed."""

import os
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import equinox as eqx

from .html import (
    contents_html,
    image_html,
    items_html,
    page_html,
    section_html,
    table_html,
)
from .verdict import Verdict

# Sections that open when the reader asks for them.
_FOLDED = ("File", "As text")


class StudyTable(eqx.Module):
    """A table of a report.

    Attributes:
        title: Its title.
        header: Titles of its columns.
        rows: Its cells, a sequence for each row.
        note: Sentence below it.
        best: Index of the row in bold; None without one.
    """

    title: str = eqx.field(static=True)
    header: tuple[str, ...] = eqx.field(static=True)
    rows: tuple[tuple[str, ...], ...] = eqx.field(static=True)
    note: str = eqx.field(static=True, default="")
    best: int | None = eqx.field(static=True, default=None)


class StudyReport(eqx.Module):
    """Report of a study.

    Attributes:
        kind: What it is, in a word or two.
        title: Name of what was studied.
        asked: What was asked, a sentence, and of what, line by line.
        verdict: Whether the answer is to be used, and why.
        tables: Its numbers.
        assumptions: What was assumed, in sentences.
        warnings: Reasons to doubt the answer.
        notes: What was chosen, or is left to do.
        text: The summary of the terminal.
        source: Text of the file that asks.
        captions: Captions of the figures by how their names begin; the longest
            beginning counts.
    """

    kind: str = eqx.field(static=True)
    title: str = eqx.field(static=True)
    asked: tuple[str, ...] = eqx.field(static=True)
    verdict: Verdict
    tables: tuple[StudyTable, ...]
    assumptions: tuple[str, ...] = eqx.field(static=True)
    warnings: tuple[str, ...] = eqx.field(static=True, default=())
    notes: tuple[str, ...] = eqx.field(static=True, default=())
    text: str = eqx.field(static=True, default="")
    source: str = eqx.field(static=True, default="")
    captions: Mapping[str, str] = eqx.field(static=True, default_factory=dict)

    def sections(self) -> dict[str, str]:
        """Sections of a page with the tables and the assumptions, by title."""
        tables = {one.title: _table(one) for one in self.tables}
        return tables | {"Assumptions": items_html(self.assumptions)}

    def write(
        self, out_dir: str | os.PathLike[str], figures: Sequence[str] = ()
    ) -> Path:
        """Write `report.html` and return its path.

        Args:
            out_dir: Existing folder, with the figures.
            figures: Names of the PNG files, without suffix.

        **Differentiability**: runs on the host.
        """
        folder = Path(out_dir)
        images = [self._image(folder / f"{name}.png") for name in figures]
        question, *of_what = self.asked
        asked = f"<p>{escape(question)}</p>{items_html(of_what)}"
        content = {
            "What was asked": asked,
            **self.sections(),
            "Figures": "\n".join(images),
            "Notes": items_html(self.notes),
            "As text": f"<pre>{escape(self.text)}</pre>" if self.text else "",
            "File": f"<pre>{escape(self.source)}</pre>" if self.source else "",
        }
        content = {title: text for title, text in content.items() if text}
        body = [self._head(), contents_html([*content])]
        body += [
            section_html(title, text, is_folded=title in _FOLDED)
            for title, text in content.items()
        ]
        path = folder / "report.html"
        page = page_html(f"{self.title} - diffmill", "\n".join(body))
        path.write_text(page, encoding="utf-8")
        return path

    def _head(self) -> str:
        """Title, verdict and warnings."""
        mark = {True: " good", False: " bad", None: ""}[self.verdict.is_held]
        text = [
            f'<header><p class="kind">{escape(self.kind)}</p>'
            f"<h1>{escape(self.title)}</h1>",
            f'<p class="banner{mark}" id="verdict"><b>{escape(self.verdict.title)}.'
            f"</b> {escape(self.verdict.text)}</p>",
        ]
        if self.warnings:
            shown = items_html(self.warnings)
            text.append(f'<div class="banner bad" id="warnings">{shown}</div>')
        return "\n".join([*text, "</header>"])

    def _image(self, path: Path) -> str:
        """Figure with its title and caption."""
        fitting = [key for key in self.captions if path.stem.startswith(key)]
        caption = self.captions[max(fitting, key=len)] if fitting else ""
        title = path.stem.replace("_", " ").capitalize()
        return image_html(path, title, caption)


def _table(one: StudyTable) -> str:
    """Table with the note below it; nothing without rows."""
    if not one.rows:
        return ""
    note = f'<p class="note">{escape(one.note)}</p>' if one.note else ""
    return table_html(one.header, one.rows, best=one.best) + note
