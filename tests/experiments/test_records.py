"""Records are read as they were written; what is damaged is named."""

import json
from contextlib import closing

import pytest

from dexnudge.errors import InputError, OutputError
from dexnudge.experiments.execution_trial import ExecutionRecord
from dexnudge.experiments.records import FILE, RecordWriter, TrialRecord, read_records
from dexnudge.experiments.sampling_records import SamplingRecord


def write(folder, records):
    with closing(RecordWriter(folder)) as writer:
        for record in records:
            writer.append(record)


def test_records_are_read_as_they_were_written(tmp_path, four_records, executed):
    write(tmp_path, four_records)
    assert read_records(tmp_path, SamplingRecord) == four_records
    common = read_records(tmp_path, TrialRecord)
    assert [(record.key, record.verified, record.num) for record in common] == [
        (record.key, record.verified, record.num) for record in four_records
    ]
    (tmp_path / "executed").mkdir()
    played = ExecutionRecord(
        object="a", scene="table", method="paper", seed=3, num=4, verified=2, executed=[executed()]
    )
    write(tmp_path / "executed", [played])
    assert read_records(tmp_path / "executed", ExecutionRecord) == [played]


def test_an_unfinished_line_is_dropped_and_written_over(tmp_path, four_records):
    write(tmp_path, four_records[:2])
    whole = (tmp_path / FILE).read_bytes()
    (tmp_path / FILE).write_bytes(whole + whole[:50])
    assert read_records(tmp_path, SamplingRecord) == four_records[:2]
    write(tmp_path, four_records[2:])
    assert read_records(tmp_path, SamplingRecord) == four_records
    assert read_records(tmp_path / "nowhere", SamplingRecord) == []


def test_damaged_foreign_and_doubled_lines_are_named(tmp_path, four_records):
    write(tmp_path, four_records)
    lines = (tmp_path / FILE).read_text().splitlines()
    content = json.loads(lines[1])
    damages = {
        r"line 2: JSONDecodeError.*delete the line to have it computed again": lines[1][:-2],
        r"line 2: KeyError: 'success'": json.dumps({k: v for k, v in content.items() if k != "success"}),
        r"line 2: ValueError: a record of kind 'lifting' among those of kind 'sampling'": json.dumps(
            {**content, "kind": "lifting"}
        ),
        r"line 2: \('a', 'table', 'steered_noise'\) occurs twice": lines[0],
        r"line 2: InputError: the record: verified is 'many'; expected a whole number": json.dumps(
            content | {"verified": "many"}
        ),
        r"line 2: InputError: the record: success\[0\] is 1; expected true or false": json.dumps(
            content | {"success": [1]}
        ),
        r"line 2: InputError: the record: status is 'dine'; expected 'done' or": json.dumps(
            content | {"status": "dine"}
        ),
        r"line 2: ValueError: NaN is not a JSON number": json.dumps(content | {"force_margin": [float("nan")]}),
        r"line 2: ValueError: the key 'num' stands twice": lines[1][:-1] + ', "num": 3}',
    }
    for message, line in damages.items():
        (tmp_path / FILE).write_text("\n".join([lines[0], line, *lines[2:]]) + "\n")
        with pytest.raises(InputError, match=message):
            read_records(tmp_path, SamplingRecord)


def test_a_file_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / FILE).mkdir()
    with pytest.raises(OutputError, match=r"cannot write .*results\.jsonl.*the same command goes on from there"):
        RecordWriter(tmp_path)
