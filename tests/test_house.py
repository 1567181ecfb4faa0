"""The rooms of the package: how large they are, and who imports whom."""

import ast
import collections
import itertools
import pathlib
import re
from collections.abc import Iterator
from typing import Any

import diffmill

ROOT = pathlib.Path(__file__).parents[1]
SOURCE = ROOT / "src" / "diffmill"
# Folders of siblings of one kind, which may be many: figures, kinds of identification.
SIBLINGS = {"viz/_figure", "cli/_identify", "config/_identification"}
LARGEST = 12


def module_of(file: pathlib.Path) -> str:
    parts = ("diffmill", *file.relative_to(SOURCE).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(file: pathlib.Path) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the modules of diffmill that a file imports, with the names taken."""
    if file.is_relative_to(SOURCE):
        package = module_of(file).split(".")
        package = package if file.name == "__init__.py" else package[:-1]
    else:
        package = []
    tree = ast.parse(file.read_text(encoding="utf-8"))
    # What only a type checker reads is no dependency.
    for block in [node for node in ast.walk(tree) if isinstance(node, ast.If)]:
        if ast.unparse(block.test) == "TYPE_CHECKING":
            block.body = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for name in node.names:
                yield name.name, ()
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            parts = [*base, *(node.module.split(".") if node.module else [])]
            yield ".".join(parts), tuple(name.name for name in node.names)


def is_private(module: str) -> bool:
    parts = module.split(".")
    return parts[0] == "diffmill" and any(part.startswith("_") for part in parts[1:])


def test_a_folder_shows_its_rooms():
    for folder in {file.parent for file in SOURCE.rglob("*.py")}:
        modules = [f for f in folder.glob("*.py") if f.name != "__init__.py"]
        name = folder.relative_to(SOURCE).as_posix()
        assert len(modules) <= LARGEST or name in SIBLINGS, (name, len(modules))


def test_areas_know_only_what_others_publish():
    for file in SOURCE.rglob("*.py"):
        area = module_of(file).split(".")[1:2]
        for module, _ in imports(file):
            parts = module.split(".")
            if parts[0] != "diffmill" or len(parts) < 3 or [parts[1]] == area:
                continue
            assert not is_private(".".join(["diffmill", *parts[2:]])), (file, module)


def test_modules_import_in_one_direction():
    files = {module_of(file): file for file in SOURCE.rglob("*.py")}
    graph = {
        name: {
            target
            for module, names in imports(file)
            for target in (module, *(f"{module}.{n}" for n in names))
            if target in files and files[target].name != "__init__.py"
        }
        for name, file in files.items()
        if file.name != "__init__.py"
    }
    while graph:
        leaves = {name for name, targets in graph.items() if not targets & set(graph)}
        assert leaves, f"import cycle among {sorted(graph)}"
        graph = {name: graph[name] for name in graph.keys() - leaves}


# Functions have no more parameters than this.
MOST_PARAMETERS = 6


def parameters(function: ast.FunctionDef) -> int:
    """Return how many there are, without options: keyword-only ones with a default."""
    given = function.args
    named = [a.arg for a in given.posonlyargs + given.args]
    required = [default for default in given.kw_defaults if default is None]
    is_method = named[:1] in (["self"], ["cls"])
    return len(named) - is_method + len(required) + (given.vararg is not None)


def test_functions_have_few_parameters():
    long = {
        f"{file.relative_to(SOURCE).as_posix()}:{node.name}"
        for file in SOURCE.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef) and parameters(node) > MOST_PARAMETERS
    }
    assert not long


def tuples(annotation: ast.expr | None) -> Iterator[list[str]]:
    """Yield what the tuples of an annotation hold."""
    for node in ast.walk(annotation) if annotation is not None else ():
        if isinstance(node, ast.Subscript) and ast.unparse(node.value) == "tuple":
            inside = node.slice
            held = inside.elts if isinstance(inside, ast.Tuple) else [inside]
            yield [ast.unparse(one) for one in held]


# Tuples of a fixed length with a name and one place for each axis of a frame.
NAMED_TUPLES = {"Point", "Point2", "Vector3", "Axes"}


def is_bundle(annotation: ast.expr | None) -> bool:
    return any("..." not in held for held in tuples(annotation))


def test_what_belongs_together_has_a_name():
    """No parameter is a tuple of a fixed length: its places would have no names."""
    bundles = set()
    for file in SOURCE.rglob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        names = [
            (ast.unparse(target), node.value)
            for node in tree.body
            if isinstance(node, ast.Assign | ast.AnnAssign)
            for target in (
                node.targets if isinstance(node, ast.Assign) else [node.target]
            )
        ]
        given = [
            (node.arg, node.annotation)
            for node in ast.walk(tree)
            if isinstance(node, ast.arg)
        ]
        bundles |= {
            f"{file.relative_to(SOURCE).as_posix()}:{name}"
            for name, kind in names + given
            if is_bundle(kind) and name not in NAMED_TUPLES
        }
    assert not bundles


def test_no_call_hides_its_arguments_in_a_tuple():
    hidden = {
        f"{file.relative_to(SOURCE).as_posix()}:{node.lineno}"
        for file in SOURCE.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        for given in node.args
        if isinstance(given, ast.Starred) and isinstance(given.value, ast.Tuple)
    }
    assert not hidden


# Exported names of all areas; only a new part of the program adds to them.
MOST_NAMES = 354


def test_few_names_are_exported():
    files = [
        file
        for file in SOURCE.rglob("__init__.py")
        if not is_private(module_of(file)) and file.parent != SOURCE
    ]
    names = [
        name
        for file in files
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and node.level
        for name in node.names
    ]
    assert len(names) <= MOST_NAMES


def test_a_class_has_a_name_of_its_own():
    places = collections.defaultdict(set)
    for file in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].add(file.relative_to(SOURCE).as_posix())
    assert not {name: files for name, files in places.items() if len(files) > 1}


def annotations(node: ast.stmt) -> Iterator[ast.expr | None]:
    """Yield those of a public function, or of a public class's members and fields."""
    if isinstance(node, ast.AnnAssign):
        yield node.annotation
    elif isinstance(node, ast.FunctionDef) and is_shown(node.name):
        given = node.args
        rest = [one for one in (given.vararg, given.kwarg) if one is not None]
        for one in (*given.posonlyargs, *given.args, *given.kwonlyargs, *rest):
            yield one.annotation
        yield node.returns
    elif isinstance(node, ast.ClassDef) and is_shown(node.name):
        for member in node.body:
            yield from annotations(member)


def is_shown(name: str) -> bool:
    return name.startswith("__") or not name.startswith("_")


def test_no_public_annotation_says_any():
    count = 0
    for file in SOURCE.rglob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for one in (a for node in tree.body for a in annotations(node)):
            names = ast.walk(one) if one is not None else ()
            count += any(isinstance(n, ast.Name) and n.id == "Any" for n in names)
    assert not count


def test_experiments_and_tests_use_what_is_public():
    files = itertools.chain(
        *((ROOT / d).rglob("*.py") for d in ("experiments", "tests"))
    )
    reaching = {
        file.relative_to(ROOT / "tests" if "tests" in file.parts else ROOT).as_posix()
        for file in files
        for module, names in imports(file)
        if any(is_private(name) for name in (module, *(f"{module}.{n}" for n in names)))
    }
    assert not reaching


# Words of a dialect; those of the field are in docs/glossary.md.
DIALECT = re.compile(
    r"\b(gives? way|fore(tells?|told)|swings? round|cannot tell|hopeless|meeting"
    r"|(beside|meets?) (its|their|the) cuts?|held_rows?|limited_?quadratic"
    r"|(come|comes|came) to rest|lanes|sloped|tied|kkt|take_spent|begin_period"
    r"|remove_due|across_gap|static_stretch|gravity_lift)\b",
    re.IGNORECASE,
)


def words(tree: ast.Module) -> Iterator[str]:
    """Yield the names that a module gives, its docstrings and its messages."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield " ".join(node.value.split())


def test_words_are_those_of_the_field():
    found = {
        (file.relative_to(SOURCE).as_posix(), match[0])
        for file in SOURCE.rglob("*.py")
        for text in (file.stem, *words(ast.parse(file.read_text(encoding="utf-8"))))
        if (match := DIALECT.search(text))
    }
    assert not found


def test_names_of_the_glossary_exist():
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    for name in re.findall(r"`dm\.([\w.]+)`", text):
        found: Any = diffmill
        for part in name.split("."):
            assert hasattr(found, part), name
            found = getattr(found, part)
