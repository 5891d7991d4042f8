"""What README, tutorials and examples show is run as it stands, in a folder of its own."""

import re
import shlex
from pathlib import Path

import pytest

import dexnudge
from dexnudge.cli.main import main

ROOT = Path(__file__).parents[2]
PAGES = [
    "README.md",
    "docs/getting_started.md",
    *sorted(str(p.relative_to(ROOT)) for p in (ROOT / "docs/tutorials").glob("*.md")),
]
BLOCK = re.compile(r"^```(python|console)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SUCCEEDED = 0
NOTHING_SUCCEEDED = 3  # done and written: a tiny example may verify nothing


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_a_page_runs_from_top_to_bottom(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {"__name__": page}
    blocks = BLOCK.findall((ROOT / page).read_text(encoding="utf-8"))
    assert blocks
    for language, text in blocks:
        if language == "python":
            exec(compile(text, page, "exec"), namespace)  # noqa: S102 - our own page
            continue
        for line in text.splitlines():
            assert line.startswith("$ dexnudge "), line
            assert main(shlex.split(line)[2:]) in (SUCCEEDED, NOTHING_SUCCEEDED), line


@pytest.mark.parametrize(
    "page", ["README.md", *sorted(str(p.relative_to(ROOT)) for p in (ROOT / "docs").rglob("*.md"))]
)
def test_pages_import_nothing_private(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    assert not re.findall(r"^\s*(?:from dexnudge[. ]|import dexnudge\.).*", text, re.MULTILINE)


def test_the_reference_lists_every_public_name():
    listed = set(
        re.findall(r"^::: dexnudge\.(\w+)$", (ROOT / "docs/reference.md").read_text(encoding="utf-8"), re.MULTILINE)
    )
    assert listed == set(dexnudge.__all__) - {"__version__"}
