"""The repository as a whole: pins, imports, and commands that must not drift apart."""

import json
import pathlib
import re
import shutil
import subprocess
import sys
import tomllib

import pytest

from diffmill import load_job

ROOT = pathlib.Path(__file__).parents[1]
README = ROOT / "README.md"


def readme_commands() -> list[str]:
    lines = README.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line.startswith("python3 -m venv .venv-tools ")]


def shown_block(page: str, language: str) -> str:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    found = re.findall(rf"^```{language}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    return max(found, key=len)


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
    force, shape = run_python(shown_block("python_start.md", "python")).split(
        maxsplit=1
    )
    # A slot pushes a tool that turns clockwise to the left of its way, here +y.
    assert 10 < float(force) < 200
    assert shape.strip() == "(60, 3)"


@pytest.mark.slow
def test_documentation_builds_without_a_warning_and_fetches_nothing(tmp_path):
    pytest.importorskip("mkdocs")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict"]
    subprocess.run([*command, "--site-dir", tmp_path], cwd=ROOT, check=True)
    pages = {file.stem: file.read_text("utf-8") for file in tmp_path.glob("*.html")}
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
