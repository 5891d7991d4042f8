"""What README, tutorials and examples show is run as it stands, in a folder of its own."""

import re
from pathlib import Path

import pytest

import dexnudge

ROOT = Path(__file__).parents[2]
TUTORIALS = sorted(str(page.relative_to(ROOT)) for page in (ROOT / "docs/tutorials").glob("*.md"))
ELSEWHERE = "docs/tutorials/data_and_training.md"  # tests/cli/test_end_to_end.py runs it and looks at what came out
PAGES = ["README.md", "docs/getting_started.md", *(page for page in TUTORIALS if page != ELSEWHERE)]
SUCCEEDED = 0
NOTHING_SUCCEEDED = 3  # done and written: a tiny example may verify nothing


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_a_page_runs_from_top_to_bottom(page, run_page, tmp_path):
    outcomes = run_page(page, tmp_path)
    for line, (code, _) in outcomes.items():
        assert code in (SUCCEEDED, NOTHING_SUCCEEDED), line


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
