"""The documents: spelled right, linked right, and what they show is executed."""

import ast
import pathlib
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest
from slides_job import PROGRAM, write_slides_job

from diffmill import load_job
from diffmill.cli import main
from diffmill.config import load_campaign, load_identification, load_learning
from diffmill.examples import copy_example
from diffmill.io import write_path_csv

ROOT = pathlib.Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
GLOSSARY = ROOT / "docs" / "glossary.md"
# Words of a sentence that readers who are no native speakers still follow.
LONGEST_SENTENCE = 35
# Right, but near to a word that is often meant: to and fro, statics, a collet, a name,
# and words of robot languages and of other tongues that are read.
RIGHT = {"fro", "statics", "collet", "numer"}
RIGHT |= {"slin", "anout", "imagin", "spindel", "intervall", "ser"}
# What the examples of the documents read: a small table for each file that they name.
TABLES = {
    **dict.fromkeys(
        ("slot1.txt", "slot2.txt", "slot3.txt"),
        "t_s,Fx_N,Fy_N,Fz_N\n" + "".join(
            f"{k * 1e-4:.4f},{k % 7},{k % 5},{k % 3}\n" for k in range(400)
        ),
    ),
    "tracker.csv": "time [s],x [mm],y [mm],z [mm]\n0.1,0,1,-0.8\n0.2,1,1,-0.8\n",
    "probe.csv": "x_mm,y_mm,z_mm,nx,ny,nz\n1,9,-0.5,0,-1,0\n2,1,-0.8,0,0,1\n",
    "means.csv": "fz_mm,Fx_N,Fy_N,Fz_N\n0.05,10,20,1\n0.1,15,30,2\n0.15,20,40,3\n",
    "loads.csv": ",".join(
        [*(f"axis_{k}_deg" for k in range(1, 7)), "Fx_N,Fy_N,Fz_N,dx_mm,dy_mm,dz_mm\n"]
    ) + "0,-90,90,0,60,0,100,0,0,0.1,0,0\n" * 12,
    "poses.csv": ",".join(
        [*(f"axis_{k}_deg" for k in range(1, 7)), "x_mm,y_mm,z_mm,dx_mm,dy_mm,dz_mm\n"]
    ) + "0,-90,90,0,60,0,1500,0,900,0.1,0,0\n" * 12,
    "hit1.txt": "time_s,signal\n" + "".join(
        f"{k * 1e-3:.3f},{(-1) ** (k // 40)}\n" for k in range(500)
    ),
    "run.csv": "time_s,dx_um,dy_um,dz_um\n"
    + "".join(f"{k * 0.01:.2f},{k},{k % 3},{k % 5}\n" for k in range(20)),
    **dict.fromkeys(
        ("tip_x.csv", "tip_y.csv", "tip_z.csv"),
        "frequency_Hz,real,imag\n" + "".join(
            f"{10 * k},{k % 5},{-k % 7}\n" for k in range(1, 60)
        ),
    ),
    **dict.fromkeys(
        ("commanded.csv", "actual.csv"),
        "time_s,x_mm,y_mm,z_mm\n" + "".join(
            f"{k * 0.01:.2f},{k * 0.1:.1f},0,0\n" for k in range(200)
        ),
    ),
    **dict.fromkeys(
        ("record_A.csv", "record_B.csv"),
        "time_s,motor_1_deg,link_1_deg,torque_1_Nm\n" + "".join(
            f"{k * 0.01:.2f},{k % 90},{k % 90},{k % 7}\n" for k in range(200)
        ),
    ),
}  # fmt: skip
STUDY = """kind = "mean_forces"
[cutter]
diameter = "10 mm"
teeth = 2
[spindle]
speed = "6000 rpm"
[cut]
axial_depth = "2 mm"
"""


class Block(NamedTuple):
    """A block of code that a document shows.

    Attributes:
        language: What stands behind its fence.
        text: The code.
    """

    language: str
    text: str


def blocks(page: pathlib.Path) -> Iterator[Block]:
    """Yield the fenced blocks of a page."""
    text = page.read_text(encoding="utf-8")
    for found in re.finditer(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        yield Block(found[1], found[2])


def every_block(*languages: str) -> list:
    """Return all blocks in these languages, named by page and place on it."""
    return [
        pytest.param(block, id=f"{page.name}-{number}")
        for page in PAGES
        for number, block in enumerate(blocks(page))
        if block.language in languages
    ]


def prose(page: pathlib.Path) -> str:
    """Return a page without its code."""
    text = page.read_text(encoding="utf-8")
    text = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"^(?: {4}.*\n)+", "", text, flags=re.MULTILINE)


def sentences(page: pathlib.Path) -> list[str]:
    """Return the sentences of a page: cells of tables and entries of lists end one.

    A name in code counts as one word.
    """
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", prose(page))
    text = re.sub(r"`[^`]*`", "code", text)
    blocks = re.split(r"\n\s*\n|\n(?=\s*(?:[-*] |\d+\. |\||#))", text)
    cells = [
        cell
        for block in blocks
        if not block.startswith("#")
        for cell in (block.split("|") if block.lstrip().startswith("|") else [block])
    ]
    end = r"(?<=[.!?])[*\"')]*\s+(?=[A-Z*\"(\[]|code)"
    return [" ".join(part.split()) for cell in cells for part in re.split(end, cell)]


def words(sentence: str) -> int:
    return len(re.findall(r"[A-Za-z0-9][\w'.^/-]*", sentence))


def is_long(sentence: str) -> bool:
    return words(sentence) > LONGEST_SENTENCE


def test_a_sentence_ends_at_its_point(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "# A heading\n\nOne is 2.5 mm, as in `a. B`. Two words.\n`c` is three.\n\n"
        "| key | what it is. It is |\n|---|---|\n\n- an entry\n- [more](x.md)\n\n"
        "```sh\nno sentence\n```\n"
    )
    found = [sentence for sentence in sentences(page) if words(sentence)]
    assert found == [
        *("One is 2.5 mm, as in code.", "Two words.", "code is three."),
        *("key", "what it is.", "It is", "- an entry", "- more"),
    ]
    assert is_long("a " * 36) and not is_long("a " * 35)


def test_sentences_are_short():
    readme = [sentence for sentence in sentences(ROOT / "README.md")]
    assert list(filter(is_long, readme)) == []
    docs = [page for page in PAGES if page.parent.name == "docs"]
    docs.append(ROOT / "CONTRIBUTING.md")  # On the site, too.
    told = [s for page in docs for s in sentences(page) if words(s)]
    found = list(filter(is_long, told))
    assert len(found) < 0.02 * len(told), found


def glossary_words() -> set[str]:
    """Return the words of the field, which no dictionary needs to know."""
    rows = re.findall(r"^\| ([^|]+) \|", GLOSSARY.read_text("utf-8"), re.MULTILINE)
    return {word.lower() for row in rows for word in re.findall(r"[A-Za-z]+", row)}


def test_words_are_spelled_right():
    pytest.importorskip("codespell_lib")
    done = subprocess.run(
        [
            *(sys.executable, "-m", "codespell_lib", "--builtin", "clear,rare"),
            *("--ignore-words-list", ",".join(sorted(glossary_words() | RIGHT))),
            *map(str, [*PAGES, ROOT / "src", ROOT / "experiments", ROOT / "notebooks"]),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout + done.stderr == ""


def test_spelling_is_british():
    codespell = pytest.importorskip("codespell_lib")
    folder = pathlib.Path(codespell.__file__).parent / "data"
    lines = (folder / "dictionary_en-GB_to_en-US.txt").read_text("utf-8").splitlines()
    pairs = [line.split("->") for line in lines]
    american = {us.strip(): gb for gb, many in pairs for us in many.split(",") if us}
    # A program is one of the machine; a licence is named in its own words.
    allowed = glossary_words() | {"program", "programs", "license", "biased"}
    found = {
        (page.name, word, american[word.lower()])
        for page in PAGES
        for word in re.findall(r"[A-Za-z]+", re.sub(r"`[^`]*`", "", prose(page)))
        if word.lower() in american.keys() - allowed
    }
    assert found == set()


def anchors(page: pathlib.Path) -> set[str]:
    """Return the names by which the headings of a page can be linked to."""
    found = re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-")
        for title in found
    }


def generated_pages() -> set[str]:
    """Return the pages that exist only on the site."""
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    return set(re.findall(r": (\w+\.md)$", text, re.MULTILINE)) - {
        page.name for page in PAGES
    }


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page):
    written = generated_pages()
    for link in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if link.startswith(("https://", "mailto:")):
            continue
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        # The site's own pages; mkdocs checks links to them when it builds.
        if page.parent.name == "docs" and name in written:
            continue
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_that_is_named_exists(page):
    shipped = ("docs/", "notebooks/", "experiments/", "tests/", "src/", ".ci/")
    inside = [ROOT, ROOT / "src" / "diffmill"]
    for name in re.findall(r"`([\w./*]+/[\w.*/]*)`", prose(page)):
        is_module = re.fullmatch(r"[a-z]+/(?:_?[a-z]+/)*_?\w*\.(?:py|toml)", name)
        if name.startswith(shipped) or is_module:
            assert any(list(folder.glob(name)) for folder in inside), name
    for command in re.findall(r"python\s+(experiments/\S+\.py)", prose(page)):
        assert (ROOT / command).is_file(), command


def test_every_block_is_in_a_language_that_is_executed():
    found = {block.language for page in PAGES for block in blocks(page)}
    assert found <= {"python", "py", "sh", "toml"}


@pytest.mark.parametrize("block", every_block("toml"))
def test_toml_is_accepted(block, tmp_path):
    tables = tomllib.loads(block.text)
    axes = tables.get("fit", {}).get("axes")
    if axes is not None:
        # A dynamometer is right-handed.
        rows = [{"x": 0, "y": 1, "z": 2}[name[-1]] for name in axes]
        signs = [-1 if name[0] == "-" else 1 for name in axes]
        assert np.linalg.det(np.diag(signs) @ np.eye(3)[rows]) > 0
    for name, text in TABLES.items():
        (tmp_path / name).write_text(text)
    job = write_slides_job(tmp_path, program=PROGRAM.replace("G0", "T2 M6\nG0", 1))
    if {"kind", "means"} & tables.keys():
        job.rename(tmp_path / "part.toml")
        study = tmp_path / "study.toml"
        study.write_text(block.text if "kind" in tables else STUDY + block.text)
        load_identification(study)
    elif "part" in tables:
        job = job.rename(tmp_path / "part.toml")
        shutil.copy(job, tmp_path / "other.toml")
        (tmp_path / "part-correct").mkdir()
        told = tmp_path / "part-correct" / "corrected.csv"
        told.write_text(write_path_csv(load_job(job).path))
        (tmp_path / "learn.toml").write_text(block.text)
        load_learning(tmp_path / "learn.toml")
    elif isinstance(tables.get("job"), str):
        copy_example(tables["job"].removesuffix(".toml"), tmp_path)
        campaign = tmp_path / "campaign.toml"
        campaign.write_text(block.text)
        load_campaign(campaign)
    elif {"cutter", "stock"} <= tables.keys():
        job = copy_example(
            f"{tables['program']['file'].removesuffix('.ngc')}", tmp_path
        )
        job.write_text(block.text)
        load_job(job)
    else:
        # A table of a job takes the place of that of a small one.
        text = job.read_text()
        for name in tables:
            text = re.sub(rf"^\[{name}\]\n(?:[^\[].*\n)*", "", text, flags=re.MULTILINE)
        job.write_text(text + block.text)
        load_job(job)


def is_looked_at(block) -> bool:
    """True if test_project.py runs a block, and looks at what it prints."""
    words = ("dm.Job(", "simulate_process(")
    is_of_page = block.id.startswith("python_start.md")
    return is_of_page and any(word in block.values[0].text for word in words)


PYTHON = [x for x in every_block("python", "py") if not is_looked_at(x)]


@pytest.mark.slow
@pytest.mark.parametrize("block", PYTHON)
def test_python_runs(block, tmp_path):
    subprocess.run([sys.executable, "-c", block.text], cwd=tmp_path, check=True)


def command_lines() -> list[str]:
    """Return the lines with commands of diffmill in all documents."""
    pattern = r"^(?: {4}|.*/)?(diffmill [a-z]+(?: .*)?)$"
    found = set()
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        shell = "\n".join(b.text for b in blocks(page) if b.language == "sh")
        indented = "\n".join(re.findall(r"^ {4}(diffmill .*)$", text, re.MULTILINE))
        found |= set(re.findall(pattern, f"{shell}\n{indented}", re.MULTILINE))
    return sorted(found)


def test_commands_and_their_options_exist(capsys):
    for line in command_lines():
        words = line.split("#")[0].split("  ")[0].split()
        assert main([words[1], "--help"]) == 0, line
        told = capsys.readouterr().out
        for option in (word.strip("[]") for word in words if "--" in word):
            assert option in told, line


@pytest.fixture(scope="module")
def site():
    """Return the names of the module that writes pages of the site."""
    pytest.importorskip("mkdocs")
    return runpy.run_path(str(ROOT / "docs" / "site_pages.py"))


@pytest.mark.parametrize("folder", ["_schema", "_identification", "_campaign"])
def test_every_key_has_a_meaning_and_a_kind_in_words(site, folder):
    keys = {
        f"{table.name}.{ast.unparse(field.target)}": field
        for table in site["tables"](folder)
        for field in site["keys"](table)
    }
    assert keys
    for name, field in keys.items():
        assert len(site["meaning"](field).split()) > 1, name
        assert site["kind"](field.annotation).words, name


def test_a_key_that_is_not_described_is_found(site):
    field = ast.parse("x: Unheard | None = None").body[0]
    assert isinstance(field, ast.AnnAssign)
    assert site["meaning"](field) == ""
    with pytest.raises(KeyError, match="Unheard"):
        site["kind"](field.annotation)


@pytest.mark.parametrize(
    ("code", "words", "default"),
    [
        ("x: PositiveLength = 1e-6", "length above 0", "`1e-6 m`"),
        ("x: Modulus = Field(600e9, description='')", "modulus above 0", "`6e11 Pa`"),
        ("x: PositiveLength = Field(default=math.inf)", "length above 0", "none"),
        ("x: Delay | None = None", "time of at least 0", ""),
        ("x: StrictBool = Field(default=False)", "true or false", "`false`"),
        ("x: Annotated[StrictInt, Field(ge=1)] = Field(description='')",
         "whole number of at least 1", "required"),
        ("x: Lengths3 = Field(default_factory=lambda: [0.0, 0.0, 1.5])",
         "three lengths", "`0, 0, 1.5 m`"),
        ("x: list[Literal['a', 'b']] = Field(default_factory=lambda: ['a'])",
         'list: `"a"` or `"b"`', '`["a"]`'),
    ],
)  # fmt: skip
def test_a_key_is_shown_in_words(site, code, words, default):
    (field,) = ast.parse(code).body
    assert site["kind"](field.annotation).words == words
    assert site["default"](field) == default


def test_tables_stand_in_the_order_of_a_job(site):
    page = site["keys_page"]("Keys", "_schema")
    found = re.findall(r"^## `\[(\w+)\]`", page, re.MULTILINE)
    job = (ROOT / "docs" / "job.md").read_text(encoding="utf-8")
    whole = max(re.findall(r"```toml\n(.*?)```", job, re.DOTALL), key=len)
    stated = re.findall(r"^(?:# )?\[(\w+)\]", whole, re.MULTILINE)
    assert "cutter" in stated and list(dict.fromkeys(found)) == stated
    assert page.index("`[cutter]`") < page.index("`[cutter] holder`")


def test_the_table_of_what_was_verified_is_that_of_its_command():
    verify = runpy.run_path(str(ROOT / "docs" / "verify.py"))
    table = (ROOT / "docs" / "verified.md").read_text(encoding="utf-8")
    claims = [claim for group in verify["CLAIMS"].values() for claim in group]
    for claim in claims:
        name, _, test = claim.test.partition("::")
        assert f"def {test}(" in (ROOT / name).read_text(encoding="utf-8"), test
        (row,) = [row for row in table.splitlines() if f"`{test}`" in row]
        assert row.startswith(f"| {claim.what} | {claim.beside} |"), test
        assert re.search(r"\d+ passed", row) and "failed" not in row, test
    assert table.count("::") == 0 and table.count("| `tests/") == len(claims)
