"""Experiments go on after any interruption, without a record lost or doubled; what fails is counted."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
import trimesh

from dexnudge.errors import InputError, OutputError
from dexnudge.experiments.config import ExperimentConfig, TrialKey, trial_keys, trial_seed
from dexnudge.experiments.execution_trial import ExecutionTrial
from dexnudge.experiments.records import FILE, RecordWriter, read_records
from dexnudge.experiments.run import TrialRunner, read_run
from dexnudge.experiments.sampling_records import SamplingRecord
from dexnudge.experiments.sampling_trial import SamplingTrial
from dexnudge.jobs.folders import owned_folder

TOY = Path(__file__).with_name("toy_trial.py")
CONFIG = ExperimentConfig(objects="builtin:test", scenes=("table",), num=4)
SIZE = 42  # objects of the set


def load_toy():
    spec = importlib.util.spec_from_file_location("toy_trial", TOY)
    module = importlib.util.module_from_spec(spec)
    sys.modules["toy_trial"] = module  # worker processes find it by this name
    spec.loader.exec_module(module)
    return module


toy = load_toy()
ToyTrial, ToyRecord = toy.ToyTrial, toy.ToyRecord


def run(out, kind=None, config=CONFIG, *, workers=1, on_record=None):
    ((_, records),) = TrialRunner([kind or ToyTrial()], config, out).run(workers=workers, on_record=on_record)
    return records


def test_a_second_run_computes_only_what_is_missing(tmp_path):
    records, seen = run(tmp_path / "out"), []
    assert len({record.key for record in records}) == len(records) == SIZE
    file = tmp_path / "out" / "toy" / FILE
    lines = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(b"".join(lines[:40]) + lines[40][:25])
    assert run(tmp_path / "out", on_record=lambda _, so_far, total: seen.append((so_far, total))) == records
    assert seen == [(records[:41], SIZE), (records, SIZE)]
    assert file.read_bytes().splitlines(keepends=True) == lines


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"length": float("nan")}, "`length` is nan m; expected the longest side"),
        ({"physics": {"mass": -1.0}}, "`mass` is -1.0; expected a finite number > 0"),
        ({"physics": {"friction_environment": float("nan")}}, "`friction_environment` is nan; expected a finite"),
        ({"physics": {"turn_deg": float("inf")}}, "`turn_deg` is inf; expected 0.1 to 180 degrees"),
        ({"physics": {"about": [0.0, 0.0, 0.0]}}, "`about` needs `turn_deg`"),
    ],
)
def test_numbers_that_no_scene_can_have_are_refused_before_anything_is_written(tmp_path, options, message):
    with pytest.raises(InputError, match=message):
        run(tmp_path / "out", config=replace(CONFIG, **options))
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    "twisted", [{"versions": {"dexnudge": "0.0.1"}}, {"config": {}}, {"machine": 3}, {"sha256": "x"}]
)
def test_an_experiment_that_has_changed_is_not_read(tmp_path, twisted):
    run(tmp_path)
    file = tmp_path / "toy" / "experiment.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), **twisted}))
    with pytest.raises(InputError, match=r"experiment\.json.*the same command with another `out` writes an equal"):
        read_run(ToyTrial(), tmp_path)


def test_an_experiment_of_an_earlier_version_has_no_checksum_and_is_read(tmp_path):
    records = run(tmp_path)
    file = tmp_path / "toy" / "experiment.json"
    content = json.loads(file.read_text())
    del content["sha256"]
    file.write_text(json.dumps(content))
    assert read_run(ToyTrial(), tmp_path) == (content, records)


@pytest.mark.parametrize("damaged", ["", "{", '{"format_version": 3, "config": 1}'])
def test_records_beside_a_damaged_experiment_are_not_lost(tmp_path, damaged):
    """What the message says is true: the file of another run with the same options takes its place."""
    records = run(tmp_path / "out")
    file = tmp_path / "out" / "toy" / "experiment.json"
    whole = file.read_bytes()
    file.write_text(damaged)
    with pytest.raises(
        InputError, match=r"the same command with another `out` writes an equal experiment.json at once"
    ):
        run(tmp_path / "out")
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "again", on_record=lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    assert (tmp_path / "again" / "toy" / "experiment.json").read_bytes() == whole
    file.write_bytes(whole)
    assert run(tmp_path / "out", on_record=lambda *_: pytest.fail("computed again")) == records


def test_other_options_are_refused_by_name(tmp_path):
    run(tmp_path / "out")
    with pytest.raises(InputError, match=r"holds another experiment: num is 4 there and 5 here"):
        run(tmp_path / "out", config=replace(CONFIG, num=5))
    with pytest.raises(InputError, match=r"losses is None there and \{'sweep': 0.0\} here"):
        run(tmp_path / "out", config=replace(CONFIG, losses={"sweep": 0.0}))
    with pytest.raises(InputError, match=r"toy_most is 8 there and 7 here"):
        run(tmp_path / "out", ToyTrial(most=7))


def test_a_folder_of_something_else_is_refused_and_kept(tmp_path):
    (tmp_path / "toy").mkdir()
    (tmp_path / "toy" / "thesis.tex").write_text("years")
    with pytest.raises(OutputError, match="holds no experiment"):
        run(tmp_path)
    assert os.listdir(tmp_path / "toy") == ["thesis.tex"]
    (tmp_path / "toy" / "results.jsonl").write_text("{}\n")
    with pytest.raises(OutputError, match=r"holds no experiment.*records beside it are not lost"):
        run(tmp_path)


def test_a_folder_that_another_run_owns_is_refused(tmp_path):
    with owned_folder(tmp_path / "out"), pytest.raises(OutputError, match=str(tmp_path / "out")):
        run(tmp_path / "out")
    assert not (tmp_path / "out" / "toy").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenes": ()}, "no scene is named"),
        ({"scenes": ("table", "table")}, "the scene 'table' is named twice"),
        ({"scenes": ("tabel",)}, "unknown scene 'tabel'"),
        ({"methods": ("our",)}, "unknown method 'our'"),
        ({"num": 0}, "`num` is 0; expected at least 1"),
        ({"losses": {"sweep": -1.0}}, r"the weight 'sweep' of the energy is -1; expected a number from 0 to 1e\+06"),
        ({"max_objects": 0}, "`max_objects` is 0; expected at least 1"),
    ],
)
def test_bad_options_are_refused_before_anything_is_written(tmp_path, changes, message):
    with pytest.raises(InputError, match=message):
        run(tmp_path / "out", config=replace(CONFIG, **changes))
    assert os.listdir(tmp_path) == []


def test_seeds_are_the_same_for_methods_and_differ_for_objects_scenes_and_experiments():
    key = TrialKey("phone", "table", "steered_noise")
    assert trial_seed(0, key) == trial_seed(0, key._replace(method="unguided")) == 194863522  # as in 0.6.0
    others = [
        trial_seed(0, key._replace(scene="shelf")),
        trial_seed(0, key._replace(object="book")),
        trial_seed(1, key),
    ]
    assert len({trial_seed(0, key), *others}) == 4


def test_fewer_objects_are_spread_over_the_set_and_its_trials_stand_together():
    every = [key.object for key in trial_keys(CONFIG)]
    keys = trial_keys(replace(CONFIG, max_objects=4, methods=("steered_noise", "unguided")))
    assert [key.object for key in keys[::2]] == [every[0], every[10], every[21], every[31]]
    assert [key.method for key in keys[:2]] == ["steered_noise", "unguided"]
    assert keys[0].object == keys[1].object
    assert len(trial_keys(replace(CONFIG, max_objects=100))) == SIZE


def test_what_a_run_left_that_was_killed_before_its_first_file_does_not_stop_the_next(tmp_path):
    (tmp_path / "toy").mkdir()
    (tmp_path / "toy" / "experiment.partial").write_text('{"format')
    assert len(run(tmp_path)) == SIZE


@pytest.mark.slow  # starts processes
def test_what_cannot_be_placed_and_what_kills_its_process_are_failed_trials(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(TOY.parent))  # where worker processes look for the kind of trial
    refused, killed = trial_keys(CONFIG)[3].object, trial_keys(CONFIG)[5].object
    records = run(tmp_path, ToyTrial(refuses=refused, kills=killed), workers=2)
    failed = {record.object: record.reason for record in records if record.status == "failed"}
    assert set(failed) == {refused, killed}
    assert failed[refused] == "SceneError: it does not fit"
    assert "worker process died (exit code 9)" in failed[killed]
    assert all(record.num == 4 for record in records)
    assert len(records) == SIZE


def test_what_the_experiment_already_knows_to_fail_is_counted_and_not_run(tmp_path, sampled):
    own = [key.object for key in trial_keys(CONFIG)[:3]]
    with closing(RecordWriter(tmp_path)) as writer:
        writer.append(
            SamplingRecord(
                object=own[0], scene="table", method="steered_noise", status="failed", reason="no", seed=7, num=4
            )
        )
        writer.append(sampled(own[1], [False] * 4, [0.5] * 4))
        writer.append(sampled(own[2], [True] * 4, [2.0] * 4))
    records = {record.object: record for record in run(tmp_path)}
    assert (records[own[0]].status, records[own[0]].reason) == ("failed", "no")
    assert (records[own[1]].status, records[own[1]].num, records[own[1]].process) == ("unverified", 4, 0)
    assert records[own[2]].process == os.getpid()
    assert len(records) == SIZE


def test_kinds_run_one_after_another_and_lie_in_folders_of_their_own(tmp_path):
    config = replace(CONFIG, max_objects=2)
    kinds = [ToyTrial(), ExecutionTrial(num=3)]
    with closing(RecordWriter(tmp_path)) as writer:
        for key in trial_keys(config):
            writer.append(SamplingRecord(**key._asdict(), status="failed", reason="no", seed=0, num=4))
    found = dict(TrialRunner(kinds, config, tmp_path).run(workers=1))
    assert list(found) == kinds
    for kind in kinds:
        claim, records = read_run(kind, tmp_path)
        assert records == found[kind]
        assert claim["config"]["num"] == 4
    assert claim["config"]["execution_num"] == 3


@pytest.mark.slow  # starts processes
def test_a_run_killed_in_the_middle_ends_with_every_record_once(tmp_path):
    """Trials stand still once enough of them are recorded, so that what is killed is always in the middle."""
    file = tmp_path / "out" / "toy" / FILE
    process = subprocess.Popen([sys.executable, str(TOY), str(tmp_path / "out"), "20"])
    while not file.exists() or file.read_bytes().count(b"\n") < 20:
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = [line for line in file.read_bytes().splitlines(keepends=True) if line.endswith(b"\n")]
    assert 20 <= len(before) < 2 * SIZE
    subprocess.run([sys.executable, str(TOY), str(tmp_path / "out"), "1000"], check=True)
    assert file.read_bytes().splitlines(keepends=True)[: len(before)] == before
    records = read_records(file.parent, ToyRecord)
    assert len({record.key for record in records}) == len(records) == 2 * SIZE


class TestSamplingTrial:
    """With real objects and scenes."""

    @pytest.fixture
    def objects(self, tmp_path):
        (tmp_path / "objects").mkdir()
        (tmp_path / "objects" / "broken.obj").write_text("v 0 0 0\n")
        trimesh.creation.box((0.5, 0.5, 0.5)).export(tmp_path / "objects" / "cube.obj")
        return tmp_path / "objects"

    def test_what_cannot_be_read_or_does_not_fit_is_a_failed_trial(self, objects, tmp_path):
        config = replace(CONFIG, objects=str(objects), scenes=("shelf",), methods=("random_start_projection",))
        broken, cube = run(tmp_path / "out", SamplingTrial(), config)
        assert (broken.status, broken.num, broken.success) == ("failed", 4, [])
        assert broken.reason.startswith("MeshError")
        assert cube.status == "failed"
        assert cube.reason.startswith("SceneError")
