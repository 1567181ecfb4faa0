"""Write the pages of the documentation that follow from other files of the project.

A hook of mkdocs: the start is the README's, tutorials are the notebooks, the keys of
job files are read from the source of their schema, so that no page can drift from them.
"""

import ast
import json
import pathlib
import re
import tomllib
from typing import TypeAlias

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = pathlib.Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "diffmill"
CONFIG = PACKAGE / "config"
Meanings: TypeAlias = dict[tuple[str, str], str]
AREAS = (
    *("cutter", "cutting", "workpiece", "toolpath", "robot", "process", "sim"),
    *("correction", "identification", "io", "config", "campaign", "viz", "examples"),
    *("numerics", "optimise", "units"),
)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are written from other files."""
    readme = (
        (ROOT / "README.md")
        .read_text(encoding="utf-8")
        .replace("](docs/", "](")
        .replace("](CONTRIBUTING.md", "](contributing.md")
        .replace("](CHANGELOG.md", "](changes.md")
    )
    job = (ROOT / "docs" / "job.md").read_text(encoding="utf-8")
    pages = {
        "index.md": readme,
        "contributing.md": (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"),
        "changes.md": (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"),
        "python.md": python_page(),
        "derivatives.md": derivatives_page(),
        "built_in.md": built_in_page(),
        "job_keys.md": keys_page(
            "The keys of a job", CONFIG / "_schema", meanings_of(toml_block(job))
        ),
        "identification_keys.md": keys_page(
            "The keys of an identification", CONFIG / "_identification", {}
        ),
        "campaign_keys.md": keys_page(
            "The keys of a campaign", CONFIG / "_campaign", {}
        ),
    }
    for notebook in sorted((ROOT / "notebooks").glob("*.ipynb")):
        pages[f"notebook_{notebook.stem}.md"] = notebook_page(notebook)
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def built_in_page() -> str:
    """Return the page of the materials and robots that a job can name."""
    lines = [
        "# Materials and robots that come with it",
        "",
        'Names for `[force] material = "..."`. Coefficients hold for the cutter and',
        "the conditions of their source, which `diffmill check JOB.toml` prints.",
        "",
        "| material | K_tc, K_rc, K_ac [N/mm^2] | K_te, K_re, K_ae [N/mm] | cutter |",
        "|---|---|---|---|",
    ]
    materials = (PACKAGE / "cutting" / "materials.toml").read_text(encoding="utf-8")
    for name, row in tomllib.loads(materials).items():
        sides = [
            ", ".join(f"{row.get(key.format(axis), 0):g}" for axis in "tra")
            for key in ("K_{}c_MPa", "K_{}e_N_per_mm")
        ]
        lines.append(f"| `{name}` | {sides[0]} | {sides[1]} | {row['cutter']} |")
    lines += [
        "",
        'Names for `[robot] model = "..."`; `diffmill robot NAME` shows one.',
        "",
        "| robot | what it is |",
        "|---|---|",
    ]
    for file in sorted((PACKAGE / "robot" / "models").glob("*.toml")):
        model = tomllib.loads(file.read_text(encoding="utf-8"))
        lines.append(f"| `{model['name']}` | {model['description']} |")
    return "\n".join(lines) + "\n"


def notebook_page(file: pathlib.Path) -> str:
    """Return a notebook as a page, its results left out: they need its run."""
    lines = []
    for cell in json.loads(file.read_text(encoding="utf-8"))["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "code":
            text = f"```py\n{text.replace('%matplotlib inline', '').strip()}\n```"
        lines += [text, ""]
        if len(lines) == 2:
            lines += [
                f"*`notebooks/{file.name}`, to be opened with `jupyter lab`.*",
                "",
            ]
    return "\n".join(lines)


def toml_block(text: str) -> str:
    """Return the TOML that a Markdown text shows."""
    (block,) = re.findall(r"^```toml\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    return block


def python_page() -> str:
    """Return the page of the public names, area by area."""
    lines = ["# Python", "", "`import diffmill as dm`; a name stands in its area,"]
    lines += ["`dm.<area>.<name>`. Everything is SI."]
    for area in AREAS:
        file = PACKAGE / area / "__init__.py"
        lines += ["", f"::: diffmill.{area}"]
        if file.exists():
            lines += ["    options: { members: false }"]
            for name in public_names(file):
                lines += ["", f"::: diffmill.{area}.{name}"]
                lines += ["    options: { heading_level: 3 }"]
    return "\n".join(lines) + "\n"


def derivatives_page() -> str:
    """Return the page of what the docstrings of public names say of derivatives."""
    lines = ["# What is differentiable", ""]
    lines += [
        "A function that is not smooth everywhere says so. A name that is not here"
    ]
    lines += ["is smooth where it can be traced, or runs on the host."]
    for area in AREAS:
        init = PACKAGE / area / "__init__.py"
        names = public_names(init) if init.exists() else []
        found = {}
        for file in sorted((PACKAGE / area).rglob("*.py")):
            for node in ast.parse(file.read_text(encoding="utf-8")).body:
                if getattr(node, "name", None) in names and (what := kinks(node)):
                    found[node.name] = what
        if found:
            lines += ["", f"## dm.{area}", "", "| name | derivatives |", "|---|---|"]
            lines += [f"| `{name}` | {found[name]} |" for name in sorted(found)]
    return "\n".join(lines) + "\n"


def kinks(node: ast.stmt) -> str:
    """Return what the docstring of a function or class says of its derivatives."""
    if not isinstance(node, ast.FunctionDef | ast.ClassDef):
        return ""
    text = ast.get_docstring(node) or ""
    found = re.search(
        r"^\**Differentiability\**: (.*?)(?=\n\n|\n\w+:|\Z)",
        text,
        re.DOTALL | re.MULTILINE,
    )
    return " ".join(found[1].split()).replace("|", "\\|") if found else ""


def public_names(file: pathlib.Path) -> list[str]:
    """Return the names that a package exports: those imported `as` themselves."""
    imports = [
        node
        for node in ast.parse(file.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ImportFrom)
    ]
    return sorted(
        alias.name for node in imports for alias in node.names if alias.asname
    )


def keys_page(title: str, folder: pathlib.Path, meanings: Meanings) -> str:
    """Return the page with every key of the tables that a folder declares."""
    lines = [
        f"# {title}\n",
        "Every key that the schema knows; a key that is not here is refused. A",
        'quantity is text with a unit, such as `"10 mm"`; defaults are SI.',
    ]
    for file in sorted(folder.glob("*.py")):
        for table in ast.parse(file.read_text(encoding="utf-8")).body:
            if not isinstance(table, ast.ClassDef) or not is_table(table):
                continue
            place, *more = (ast.get_docstring(table) or table.name).split("\n", 1)
            lines += ["", f"## {place.removesuffix('.')}", "", *more, ""]
            lines += [
                "| key | value | default | example and meaning |",
                "|---|---|---|---|",
            ]
            lines += table_rows(table, meanings)
    return "\n".join(lines) + "\n"


def is_table(node: ast.ClassDef) -> bool:
    """Return whether a class is a table of a file, and has keys of its own."""
    is_pydantic = any("Table" in ast.unparse(base) for base in node.bases)
    return is_pydantic and any(isinstance(entry, ast.AnnAssign) for entry in node.body)


def table_rows(table: ast.ClassDef, meanings: Meanings) -> list[str]:
    """Return a row for each key of a table."""
    place = re.search(r"\[+([\w.]+)\]", ast.get_docstring(table) or "")
    rows = []
    for field in table.body:
        if isinstance(field, ast.AnnAssign):
            key = ast.unparse(field.target)
            meaning = meanings.get((place[1] if place else "", key), "")
            meaning = meaning.replace("|", "\\|")
            rows.append(f"| `{key}` | {kind(field)} | {default(field)} | {meaning} |")
    return rows


def meanings_of(job: str) -> Meanings:
    """Return what an example of a job says of its keys, by table and key.

    Args:
        job: The TOML; a key that is left out stands behind "# ", its meaning behind
            the value.
    """
    meanings: Meanings = {}
    table, key = "", ""
    for line in job.splitlines():
        if header := re.match(r"(?:# )?\[+([\w.]+)\]+", line):
            table, key = header[1], ""
        elif entry := re.match(r"(?:# )?(\w+) += (.+?)(?: +# | {2,})(\S.*)", line):
            key = entry[1]
            meanings[table, key] = f"`{entry[2]}`: {entry[3]}"
        elif key and (more := re.match(r"(?:#? {16,}#? *)(\S.*)", line)):
            meanings[table, key] += f" {more[1]}"
        else:
            key = ""
    return meanings


def kind(field: ast.AnnAssign) -> str:
    """Return what a key may hold, in words: of PositiveLength "positive length"."""
    text = ast.unparse(field.annotation).replace(" | None", "")
    text = re.sub(r"Annotated\[(.*), (?:Field\(.*\)|_\w+)\]", r"\1", text)
    text = re.sub(r"Literal\[([^]]*)\]", lambda found: f"`{found[1]}`", text)
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text.replace("Strict", ""))
    text = re.sub(r"\b([A-Z])(?=[a-z])", lambda found: found[1].lower(), text)
    text = re.sub(r"\blist\[([^]]*)\]", r"list of \1", text)
    wanted = description(field)
    return (text + (f": {wanted}" if wanted else "")).replace("|", "or")


def description(field: ast.AnnAssign) -> str:
    """Return what the schema says that a key requires."""
    options = options_of(field)
    return (
        str(ast.literal_eval(options["description"]))
        if "description" in options
        else ""
    )


def default(field: ast.AnnAssign) -> str:
    """Return the default of a key; a key without one is required."""
    options = options_of(field)
    value = options.get("default", options.get("default_factory", field.value))
    if isinstance(value, ast.Lambda):
        value = value.body
    if value is None or (options and value is field.value):
        return "required"
    text = ast.unparse(value)
    empty = {"None": "", "list": "none", "dict": "none"}
    return empty.get(text, f"`{text}`")


def options_of(field: ast.AnnAssign) -> dict[str, ast.expr]:
    """Return the options of a key's `Field`, if it has one."""
    call = field.value
    if not isinstance(call, ast.Call):
        return {}
    return {option.arg: option.value for option in call.keywords if option.arg}
