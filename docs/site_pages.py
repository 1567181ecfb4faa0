"""Write the pages of the documentation that follow from other files of the project.

A hook of mkdocs: the start is the README's, tutorials are the notebooks, the keys of
job files are read from the source of their schema, so that no page can drift from them.

Notebooks are executed, which takes minutes; what they gave is kept in `out/notebooks`
until they or the package change. `DIFFMILL_NOTEBOOKS=source` in the environment leaves
their results out.
"""

import ast
import base64
import concurrent.futures
import functools
import hashlib
import json
import logging
import os
import pathlib
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from typing import Any, NamedTuple

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

ROOT = pathlib.Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "diffmill"
CONFIG = PACKAGE / "config"
log = logging.getLogger("mkdocs.diffmill")
AREAS = (
    *("cutter", "cutting", "workpiece", "toolpath", "robot", "process", "sim"),
    *("correction", "learning", "identification", "io", "config", "campaign", "viz"),
    *("examples", "settings", "numerics", "optimise", "units"),
)
# Tables in the order of their pages; first are keys that belong to no table alone.
TABLES = (
    *("", "cutter", "spindle", "cut", "record", "means", "fit", "force", "stock"),
    *("program", "robot", "load_tests", "ring_down", "frequency_response", "coupled"),
    *("air_path", "poses", "prior", "reversal", "joint_record", "machine"),
    *("controller", "registration", "learnt", "simulation", "correction", "output"),
    *("truth", "part", "tracker", "points", "encoders", "forces"),
    *("trial", "advice"),
    *("sweep", "draw", "starts"),
)


# Families of strategies, each with the key that names one.
FAMILIES = {
    "ChipSettings": "[simulation] chip",
    "ForceLawSettings": "[force] law",
    "IntegratorSettings": "[simulation] integrator",
    "MethodSettings": "[correction] method",
    "ModeSettings": "[simulation] mode",
    "ObjectiveSettings": "[correction] objective",
}


class Kind(NamedTuple):
    """What a key may hold.

    Attributes:
        words: In words.
        unit: SI unit of its default; empty if it has none.
    """

    words: str
    unit: str = ""


# By annotation; what is left out here is a choice, a table, or made of these.
KINDS = {
    "Acceleration": Kind("acceleration above 0", "m/s^2"),
    "Angle": Kind("angle", "rad"),
    "Angles3": Kind("three angles", "rad"),
    "PositiveAngle": Kind("angle above 0", "rad"),
    "Axes": Kind("three signed axes"),
    "AxesOrProposed": Kind('three signed axes or `"proposed"`'),
    "Channels": Kind('table of names, numbers or `"none"`'),
    "Count": Kind("whole number of at least 1"),
    "CutNumber": Kind('whole number of at least 1 or `"all"`'),
    "DampingRatio": Kind("number from 0 to below 1"),
    "Delay": Kind("time of at least 0", "s"),
    "Density": Kind("density above 0", "kg/m^3"),
    "Direction": Kind("three numbers"),
    "Factor": Kind("number of at least 1, or inf"),
    "File": Kind("name of a file"),
    "Formats": Kind('list: `"gcode"`, `"krl"`, `"rapid"` or `"apt"`'),
    "Frequency": Kind("frequency above 0", "Hz"),
    "GearRatio": Kind("number beside 0"),
    "Jerk": Kind("jerk above 0", "m/s^3"),
    "JointFrequency": Kind("frequency above 0, or one per joint", "Hz"),
    "JointRatio": Kind("finite number above 0, or one per joint"),
    "Key": Kind("text"),
    "Lengths3": Kind("three lengths", "m"),
    "LinearStiffness": Kind("stiffness above 0", "N/m"),
    "Mass": Kind("mass above 0", "kg"),
    "Modulus": Kind("modulus above 0", "Pa"),
    "Number": Kind("whole number of at least 0"),
    "PositiveLength": Kind("length above 0", "m"),
    "PositiveSpeed": Kind("speed above 0", "m/s"),
    "ProbePoints": Kind("three points or more, not all on a line", "m"),
    "PositiveTime": Kind("time above 0", "s"),
    "Ratio": Kind("number from 0 to 1"),
    "TurnTolerance": Kind("angle of at least 0", "rad"),
    "Rows": Kind('whole number above 0 or `"auto"`'),
    "Share": Kind("number above 0, up to 1"),
    "Side": Kind('`"slot"`, `"up"` or `"down"`'),
    "Span": Kind('two times or `"none"`', "s"),
    "SpindleSpeed": Kind("rotational speed above 0", "rad/s"),
    "Sections": Kind("list of tables"),
    "Stability": Kind('true or false or `"quick"`'),
    "StrictBool": Kind("true or false"),
    "StrictInt": Kind("whole number"),
    "StrictStr": Kind("text"),
    "StrictStr | float": Kind("text with a unit, or number"),
    "Time": Kind("time", "s"),
    "Tolerance": Kind("length of at least 0", "m"),
    "ToothEdgeForce": Kind("force per length, or one per tooth", "N/m"),
    "ToothExponent": Kind("number from 0 to below 1, or one per tooth"),
    "ToothPositivePressure": Kind("pressure above 0, or one per tooth", "Pa"),
    "ToothPressure": Kind("pressure, or one per tooth", "Pa"),
    "Uncertainty": Kind("number from 0 to below 1"),
    "Weight": Kind("number of at least 0"),
    "dict[CoordinateSystem, Lengths3]": Kind(
        "table from G54 to G59.3, three lengths each"
    ),
    "dict[StrictStr, StrictStr]": Kind("table of units"),
    "dict[ToolNumber, Tolerance]": Kind("table of lengths of at least 0"),
    "dict[ToolNumber, Length]": Kind("table of lengths"),
    "list[Angle]": Kind("list of angles above 0"),
    "list[Angles3]": Kind("three angles per joint"),
    "list[Angles4]": Kind("four angles per joint"),
    "list[Lengths3]": Kind("three lengths per joint"),
    "list[object]": Kind("list of values"),
    "list[Damping]": Kind("dampings of at least 0, one per joint"),
    "list[Factor]": Kind("list of numbers above 0"),
    "list[Force]": Kind("list of forces"),
    "list[Frequency]": Kind("list of frequencies above 0"),
    "list[Inertia]": Kind("three moments of inertia above 0"),
    "list[LinearStiffness]": Kind("three stiffnesses above 0"),
    "list[PositiveLength]": Kind("list of lengths above 0"),
    "list[RotaryStiffness]": Kind("three stiffnesses above 0"),
    "list[Slots]": Kind("three whole numbers from 1 to 64"),
    "list[Stiffness]": Kind("stiffnesses above 0, one per joint"),
    "list[StrictInt]": Kind("list of whole numbers"),
    "list[StrictStr]": Kind("list of texts"),
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are written from other files."""
    readme = (
        (ROOT / "README.md")
        .read_text(encoding="utf-8")
        .replace("](docs/", "](")
        .replace("](CONTRIBUTING.md", "](contributing.md")
        .replace("](CHANGELOG.md", "](changes.md")
    )
    pages = {
        "index.md": readme,
        "contributing.md": (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"),
        "changes.md": (ROOT / "CHANGELOG.md")
        .read_text(encoding="utf-8")
        .replace("](docs/", "]("),
        "python.md": python_page(),
        "derivatives.md": derivatives_page(),
        "built_in.md": built_in_page(),
        "job_keys.md": keys_page("The keys of a job", "_schema"),
        "identification_keys.md": keys_page(
            "The keys of an identification",
            "_identification",
            "Before all tables `kind` says [what was measured](identify.md); `[cutter]`"
            " and `[spindle]` are [those of a job](job_keys.md).",
        ),
        "campaign_keys.md": keys_page("The keys of a campaign", "_campaign"),
    }
    notebooks = sorted((ROOT / "notebooks").glob("*.ipynb"))
    if os.environ.get("DIFFMILL_NOTEBOOKS") == "source":
        contents = [json.loads(file.read_text(encoding="utf-8")) for file in notebooks]
    else:
        contents = executed_notebooks(notebooks, ROOT / "out" / "notebooks")
    for file, content in zip(notebooks, contents, strict=True):
        name = f"notebook_{file.stem}.md"
        pages[name], figures = notebook_page(content, file.stem)
        for picture, data in figures.items():
            files.append(File.generated(config, picture, content=data))
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


def notebook_page(notebook: dict[str, Any], name: str) -> tuple[str, dict[str, bytes]]:
    """Return a notebook as a page, and its figures by the names of their files.

    Args:
        notebook: The notebook, executed or not.
        name: Its name.
    """
    lines: list[str] = []
    figures: dict[str, bytes] = {}
    for cell in notebook["cells"]:
        text = "".join(cell["source"]).replace("%matplotlib inline\n", "").strip()
        if cell["cell_type"] == "markdown":
            lines += [text, ""]
        elif text:
            lines += [f"```py\n{text}\n```", ""]
        outputs = cell.get("outputs", [])
        # What a cell prints comes in pieces.
        if told := "\n".join(filter(None, map(text_of, outputs))):
            lines += [f"```text\n{told}\n```", ""]
        for output in outputs:
            if image := output.get("data", {}).get("image/png"):
                file = f"notebook_{name}_{len(figures) + 1}.png"
                figures[file] = base64.b64decode(image)
                lines += [f"![Figure of the cell above]({file})", ""]
        if len(lines) == 2:
            how = f"`notebooks/{name}.ipynb`, to be opened with `jupyter lab`"
            more = "" if is_executed(notebook) else "; not executed for this site"
            lines += [f"*{how}{more}.*", ""]
    return "\n".join(lines), figures


def text_of(output: dict[str, Any]) -> str:
    """Return what a cell printed on the standard output, or its value, as text."""
    if output["output_type"] == "stream" and output["name"] == "stdout":
        return "".join(output["text"]).rstrip()
    text = "".join(output.get("data", {}).get("text/plain", ""))
    # The value of a call that draws, whose figure follows, or a folder of this machine.
    return "" if re.match(r"<|\[<|Text\(|'/", text) else text


def is_executed(notebook: dict[str, Any]) -> bool:
    """Return whether a cell of a notebook has been executed."""
    return any(cell.get("execution_count") for cell in notebook["cells"])


def executed_notebooks(files: list[pathlib.Path], folder: pathlib.Path) -> list[dict]:
    """Execute notebooks, two at a time, or take them from an earlier build.

    Args:
        files: The notebooks.
        folder: Where executed ones are kept, by a digest of all that they depend on.

    Raises:
        PluginError: A cell raises.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        return list(pool.map(functools.partial(executed, folder=folder), files))


def executed(file: pathlib.Path, folder: pathlib.Path) -> dict[str, Any]:
    """Execute one notebook, or take it from an earlier build."""
    digest = sources_digest()
    digest.update(file.read_bytes())
    kept = folder / f"{file.stem}-{digest.hexdigest()[:16]}.ipynb"
    if not kept.exists():
        log.info("Executing %s", file.name)
        run = "from nbclient.cli import main; main()"
        made = folder / f"{file.stem}.part.ipynb"
        options = ["--timeout=1800", "--kernel_name=python3", f"--output={made}"]
        done = subprocess.run(
            [sys.executable, "-c", run, *options, str(file)],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            raise PluginError(f"{file.name} cannot be executed:\n{done.stderr}")
        for old in folder.glob(f"{file.stem}-*.ipynb"):
            old.unlink()
        made.rename(kept)
    return json.loads(kept.read_text(encoding="utf-8"))


def sources_digest() -> Any:
    """Return a digest of the package, its versions and the data that notebooks read."""
    digest = hashlib.sha256(os.environ.get("DIFFMILL_REFERENCE_DATA", "").encode())
    # The notebooks about learning take the jobs of its experiment.
    folders = (PACKAGE, ROOT / "experiments" / "learning")
    files = [file for folder in folders for file in folder.rglob("*") if file.is_file()]
    for file in sorted([ROOT / "constraints.txt", *files]):
        if file.suffix != ".pyc":
            digest.update(str(file.relative_to(ROOT)).encode() + file.read_bytes())
    return digest


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
                name = getattr(node, "name", None)
                if name in names and (what := kinks(node)):
                    found[name] = what
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


def keys_page(title: str, folder: str, besides: str = "") -> str:
    """Return the page with every key of the tables that a folder declares.

    Args:
        title: Its heading.
        folder: The folder in `CONFIG`.
        besides: What else stands in such a file.
    """
    lines = [
        f"# {title}\n",
        "Every key that the schema knows; a key that is not here is refused. A",
        'quantity is text with a unit, such as `"10 mm"`; defaults are SI.',
        besides,
    ]
    for table in sorted(tables(folder), key=place):
        _, *more = (ast.get_docstring(table) or "").split("\n", 1)
        more = more if not is_settings(table) else []
        lines += ["", f"## {heading_of(table)}", "", *more, ""]
        lines += ['<div class="keys" markdown>', ""]
        lines += ["| key | value | default | meaning |", "|---|---|---|---|"]
        for field in keys(table):
            row = [f"`{key_name(field)}`", kind(field.annotation).words]
            row += [default(field), meaning(field)]
            cells = (re.sub(r"[|*]", r"\\\g<0>", cell) for cell in row)
            lines.append(f"| {' | '.join(cells)} |")
        lines += ["", "</div>"]
    return "\n".join(lines) + "\n"


def tables(folder: str) -> Iterator[ast.ClassDef]:
    """Yield the tables with keys of their own that the schema in a folder declares.

    Those of a job are settings, too.
    """
    files = sorted((CONFIG / folder).glob("*.py"))
    if folder == "_schema":
        files += sorted((PACKAGE / "settings").glob("*.py"))
    for file in files:
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if not isinstance(node, ast.ClassDef) or not keys(node):
                continue
            if is_settings(node) or "TomlTable" in map(ast.unparse, node.bases):
                yield node


def is_settings(table: ast.ClassDef) -> bool:
    """Return whether a class is settings, of a table or of a strategy."""
    return bool({"table", "name"} & {option.arg for option in table.keywords})


def keys(table: ast.ClassDef) -> list[ast.AnnAssign]:
    """Return the keys of a table, with those of the settings that it extends."""
    fields = [field for field in table.body if isinstance(field, ast.AnnAssign)]
    if "TomlTable" in map(ast.unparse, table.bases):
        return fields
    fields = [
        field
        for field in fields
        if isinstance(field.value, ast.Call) and ast.unparse(field.value.func) == "key"
    ]
    bases = [settings_named(ast.unparse(base)) for base in table.bases]
    shared = [field for base in bases if base is not None for field in keys(base)]
    return [*{key_name(field): field for field in (*shared, *fields)}.values()]


@functools.cache
def settings_named(name: str) -> ast.ClassDef | None:
    """Return the settings that several tables share, None if there are none so."""
    for file in (PACKAGE / "settings").glob("*.py"):
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and node.name == name:
                return node
    return None


def key_name(field: ast.AnnAssign) -> str:
    """Return the name of a key in a file."""
    name = options_of(field.value).get("name")
    return ast.unparse(field.target) if name is None else ast.literal_eval(name)


def heading_of(table: ast.ClassDef) -> str:
    """Return the heading of a table: its place in a file comes first."""
    text = (ast.get_docstring(table) or table.name).split("\n")[0].removesuffix(".")
    options = {option.arg: option.value for option in table.keywords}
    if "table" in options:
        first, *inner = ast.literal_eval(options["table"]).split(".")
        return f"`[{first}]{''.join(f' {name}' for name in inner)}`: {text}"
    if "name" in options:
        family = FAMILIES[ast.unparse(table.bases[0])]
        return f'`{family} = "{ast.literal_eval(options["name"])}"`: {text}'
    return text


def place(table: ast.ClassDef) -> tuple[int, bool]:
    """Sort key of a table: the order of `TABLES`, parts behind it, others last."""
    heading = heading_of(table)
    found = re.search(r"\[+(\w+)", heading)
    name = found[1] if found else ""
    index = TABLES.index(name) if name in TABLES else len(TABLES)
    return index, f"[{name}]`" not in heading


def kind(annotation: ast.expr) -> Kind:
    """Return what a key may hold.

    Raises:
        KeyError: The annotation is not known.
    """
    text = ast.unparse(annotation)
    if text in KINDS:
        return KINDS[text]
    match annotation:
        case ast.BinOp(left=one, right=ast.Constant(value=None)):
            return kind(one)
        case ast.BinOp(left=one, right=other):
            return Kind(f"{kind(one).words} or {kind(other).words}")
        case ast.Subscript(ast.Name("Leaf"), inner):
            return kind(inner)
        case ast.Subscript(ast.Name("Literal"), choice):
            names = choice.elts if isinstance(choice, ast.Tuple) else [choice]
            *most, last = (f"`{shown(name)}`" for name in names)
            return Kind(f"{', '.join(most)} or {last}" if most else last)
        case ast.Subscript(ast.Name("Annotated"), ast.Tuple([inner, limits])):
            return Kind(kind(inner).words + range_of(limits))
        case ast.Subscript(ast.Name("list"), ast.Name(name)) if name.endswith("Table"):
            return Kind("list of tables")
        case ast.Subscript(ast.Name("list"), inner):
            return Kind(f"list: {kind(inner).words}")
        case ast.Name(name) if name in FAMILIES:
            return Kind(choice_of(name))
        case ast.Name(name) if name.endswith(("Table", "Settings")):
            return Kind("table")
    raise KeyError(text)


def choice_of(family: str) -> str:
    """Return the names of the strategies of a family."""
    found = [
        ast.literal_eval(option.value)
        for file in sorted((PACKAGE / "settings").glob("*.py"))
        for node in ast.parse(file.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ClassDef) and family in map(ast.unparse, node.bases)
        for option in node.keywords
        if option.arg == "name"
    ]
    *most, last = (f'`"{name}"`' for name in found)
    return f"{', '.join(most)} or {last}" if most else last


def range_of(limits: ast.expr) -> str:
    """Return the limits of a whole number in words."""
    found = options_of(limits)
    if "ge" not in found:
        return ""
    low = ast.unparse(found["ge"])
    if "le" not in found:
        return f" of at least {low}"
    return f" from {low} to {ast.unparse(found['le']).replace(' ** ', '^')}"


def meaning(field: ast.AnnAssign) -> str:
    """Return what the schema says of a key."""
    return ast.literal_eval(options_of(field.value).get("description", "''"))


def default(field: ast.AnnAssign) -> str:
    """Return the default of a key, with its unit; a key without one is required."""
    options = options_of(field.value)
    if "follows" in options:
        return ""
    value = options.get("default", options.get("default_factory"))
    if value is None:
        return "required"
    text, unit = shown(value), kind(field.annotation).unit
    empty = dict.fromkeys(("list", "dict", "()", "math.inf"), "none")
    words = {"null": ""} | empty
    return words.get(text, f"`{f'{text} {unit}'.strip()}`")


def shown(value: ast.expr) -> str:
    """Return a value as a file of TOML has it, a number as short as it can be."""
    if isinstance(value, ast.Lambda):
        value = value.body
    if not isinstance(value, ast.Constant | ast.List):
        return ast.unparse(value)
    found = ast.literal_eval(value)
    numbers = found if isinstance(found, list) else [found]
    if not all(isinstance(number, float) for number in numbers):
        return json.dumps(found)
    short = ", ".join(f"{number:g}" for number in numbers)
    return re.sub(r"e\+?(-?)0*", r"e\1", short)


def options_of(value: ast.expr | None) -> dict[str, ast.expr]:
    """Return the options of a key's `Field`, its default by its name."""
    if not isinstance(value, ast.Call):
        return {} if value is None else {"default": value}
    name = "description" if ast.unparse(value.func) == "key" else "default"
    first = {name: value.args[0]} if value.args else {}
    return first | {option.arg: option.value for option in value.keywords if option.arg}
