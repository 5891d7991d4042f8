"""What the documentation says about the code exists: files on every page, names in the table of equations."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/concepts/method.md"
POINTER = re.compile(r"`([\w/]+\.py)(?::([\w.]+))?`")


def pointers() -> list[tuple[str, str, str]]:
    """(column, path, name or "") of everything that the table names."""
    rows = re.findall(r"^\| (?!what )(.+) \|$", PAGE.read_text(encoding="utf-8").split("\n## ")[1], re.MULTILINE)
    found = []
    for row in rows:
        cells = row.split(" | ")
        assert len(cells) == 3, row
        for column, cell in zip(("code", "tests"), cells[1:], strict=True):
            named = POINTER.findall(cell)
            assert named, row
            found += [(column, path, name) for path, name in named]
    return found


def definitions(body: list[ast.stmt]) -> dict[str, list[ast.stmt]]:
    """What a module or class defines, each with its own body."""
    found: dict[str, list[ast.stmt]] = {}
    for statement in body:
        if isinstance(statement, ast.FunctionDef | ast.ClassDef):
            found[statement.name] = statement.body
        elif isinstance(statement, ast.Assign | ast.AnnAssign):
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            found |= {target.id: [] for target in targets if isinstance(target, ast.Name)}
    return found


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))], ids=lambda page: page.name
)
def test_files_that_a_page_names_exist(page):
    named = {path for path, _ in POINTER.findall(page.read_text(encoding="utf-8"))}
    places = [ROOT, ROOT / "src/dexnudge", ROOT / "tests"]
    assert not [path for path in named if not any((place / path).is_file() for place in places)]


@pytest.mark.parametrize(("column", "path", "name"), sorted(set(pointers())))
def test_what_the_table_names_exists(column, path, name):
    folders = [ROOT / "tests"] if column == "tests" else [ROOT / "src/dexnudge", ROOT]
    file = next((folder / path for folder in folders if (folder / path).is_file()), None)
    assert file is not None, path
    body = ast.parse(file.read_text(encoding="utf-8")).body
    for part in filter(None, name.split(".")):
        body = definitions(body)[part]
