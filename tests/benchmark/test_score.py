"""Entries are read without trust, and nothing that is missing or wrong leaves a denominator."""

import csv
import json
import os
import shutil
import struct
import zipfile
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dexnudge.benchmark import score as scoring
from dexnudge.benchmark.entry import load_entry, read_answer
from dexnudge.benchmark.records import METRICS, ScoreRecord, TaskScore, merged, sealed
from dexnudge.benchmark.report import _markdown
from dexnudge.benchmark.score import score
from dexnudge.errors import InputError
from dexnudge.experiments.metrics import measure
from dexnudge.experiments.records import RecordWriter, read_records
from dexnudge.formats.hand_poses import palm_poses
from dexnudge.sampling.sampler import Sampler
from dexnudge.verification.verdicts import verify
from dexnudge.version import __version__


def write(folder, task, answer):
    (folder / "answers" / f"{task}.json").write_text(json.dumps(answer))


def rows(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_missing_and_malformed_answers_are_counted_as_failures(entry_folder, tasks, inside, tmp_path):
    names = [task.name for task in tasks.tasks]
    (entry_folder / "answers" / f"{names[0]}.json").unlink()
    write(entry_folder, names[1], {**inside, "joint_names": [*inside["joint_names"][:-1], "LFJ5"]})
    write(entry_folder, names[2], {key: value * 2 if key != "joint_names" else value for key, value in inside.items()})
    unnormalised = np.array(inside["T_world_palm"])
    unnormalised[0, :3, :3] *= 1.01
    write(entry_folder, names[3], {**inside, "T_world_palm": unnormalised.tolist()})
    (entry_folder / "answers" / f"{names[4]}.json").unlink()
    poses = np.array(inside["T_world_palm"])
    poses[0, 0, 3] = np.nan
    np.savez(entry_folder / "answers" / f"{names[4]}.npz", **{**inside, "T_world_palm": poses})
    text, entry = score([entry_folder], tasks.folder, tmp_path / "out", workers=1), load_entry(entry_folder, tasks)
    found = {
        task.task: task for each in read_records(tmp_path / "out/entries/mine", ScoreRecord) for task in each.tasks
    }
    assert list(found) == names
    assert "there is no answer" in found[names[0]].problem
    assert "has not 'THJ1'" in found[names[1]].problem
    assert "4 draws; expected 1 to 2" in found[names[2]].problem
    assert [found[name].drawn for name in names] == [0, 0, 0, 2, 2, 2]
    assert "not a rigid transform" in found[names[3]].problem
    assert found[names[3]].reasons["valid_pose"] == found[names[4]].reasons["valid_pose"] == 1
    assert "NaN" in found[names[4]].problem
    assert found[names[5]].problem == ""
    deep = verify(tasks.scene(tasks.tasks[5]), tasks.hand, read_answer(entry, names[5], tasks.hand, most=2).q)
    assert found[names[5]].rejected == f"penetration environment by {1e3 * deep.penetration_environment[0]:.1f} mm"
    assert f"- mine, {names[5]}: penetration environment by " in text
    assert found[names[3]].rejected == "valid pose"
    assert {task.feedback for task in found.values()} == {"not played"}
    everything, *families = rows(tmp_path / "out/report.csv")
    assert (everything["scene"], everything["tasks"], everything["answered"]) == ("all", "6", "3")
    assert float(everything["share"]) == float(everything["feedback"]) == 0.0
    assert sum(int(row["tasks"]) for row in families) == 6
    assert everything["failures.missing"] == "6"  # of 12 draws
    assert all(name in text for name in ("there is no answer", "A. Author", tasks.fingerprint[:16]))


def test_what_was_judged_is_not_judged_again_and_changed_entries_are_refused(
    entry_folder, tasks, tmp_path, monkeypatch
):
    text = score([entry_folder], tasks.folder, tmp_path / "out", workers=1)
    monkeypatch.setattr(scoring, "judge", lambda *_: pytest.fail("judged again"))
    assert score([entry_folder], tasks.folder, tmp_path / "out", workers=1) == text
    path = tmp_path / "out/entries/mine/results.jsonl"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:2]))
    monkeypatch.undo()
    assert score([entry_folder], tasks.folder, tmp_path / "out", workers=1) == text
    answer = next((entry_folder / "answers").iterdir())
    answer.write_text(answer.read_text() + "\n")
    with pytest.raises(InputError, match="was changed since it was judged in"):
        score([entry_folder], tasks.folder, tmp_path / "out", workers=1)


def test_lines_that_were_made_of_other_answers_are_judged_again(entry_folder, tasks, inside, tmp_path):
    text, lines = score([entry_folder], tasks.folder, tmp_path / "out", workers=1), tmp_path / "out/entries/mine"
    honest = (lines / "results.jsonl").read_text()
    first, *others = honest.splitlines()
    won = json.loads(first)
    won["verified"] = 2
    moved = json.dumps(won | {"object": "another", "seal": won["seal"]})
    (lines / "results.jsonl").write_text("\n".join([json.dumps(won), moved, *others]) + "\n")
    assert score([entry_folder], tasks.folder, tmp_path / "out", workers=1) == text
    assert sorted((lines / "results.jsonl").read_text().splitlines()) == sorted(honest.splitlines())

    path = entry_folder / "answers/phone-200_table_0.json"  # another entry of that name, with the lines of the first
    path.write_text(json.dumps({**inside, "joint_angles": [[0.1] * 16] * 2}))
    score([entry_folder], tasks.folder, tmp_path / "other", workers=1)
    judged = (tmp_path / "other/entries/mine/results.jsonl").read_text()
    (tmp_path / "other/entries/mine/results.jsonl").write_text(honest)
    score([entry_folder], tasks.folder, tmp_path / "other", workers=1)
    assert (tmp_path / "other/entries/mine/results.jsonl").read_text() == judged != honest


def test_an_entry_among_the_scores_is_refused(entry_folder, tasks, tmp_path):
    (tmp_path / "out/entries").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "out")
    inside = entry_folder.rename(tmp_path / "out/entries/mine")
    for entry, out in (
        (inside, "out"),
        (inside, "link"),
        (tmp_path / "link/entries/mine", "out"),
        (inside, "out/entries/mine"),
    ):
        with pytest.raises(InputError, match="lie in each other; expected folders apart"):
            score([entry], tasks.folder, tmp_path / out, workers=1)
    outside = inside.rename(tmp_path / "mine")
    inside.symlink_to(outside)  # its scores would be written into the entry
    with pytest.raises(InputError, match="lie in each other"):
        score([outside], tasks.folder, tmp_path / "out", workers=1)


def test_versions_that_judged_are_told_where_they_differ(entry_folder, tasks, tmp_path, monkeypatch):
    other = tmp_path / "other"
    shutil.copytree(entry_folder, other)
    (other / "entry.json").write_text((entry_folder / "entry.json").read_text().replace('"mine"', '"other"'))
    assert f"; judged by dexnudge {__version__}, " in score([other], tasks.folder, tmp_path / "out", workers=1)
    older = [replace(record, judge="0.19.0") for record in read_records(tmp_path / "out/entries/other", ScoreRecord)]
    stamp = load_entry(other, tasks).hash
    with closing(RecordWriter(tmp_path / "out/entries/other")) as writer:
        os.truncate(tmp_path / "out/entries/other/results.jsonl", 0)
        for record in older[1:]:
            writer.append(sealed(record, tasks.fingerprint, stamp))
    text = score([entry_folder, other], tasks.folder, tmp_path / "out", workers=1)
    assert (
        f"several versions of dexnudge, which may differ (mine by {__version__}; other by 0.19.0 and {__version__})"
        in text
    )


def test_claims_of_success_are_not_read(entry_folder, tasks, inside, tmp_path):
    for task in tasks.tasks:
        write(entry_folder, task.name, {**inside, "success": [True, True], "force_margin": [3.0, 3.0]})
    score([entry_folder], tasks.folder, tmp_path / "out", workers=1)
    assert float(rows(tmp_path / "out/report.csv")[0]["share"]) == 0.0


def test_a_verified_draw_that_is_written_twice_counts_once(tasks, inside, monkeypatch):
    q = np.array([[0.0, 0, 0, 1, 0, 0, 0, 1, 0, *[0.0] * 16]] * 4)
    q[2, 0], q[3, 0] = 0.02, np.nan
    verdicts = verify(tasks.scene(tasks.tasks[0]), tasks.hand, q)
    verdicts.success[:3] = True  # whatever the hand: as if it were verified, and yet not played
    monkeypatch.setattr(scoring, "verify", lambda *_: verdicts)
    found = scoring.judge(tasks.scene(tasks.tasks[0]), tasks.hand, scoring.Answer(q, {}), "task")
    assert (found.drawn, found.verified, found.first, found.reasons["repeated"]) == (4, 2, True, 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "../x"}, "name is"),
        ({"authors": ""}, "authors is"),
        ({"used": 3}, "used is 3"),
        ({"used": "x\n\n## Rates"}, "one line of printable text"),
        ({"machine": "\x1b[31m"}, "one line of printable text"),
        ({"authors": "A" * 1001}, "at most 1000 characters"),
        ({"seconds": 3}, "seconds is 3; expected an object: a number for the name of each task"),
        (
            {"seconds": {"phone-200_table_0": -1}},
            "phone-200_table_0 is -1; expected a number from 0 to 1,000,000,000",
        ),
        ({"seconds": {"phone-200_table_0": "1"}}, "seconds of phone-200_table_0 is '1'; expected a number"),
        (
            {"seconds": {"phone-200_tabel_0": 1}},
            "seconds names 'phone-200_tabel_0', which is no task .did you mean",
        ),
    ],
)
def test_a_malformed_entry_is_refused(change, message, entry_folder, tasks):
    path = entry_folder / "entry.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=message):
        load_entry(entry_folder, tasks)


def test_an_answer_that_is_no_file_is_said_to_be_none_and_notes_may_lie_beside(entry_folder, tasks):
    (entry_folder / "answers/README.md").write_text("how they were made")
    entry, path = load_entry(entry_folder, tasks), entry_folder / "answers/phone-200_table_0.json"
    path.unlink()
    for kind, make, unmake in (
        ("a pipe or a device", os.mkfifo, Path.unlink),
        ("a folder", Path.mkdir, Path.rmdir),
        ("a link to nothing", lambda path: path.symlink_to("nothing"), Path.unlink),
    ):
        make(path)
        with pytest.raises(InputError) as caught:
            read_answer(entry, "phone-200_table_0", tasks.hand, most=2)
        assert str(caught.value) == f"phone-200_table_0.json is {kind}; expected a file"
        unmake(path)
    (entry_folder / "answers/phone-200_table_0.jsn").write_text("{}")
    with pytest.raises(InputError, match=r"phone-200_table_0.jsn ends in '.jsn'; expected .json or .npz; rename it"):
        load_entry(entry_folder, tasks)


def test_answers_to_no_task_and_no_answers_are_refused(entry_folder, tasks, inside):
    write(entry_folder, "phone-200_tabel_0", inside)
    with pytest.raises(InputError, match=r"an answer to no task .did you mean 'phone-200_table_0'"):
        load_entry(entry_folder, tasks)
    for path in (entry_folder / "answers").iterdir():
        path.unlink()
    with pytest.raises(InputError, match="holds no answers"):
        load_entry(entry_folder, tasks)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"joint_names"', "cannot be read as JSON"),
        ("[]", "holds a JSON list"),
        ('{"joint_names": [], "joint_angles": []}', "lacks T_world_palm"),
        ('{"T_world_palm": NaN}', "lacks joint_angles, joint_names"),
        ('{"T_world_palm": [1, 1, 1], "joint_angles": [NaN], "joint_names": 0}', "holds 3 draws; expected 1 to 2"),
        ('{"T_world_palm": [[]], "joint_angles": [[]], "joint_names": 0}', "joint_names is 0"),
    ],
)
def test_damaged_answers_are_told(text, message, entry_folder, tasks):
    entry = load_entry(entry_folder, tasks)
    (entry_folder / "answers/phone-200_table_0.json").write_text(text)
    with pytest.raises(InputError, match=message) as raised:
        read_answer(entry, "phone-200_table_0", tasks.hand, most=2)
    assert str(entry_folder) not in str(raised.value)  # it stands in the report


def test_a_draw_of_nan_fails_alone_in_json_too(entry_folder, tasks, inside):
    entry = load_entry(entry_folder, tasks)
    write(entry_folder, "phone-200_table_0", {**inside, "joint_angles": [[float("nan")] * 16, [0.0] * 16]})
    answer = read_answer(entry, "phone-200_table_0", tasks.hand, most=2)
    assert list(answer.wrong) == [0]
    assert np.isfinite(answer.q).all(axis=1).tolist() == [False, True]


def test_an_answer_that_is_too_large_or_announces_too_much_is_refused_before_it_is_read(entry_folder, tasks, inside):
    entry, path = load_entry(entry_folder, tasks), entry_folder / "answers/phone-200_table_0.json"
    before = entry.hash
    with path.open("wb") as file:
        file.truncate(9 << 30)  # without blocks
    assert entry.hash != before
    with pytest.raises(InputError, match="9216 MiB; expected at most 16 MiB"):
        read_answer(entry, path.stem, tasks.hand, most=2)
    path.unlink()
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({'9' * 400},), }}".encode()
    np.savez(path.with_suffix(".npz"), **{key: inside[key] for key in ("joint_names", "T_world_palm")})
    with zipfile.ZipFile(path.with_suffix(".npz"), "a") as archive:
        archive.writestr("joint_angles.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)
    with pytest.raises(InputError, match=r"announces \d{380}"):
        read_answer(entry, path.stem, tasks.hand, most=2)
    np.savez_compressed(path.with_suffix(".npz"), **inside, more=np.zeros(3 << 20))
    with pytest.raises(InputError, match="unpacks to 24 MiB; expected at most 16 MiB"):
        read_answer(entry, path.stem, tasks.hand, most=2)


def test_entries_are_text_and_stay_beside_the_report(entry_folder, tasks, tmp_path, monkeypatch):
    monkeypatch.setattr(scoring, "run_tasks", lambda *_, **__: [])
    path = entry_folder / "entry.json"
    said = {"name": "report.md", "authors": "<script>x</script> [a](b) | `c`"}
    path.write_text(json.dumps(json.loads(path.read_text()) | said))
    shown = _markdown(["a_b _c_ \x1b\n## Rates ![a](b) <i>"])
    assert shown == r"- a_b \_c\_ \\x1b ## Rates !\[a\](b) &lt;i&gt;"
    monkeypatch.setattr(scoring, "write_report", lambda given, *_: _markdown([given[0].authors]))
    text = score([entry_folder], tasks.folder, tmp_path / "out", workers=1)
    assert text == r"- &lt;script&gt;x&lt;/script&gt; \[a\](b) \| \`c\`"
    assert (tmp_path / "out/entries/report.md/score.json").is_file()


def test_links_out_of_the_folder_and_pickles_are_refused(entry_folder, tasks, inside, tmp_path):
    entry, path = load_entry(entry_folder, tasks), entry_folder / "answers/phone-200_table_0.json"
    (tmp_path / "outside.json").write_text(path.read_text())
    path.unlink()
    path.symlink_to(tmp_path / "outside.json")
    with pytest.raises(InputError, match="outside the folder"):
        read_answer(entry, "phone-200_table_0", tasks.hand, most=2)
    path.unlink()
    objects = np.array(inside["joint_names"], dtype=object)
    np.savez(path.with_suffix(".npz"), **{**inside, "joint_names": objects})
    with pytest.raises(InputError, match="damaged"):
        read_answer(entry, "phone-200_table_0", tasks.hand, most=2)
    write(entry_folder, "phone-200_table_0", inside)
    with pytest.raises(InputError, match="two answers"):
        read_answer(entry, "phone-200_table_0", tasks.hand, most=2)


def test_joint_angles_are_taken_by_name(entry_folder, tasks, inside):
    entry, order = load_entry(entry_folder, tasks), np.arange(16)[::-1]
    angles = np.linspace(0.0, 0.3, 16)
    swapped = {**inside, "joint_names": [inside["joint_names"][place] for place in order]}
    write(entry_folder, "phone-200_table_0", {**swapped, "joint_angles": [angles[order].tolist()] * 2})
    answer = read_answer(entry, "phone-200_table_0", tasks.hand, most=2)
    assert np.allclose(answer.q[:, 9:], angles)


def test_rates_are_over_all_tasks_and_intervals_over_objects():
    def record(name, family, *scores):
        verified = sum(each.verified for each in scores)
        return ScoreRecord(
            object=name, scene=family, method="m", seed=0, num=4 * len(scores), verified=verified, tasks=list(scores)
        )

    good = TaskScore("a", drawn=4, verified=4, first=True, open_loop="fell_short", feedback="success")
    half = TaskScore("b", drawn=2, verified=1, reasons={"contact": 1}, open_loop="success", feedback="success")
    none = TaskScore("c", problem="there is no answer")
    records = [record("one", "table", good, half), record("one", "shelf", none), record("two", "table", none, none)]
    (row,) = measure(merged(records), METRICS)
    assert (row["objects"], row["tasks"], row["answered"]) == (2, 5, 2)
    assert row["first"].value == pytest.approx(np.mean([1 / 3, 0]))
    assert row["share"].value == pytest.approx(np.mean([5 / 12, 0]))
    assert row["open_loop"].value == pytest.approx(np.mean([1 / 3, 0]))
    assert row["feedback"].value == pytest.approx(np.mean([2 / 3, 0]))
    assert row["failures"] == {"missing": 14, "contact": 1}
    assert row["outcomes"] == {"success": 2, "not played": 3}
    assert (row["first"].low, row["first"].high) == (0.0, pytest.approx(1 / 3))


def test_a_task_is_answered_by_a_draw_with_a_pose_and_times_count_where_all_answered_tasks_have_one():
    nothing = TaskScore("a", drawn=2, reasons={"valid_pose": 2})
    posed = TaskScore("b", drawn=2, reasons={"valid_pose": 1, "contact": 1})
    other = TaskScore("c", drawn=1, reasons={"contact": 1})

    def row(seconds):
        record = ScoreRecord(
            object="one", scene="table", method="m", seed=0, num=6, tasks=[nothing, posed, other], seconds=seconds
        )
        return measure([record], METRICS)[0]

    assert row({})["answered"] == 2
    assert row({"b": 1.0, "c": 3.0})["seconds"].value in (1.0, 3.0)
    assert row({"b": 1.0})["seconds"] is row({"a": 1.0})["seconds"] is row({"a": 1.0, "b": 1.0})["seconds"] is None
    assert row({"a": 100.0, "b": 3.0, "c": 3.0})["seconds"].value == 3.0


@pytest.mark.slow
def test_what_the_sampler_draws_succeeds_and_is_pushed(entry_folder, tasks, tmp_path):
    task = tasks.tasks[0]
    samples = Sampler(tasks.hand).sample(tasks.scene(task), num=8, seed=0)
    assert samples.num_verified >= 2
    best = samples.q[:2].astype(np.float64)
    answer = {"joint_names": list(tasks.hand.joint_names), "T_world_palm": palm_poses(best).tolist()}
    write(entry_folder, task.name, answer | {"joint_angles": best[:, 9:].tolist()})
    entry = load_entry(entry_folder, tasks)
    found = scoring.judge(tasks.scene(task), tasks.hand, read_answer(entry, task.name, tasks.hand, most=2), task.name)
    assert (found.drawn, found.verified, found.first) == (2, 2, True)
    assert found.feedback == "success"
