"""results.jsonl survives a writer that is killed at any byte."""

import json
from contextlib import closing

import pytest

from dexnudge.errors import InputError, OutputError
from dexnudge.experiments.rows import FILE, Row, RowWriter, read_rows


def row(name: str, **changes) -> Row:
    return Row(
        **{
            "object": name,
            "scene": "table",
            "method": "steered_noise",
            "status": "sampled",
            "num": 2,
            "seed": 1,
            **changes,
        }
    )


def append(folder, *rows: Row) -> None:
    with closing(RowWriter(folder)) as writer:
        for each in rows:
            writer.append(each)


def test_rows_come_back_as_they_were_written(tmp_path):
    rows = [row("a", success=[True, False], force_margin=[2.5, 0.0], rejected={"force": 1}), row("b", status="failed")]
    append(tmp_path, rows[0])
    append(tmp_path, rows[1])
    assert read_rows(tmp_path) == rows


def test_no_file_means_no_rows(tmp_path):
    assert read_rows(tmp_path) == []


def test_a_line_cut_at_any_byte_is_dropped_and_nothing_else(tmp_path):
    append(tmp_path, row("a"), row("b"))
    whole = (tmp_path / FILE).read_bytes()
    first = len(whole.splitlines(keepends=True)[0])
    for end in range(first, len(whole)):
        (tmp_path / FILE).write_bytes(whole[:end])
        assert [r.object for r in read_rows(tmp_path)] == ["a"]
    append(tmp_path, row("c"))
    assert [r.object for r in read_rows(tmp_path)] == ["a", "c"]


def test_a_damaged_whole_line_is_named(tmp_path):
    append(tmp_path, row("a"))
    with (tmp_path / FILE).open("a") as file:
        file.write('{"object": "b"}\n')
    with pytest.raises(InputError, match=r"results.jsonl, line 2: KeyError"):
        read_rows(tmp_path)


def test_a_row_that_occurs_twice_is_refused(tmp_path):
    append(tmp_path, row("a"), row("a"))
    with pytest.raises(InputError, match="occurs twice"):
        read_rows(tmp_path)


def test_nan_never_reaches_the_file(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        append(tmp_path, row("a", force_margin=[float("nan")]))


def test_an_unwritable_file_is_an_output_error(tmp_path):
    (tmp_path / FILE).mkdir()
    with pytest.raises(OutputError, match="cannot write"):
        RowWriter(tmp_path)


def test_lines_are_plain_json(tmp_path):
    append(tmp_path, row("a"))
    assert json.loads((tmp_path / FILE).read_text())["object"] == "a"
