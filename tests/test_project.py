"""The repository as a whole: pins, imports, and commands that must not drift apart."""

import ast
import json
import os
import pathlib
import re
import runpy
import shutil
import subprocess
import sys
import tomllib

import pytest
from browser import browser

from diffmill import load_job

ROOT = pathlib.Path(__file__).parents[1]
README = ROOT / "README.md"


def readme_commands() -> list[str]:
    lines = README.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line.startswith("python3 -m venv .venv-tools ")]


def shown_block(page: str, language: str, containing: str = "") -> str:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    blocks = re.findall(rf"^```{language}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    return max((block for block in blocks if containing in block), key=len)


@pytest.mark.slow
def test_a_job_without_a_file_runs_as_the_documentation_says():
    code = shown_block("python_start.md", "python", "dm.Job(")
    made = code.split("True)\n", 1)[1].split("solution =")[0]
    assert len(ast.parse(made).body) == 10
    *_, rms = run_python(code).split()
    assert 2e-5 < float(rms) < 5e-4


def run_python(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    return done.stdout


def test_pip_and_uv_get_the_same_pins():
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert project["tool"]["uv"]["constraint-dependencies"] == pins
    assert all("==" in pin for pin in pins)
    assert len(pins) > len(project["project"]["dependencies"])


def test_type_checkers_are_told_that_the_package_is_typed():
    import diffmill

    assert pathlib.Path(diffmill.__file__).with_name("py.typed").is_file()


def test_citation_names_the_version_and_licence_of_the_package():
    lines = (ROOT / "CITATION.cff").read_text(encoding="utf-8").splitlines()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    facts = project["project"]
    assert f"version: {facts['version']}" in lines
    assert f"license: {facts['license']}" in lines
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"\n## {facts['version']}" in changes


def test_every_name_is_found_and_import_leaves_jax_alone():
    code = """
import sys
import diffmill
assert not {"jax", "numpy", "matplotlib"} & set(sys.modules), "import is not lazy"
import jax
from jax._src import xla_bridge
before = dict(jax.config.values)
for name in dir(diffmill):
    getattr(diffmill, name)
assert dict(jax.config.values) == before, "a JAX setting changed"
assert not xla_bridge._backends, "a JAX backend started"
assert not {"matplotlib", "xarray"} & set(sys.modules), "too much imported"
print(diffmill.__version__, diffmill.sim.simulate is diffmill.simulate)
"""
    version, is_same = run_python(code).split()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert version == project["project"]["version"]
    assert is_same == "True"


def test_an_unknown_name_is_an_attribute_error():
    import diffmill

    with pytest.raises(AttributeError, match="'simulat'"):
        diffmill.simulat  # noqa: B018  # pyright: ignore[reportAttributeAccessIssue]


def test_no_lock_file_is_tracked():
    # It would name the package index of whoever wrote it.
    git = shutil.which("git")
    if git is None or not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    done = subprocess.run(
        [git, "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert "uv.lock" not in done.stdout.split()


def test_readme_has_one_command_for_the_job_and_one_for_the_tests():
    job, tests = readme_commands()
    assert "diffmill example paper " in job
    assert "diffmill correct " in job
    assert "pytest" not in job
    assert "pytest" in tests


def test_readme_begins_with_three_short_lines_for_the_same_job():
    text = README.read_text(encoding="utf-8")
    (first, *_) = re.findall(r"^```sh\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    install, example, correct = first.splitlines()
    assert all(len(line) < 80 for line in (install, example, correct))
    assert install.endswith("install --constraint constraints.txt .")
    job = readme_commands()[0]
    for line in (example, correct):
        assert line.removeprefix(".venv/bin/") in job


def test_pictures_of_the_readme_are_small_and_made_by_a_command():
    text = README.read_text(encoding="utf-8")
    script = (ROOT / "docs" / "make_pictures.py").read_text(encoding="utf-8")
    pictures = re.findall(r"!\[[^\]]+\]\((docs/\w+\.png)\)", text)
    assert pictures[:2] == ["docs/surface.png", "docs/view.png"]
    assert "python\ndocs/make_pictures.py" in text
    for name in pictures:
        assert pathlib.Path(name).name in script
        assert (ROOT / name).stat().st_size < 100_000, name


def test_job_of_the_readme_is_the_small_example(tmp_path):
    from diffmill import examples

    file = examples.copy_example("paper_small", tmp_path)
    shipped = tomllib.loads(file.read_text(encoding="utf-8"))
    shown = tomllib.loads(shown_block("job.md", "toml"))
    assert shown["stock"] == shipped["stock"]
    file.write_text(shown_block("job.md", "toml"), encoding="utf-8")
    job = load_job(file)
    assert job.name == "paper_small"
    assert shown == {**shipped, "correction": shown["correction"]}


@pytest.mark.slow
def test_python_of_the_readme_runs():
    code = shown_block("python_start.md", "python", "simulate_process")
    force, shape = run_python(code).split(maxsplit=1)
    # A slot pushes a tool that turns clockwise to the left of its way, here +y.
    assert 10 < float(force) < 200
    assert shape.strip() == "(60, 3)"


@pytest.mark.slow
def test_documentation_builds_without_a_warning_and_fetches_nothing(tmp_path):
    pytest.importorskip("mkdocs")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict"]
    # Continuous integration executes the notebooks when it builds the documentation.
    environment = {**os.environ, "DIFFMILL_NOTEBOOKS": "source"}
    folder = tmp_path / "site"
    subprocess.run(
        [*command, "--site-dir", folder], cwd=ROOT, check=True, env=environment
    )
    pages = {file.stem: file.read_text("utf-8") for file in folder.glob("*.html")}
    for text in pages.values():
        assert not re.findall(r'<script[^>]*src="https?:', text)
        assert not re.findall(r'<link[^>]*stylesheet[^>]*href="https?:', text)
        assert not re.findall(r'<img[^>]*src="https?:', text)
    key = re.search(r"<code>knot_spacing</code>.*?</tr>", pages["job_keys"], re.DOTALL)
    assert key is not None
    assert "0.03" in key[0]
    assert "controller can follow" in key[0]
    assert 'id="diffmill.correction.correct"' in pages["python"]
    assert "<code>contour_error</code>" in pages["derivatives"]
    assert "not executed for this site" in pages["notebook_quick_start"]
    with browser(tmp_path / "browser") as page:
        check_search(page, folder / "index.html")
        for name in pages.keys() - {"404"}:
            page.open(folder / f"{name}.html", width=390, height=800)
            assert page.value("document.documentElement.scrollWidth") <= 390, name
            assert page.complaints == [], name
            assert all(url.startswith(("file:", "data:")) for url in page.requests)


def check_search(page, start):
    """Search for a word without a server, and follow what is found to its heading."""
    page.open(start)
    page.value("""(() => {
        const field = document.querySelector("[data-md-component=search-query]");
        field.focus();
        field.value = "process damping";
        field.dispatchEvent(new KeyboardEvent("keyup"));
    })()""")
    found = """new Promise((resolve) => {
        const look = () => {
            const link = document.querySelector(".md-search-result__item a");
            link ? resolve(link.href) : setTimeout(look, 100);
        };
        look();
    })"""
    link = page.value(found).removeprefix(start.parent.as_uri() + "/")
    file = start.parent / link.split("#")[0].split("?")[0]
    assert "process damping" in file.read_text("utf-8").lower()


@pytest.fixture(scope="module")
def site_pages():
    pytest.importorskip("mkdocs")
    return runpy.run_path(str(ROOT / "docs" / "site_pages.py"))


def cell(source, outputs=()):
    return {
        "cell_type": "code",
        "execution_count": None,
        "id": f"cell{len(source)}",
        "metadata": {},
        "outputs": list(outputs),
        "source": source,
    }


def notebook(*cells):
    """A notebook with a title and cells of code."""
    title = {"cell_type": "markdown", "id": "title", "metadata": {}, "source": "# One"}
    version = {"nbformat": 4, "nbformat_minor": 5}
    return {"cells": [title, *cells], "metadata": {}, **version}


def test_a_notebook_is_executed_once_and_its_figures_are_on_its_page(
    site_pages, tmp_path
):
    pytest.importorskip("nbclient")
    file = tmp_path / "one.ipynb"
    draw = "%matplotlib inline\nimport matplotlib.pyplot as plt\n_ = plt.plot([1, 2])"
    file.write_text(json.dumps(notebook(cell(draw), cell("print(6 * 7)"))))
    kept = tmp_path / "kept"
    kept.mkdir()
    found = site_pages["executed"](file, kept)
    text, figures = site_pages["notebook_page"](found, "one")
    assert "```text\n42\n```" in text
    assert "not executed" not in text
    assert "%matplotlib" not in text
    (name,) = figures
    assert f"]({name})" in text
    assert figures[name].startswith(b"\x89PNG")
    (stored,) = kept.iterdir()
    stored.write_text(stored.read_text().replace("42", "43"))
    again = site_pages["executed"](file, kept)
    assert "43" in site_pages["notebook_page"](again, "one")[0]
    # Another notebook of that name takes its place.
    file.write_text(json.dumps(notebook(cell("print(1)"))))
    site_pages["executed"](file, kept)
    assert [path.name for path in kept.iterdir()] != [stored.name]


def test_every_notebook_and_page_is_in_the_menu():
    menu = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    notebooks = {
        f"notebook_{file.stem}" for file in (ROOT / "notebooks").glob("*.ipynb")
    }
    pages = {file.stem for file in (ROOT / "docs").glob("*.md")}
    named = re.findall(r": (\w+)\.md$", menu, re.MULTILINE)
    assert len(named) == len(set(named))
    assert notebooks | pages <= set(named)


def test_a_notebook_that_fails_ends_the_build_of_the_site(site_pages, tmp_path):
    pytest.importorskip("nbclient")
    from mkdocs.exceptions import PluginError

    file = tmp_path / "one.ipynb"
    file.write_text(json.dumps(notebook(cell("1 / 0"))))
    with pytest.raises(PluginError, match="ZeroDivision"):
        site_pages["executed_notebooks"]([file], tmp_path / "kept")


def test_continuous_integration_runs_the_commands_of_the_readme():
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert "$uv pytest -m slow $slow" in script
    assert "tests/test_project.py tests/test_docs.py tests/correction/" in script
    assert "grep '^python3 -m venv .venv-tools ' README.md" in script
    assert 'step "${commands[0]//paper/paper_small}"' in script
    assert 'step "${commands[1]}"' in script
    assert 'step "$uv mkdocs build --strict"' in script
    # The shell's replacement must give a command for the small example, file and all.
    small = readme_commands()[0].replace("paper", "paper_small")
    assert "out/paper_small.toml" in small
    assert "out/paper_small-correct" in small


def test_pre_commit_runs_the_linters_of_continuous_integration():
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    hooks = (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    for tool in ("ruff check", "ruff format", "pyright", "lint-imports"):
        assert f"$uv {tool}" in script
        assert f"entry: uv run {tool}" in hooks


@pytest.mark.parametrize("file", sorted((ROOT / "notebooks").glob("*.ipynb")))
def test_notebooks_are_short_and_hold_no_results(file):
    cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
    assert len(cells) <= 14
    assert not any(cell.get("outputs") for cell in cells)
