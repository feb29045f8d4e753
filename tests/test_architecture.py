"""What the folder tree promises: imports point down it, and nothing in it is longer than a reader likes."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import slepian_prt

PACKAGE = Path(slepian_prt.__file__).parent

# Each layer imports those before it; the modules beside the layers know nothing but each other.
BESIDE = ("errors", "arrays", "files", "cache_folder", "signals", "streams", "summary", "examples")
LAYERS = (
    "sphere", "slepian", "machine", "renderer", "distributed", "lighting", "scene", "paths", "transport", "compression",
    "relighting", "runtime", "export", "viewer",
    "evaluation", "accuracy", "datasets", "cli",
)  # fmt: skip

LONGEST_FILE = 400
LONGEST_FUNCTION = 60
LONGEST_COMMAND = 200

MODULES = sorted(path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py") if "scenes" not in path.parts)


def imported(tree: ast.AST) -> Iterator[str]:
    """Modules of the package that are imported anywhere in a module, also inside functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "slepian_prt":
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from names if node.module == "slepian_prt" else [node.module]
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.split(".")[0] == "slepian_prt")


def violations(module: Path, tree: ast.AST) -> list[str]:
    """Imports of a module that point up the tree."""
    own = module.parts[0].removesuffix(".py")
    allowed = {*BESIDE, *LAYERS[: LAYERS.index(own) + 1]} if own in LAYERS else {*BESIDE}
    return [name for name in imported(tree) if name.split(".")[1] not in allowed]


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_imports_point_down_the_tree(module):
    if module.name in ("__init__.py", "__main__.py") and len(module.parts) == 1:
        return  # the public names, and the command's entry
    assert violations(module, ast.parse((PACKAGE / module).read_text())) == []


def test_an_import_that_points_up_is_seen():
    tree = ast.parse("def f():\n    from slepian_prt.cli.options import scene_argument")
    assert violations(Path("transport/paths.py"), tree) == ["slepian_prt.cli.options"]
    assert violations(Path("cli/paths.py"), tree) == []
    assert violations(Path("files.py"), ast.parse("import slepian_prt.sphere.caps")) == ["slepian_prt.sphere.caps"]


def test_every_folder_is_a_layer():
    folders = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").is_file()}
    assert folders == set(LAYERS)


def length(function: ast.FunctionDef) -> int:
    """Lines without the docstring."""
    lines = function.end_lineno - function.lineno + 1
    first = function.body[0]
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str):
        lines -= first.end_lineno - first.lineno + 1
    return lines


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_files_and_functions_are_of_a_length_to_read(module):
    text = (PACKAGE / module).read_text()
    assert len(text.splitlines()) <= (LONGEST_COMMAND if module.parts[0] == "cli" else LONGEST_FILE)
    functions = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)]
    assert [f.name for f in functions if length(f) > LONGEST_FUNCTION] == []
