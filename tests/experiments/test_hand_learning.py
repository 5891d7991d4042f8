"""A hand is learned in one call: the plan in closed form, a tiny run from end to end, stopped anywhere, and its report."""

import json
import shutil
from dataclasses import replace
from itertools import pairwise

import pytest

from dexnudge.diffusion.training_run import TrainingRun
from dexnudge.errors import CheckpointError, InputError, OutputError
from dexnudge.experiments.config import ExperimentConfig
from dexnudge.experiments.learning import learn as hand_learning
from dexnudge.experiments.learning.learn import StageClock, _follow, hand_digest, learn_hand, write_plan
from dexnudge.experiments.learning.plan import BATCH, LearningPlan, LearningRates, plan_learning, training_config
from dexnudge.experiments.records import RecordWriter
from dexnudge.hands.export import export_hand
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.claims import claim_folder, read_claim
from dexnudge.jobs.folders import owned_folder
from dexnudge.sampling.sampler import Sampler
from dexnudge.synthesis.generate import GenerationLog

# A machine on which a batch of attempts takes 2 s, a grasp 0.1 s, a step 0.1 s and a trial 5 s, and nothing to start.
RATES = LearningRates(start=0.0, attempt=2.0 / BATCH, kept=0.3, grasp=0.1, step=0.1, trial=5.0)
TINY = LearningPlan(
    minutes=30.0,
    workers=1,
    seed=3,
    objects=3,
    attempts=96,
    grasps=0,
    steps=5,
    scenes=("table",),
    trial_objects=2,
    draws=2,
    measuring=1.0,
    data=60.0,
    training=60.0,
    evaluation=60.0,
    rates=replace(RATES, step=15.0),  # so that the state is saved after every second step
)


def test_an_hour_is_shared_in_closed_form():
    plan = plan_learning(60.0, RATES, workers=2, seed=4, measuring=20.0)
    available = 0.97 * 3600 - 20
    least_data, least_evaluation = 4 * 2 / 2, 2 * 5 / 2
    rest = available - least_data - 100 * 0.1 - least_evaluation
    data = least_data + 0.3 * rest  # 1040 s: two batches for each of 320 objects take 640, grasps get what is left
    grasps = int((2 * data / 320 - 2 * 2) / 0.1)
    assert (plan.objects, plan.attempts, plan.grasps) == (320, 512, grasps) == (320, 512, 24)
    assert (plan.scenes, plan.trial_objects) == (("table", "layers", "shelf"), 20)
    assert (plan.data, plan.evaluation) == (320 * (2 * 2 + 24 * 0.1) / 2, 3 * 20 * 5 / 2)
    assert plan.steps == 20_000 < (available - plan.data - plan.evaluation) / 0.1  # more is of no use
    assert plan.rows == round(320 * 512 * 0.3)
    assert plan_learning(90.0, RATES, workers=2).grasps == 32
    for few in (replace(RATES, grasp=None), replace(RATES, grasp=0.4)):  # 6 for each object are too few to be of use
        assert plan_learning(60.0, few, workers=2).grasps == 0


def test_few_minutes_cut_objects_and_scenes_and_say_so():
    plan = plan_learning(2.0, RATES, workers=2)
    rest = 0.97 * 120 - 4 - 10 - 5
    assert (plan.objects, plan.attempts, plan.grasps) == (int(4 + 0.3 * rest), 256, 0)
    assert (plan.scenes, plan.trial_objects) == (("table",), int(2 * (5 + 0.1 * rest) / 5))
    assert plan.steps == int((0.97 * 120 - plan.data - plan.evaluation) / 0.1)
    assert (plan.data, plan.evaluation) == (plan.objects * 2 / 2, plan.trial_objects * 5 / 2)
    text = str(plan)
    assert f"{plan.objects} objects x 256 attempts at pushes, presses and hooks; some {plan.rows:,} rows" in text
    assert f"cut: data from {plan.objects} of the 320 objects of builtin:train" in text
    assert "cut: no evaluation in the scenes layers, shelf" in text


def test_more_minutes_never_buy_less():
    plans = [
        plan_learning(minutes, RATES, workers=2) for minutes in (0.4, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0, 120.0, 600.0)
    ]
    for before, after in pairwise(plans):
        assert before.objects * before.attempts <= after.objects * after.attempts
        assert before.steps <= after.steps
        assert len(before.scenes) * before.trial_objects <= len(after.scenes) * after.trial_objects
    assert plans[-1].steps == 20_000
    assert plans[-1].cuts == ()


def test_less_than_the_least_is_refused_with_the_least():
    with pytest.raises(
        InputError, match=r"`minutes` is 0.3; expected at least 0.4 on this machine: 4 objects with 256"
    ):
        plan_learning(0.3, RATES, workers=2)  # 4 + 10 + 5 s and the reserve
    plan = plan_learning(0.4, RATES, workers=2)
    assert (plan.objects, plan.trial_objects) == (5, 2)  # 0.4 min are rounded up
    assert plan.steps >= 100


def test_a_short_training_warms_up_and_averages_over_a_share_of_itself():
    short, long = (training_config(steps, grasps=True, threads=2) for steps in (1000, 40_000))
    assert (short.warmup_steps, short.ema_decay) == (100, pytest.approx(0.98))
    assert (long.warmup_steps, long.ema_decay) == (500, 0.999)


def test_the_clock_counts_over_starts(tmp_path, monkeypatch):
    times = iter([0.0, 0.0, 7.0, 100.0, 100.0, 103.0])
    monkeypatch.setattr("dexnudge.experiments.learning.learn.time.monotonic", lambda: next(times))
    with pytest.raises(MemoryError), StageClock(tmp_path / "clock.json").stage("data"):
        raise MemoryError
    clock = StageClock(tmp_path / "clock.json")
    with clock.stage("data"):
        pass
    assert StageClock(tmp_path / "clock.json").seconds == {"data": 10.0}


@pytest.mark.parametrize(
    "damaged",
    ["", "[]", '{"data": NaN}', '{"data": []}', '{"data": -1}', '{"data": 1e300}', '{"data": "1"}', "[" * 10**5],
)
def test_a_damaged_clock_begins_again(tmp_path, damaged):
    (tmp_path / "clock.json").write_text(damaged)
    assert StageClock(tmp_path / "clock.json").seconds == {}


@pytest.mark.parametrize("damage", ["config", "num", "checksum", "text"])
def test_an_evaluation_that_is_not_the_plans_is_refused(tmp_path, damage):
    config, file = (
        ExperimentConfig(objects="builtin:test", num=16, hand="before"),
        tmp_path / "table" / "experiment.json",
    )
    claim_folder(file.parent, file.name, vars(config), format_version=3, device="cpu")
    _follow(file, replace(config, hand="moved"))
    content = read_claim(file.parent, file.name, format_version=3)
    assert content["config"]["hand"] == "moved"
    claim_folder(file.parent, file.name, vars(replace(config, hand="moved")), format_version=3, device="cpu")
    if damage == "text":
        file.write_text(json.dumps(content)[:-5])
    elif damage == "checksum":
        file.write_text(json.dumps({**content, "versions": {"dexnudge": "0.0.1"}}))
    else:
        changed = [] if damage == "config" else {**content["config"], "num": 17}
        file.write_text(json.dumps({"format_version": 3, "config": changed, "versions": {}, "machine": {}}))
    with pytest.raises(InputError, match=r"experiment\.json.*; remove .*table to have it evaluated again"):
        _follow(file, config)


@pytest.fixture(scope="module")
def prepared(gripper, tmp_path_factory):
    """A prepared hand with a tiny plan."""
    folder = tmp_path_factory.mktemp("prepared")
    export_hand(load_hand(gripper), folder)
    write_plan(folder, load_hand(folder), TINY)
    return folder


@pytest.fixture(scope="module")
def learned(prepared, tmp_path_factory):
    """(folder, report) of a hand that was learned without a stop."""
    folder = tmp_path_factory.mktemp("learned") / "hand"
    shutil.copytree(prepared, folder)
    return folder, learn_hand(folder, minutes=30.0).report


@pytest.mark.slow
def test_every_number_of_the_report_is_one_of_the_stages_files(learned):
    folder, text = learned
    learning = folder / "learning"
    assert (learning / "report.md").read_text() == text
    numbers = json.loads((learning / "report.json").read_text())
    manifest = json.loads((learning / "data" / "manifest.json").read_text())
    assert numbers["data"] == manifest["counts"]
    push = manifest["counts"]["push"]
    assert f"| push | {push['attempted']} | {push['kept']} |" in text
    assert sum(count["attempted"] for count in manifest["counts"].values()) == 3 * 96
    records = [json.loads(line) for line in (learning / "evaluation/table/results.jsonl").read_text().splitlines()]
    own = json.loads((learning / "evaluation/table/report.json").read_text())
    assert numbers["metrics"] == own["metrics"]
    for row in numbers["metrics"]:
        of_method = [record for record in records if record["method"] == row["method"]]
        assert (row["objects"], row["draws"]) == (2, 4)
        assert row["single"]["value"] == sum(record["verified"] for record in of_method) / 4
        assert f"| table | {row['method']} | 2 | 0 | 4 | {100 * row['single']['value']:.1f} (" in text
    assert numbers["training"]["step"] == 5
    assert "5 of 5 planned steps" in text
    assert "data from 3 of the 320 objects of builtin:train" in text
    assert "With fewer than 5 objects an interval says little" in text
    for link in ("best.png", "data/README.md", "../weights/README.md", "evaluation/table/report.md"):
        assert f"({link})" in text
        assert (learning / link).is_file()


@pytest.mark.slow
def test_the_weights_are_found_beside_the_hand_and_their_card_tells_the_success(learned):
    folder, text = learned
    sampler = Sampler.from_pretrained(load_hand(folder))
    assert sampler.weights_folder == folder / "weights"
    card = (folder / "weights" / "README.md").read_text()
    assert card.count("## Success") == 1
    table = text.split("## Success")[1].split("\n| ")[1:4]
    assert all(line in card for line in table)
    assert "| `start_from` | shadow_lite |" in card


@pytest.mark.slow
def test_stopped_anywhere_and_moved_it_ends_in_the_same_bytes(prepared, learned, tmp_path, monkeypatch):
    """As after kill -9: the block that an exception leaves writes nothing more."""
    folder = tmp_path / "hand"
    shutil.copytree(prepared, folder)
    calls = {"number": 0}

    def stopped(owner, name, at):
        """Let the method raise at its call number `at`."""
        before = getattr(owner, name)
        calls["number"] = 0

        def method(*arguments, **options):
            calls["number"] += 1
            if calls["number"] == at:
                raise MemoryError
            return before(*arguments, **options)

        with monkeypatch.context() as patch:
            patch.setattr(owner, name, method)
            with pytest.raises(MemoryError):
                learn_hand(folder)

    stopped(GenerationLog, "add", 2)
    assert len(list((folder / "learning/data").glob("shard-*"))) >= 1
    stopped(TrainingRun, "advance", 4)
    stopped(hand_learning, "_copy_model", 1)
    moved = tmp_path / "moved" / "hand"
    shutil.move(folder, moved)
    folder = moved
    stopped(RecordWriter, "append", 3)
    folder = tmp_path / "hand"
    shutil.move(moved, folder)
    stopped(hand_learning, "write_learning_report", 1)
    learn_hand(folder, minutes=30.0)
    assert outcome(folder) == outcome(learned[0])


def outcome(folder):
    """Everything that learning leaves behind, without the wall-clock times in it."""
    learning = folder / "learning"
    records = [json.loads(line) for line in (learning / "evaluation/table/results.jsonl").read_text().splitlines()]
    for record in records:
        record.pop("seconds")
    numbers = json.loads((learning / "report.json").read_text())
    figures = [{name: row[name] for name in ("single", "top", "any", "rejected")} for row in numbers["metrics"]]
    data = {
        path.name: path.read_bytes() for path in (learning / "data").iterdir() if path.suffix in (".parquet", ".json")
    }
    config = json.loads((folder / "weights" / "config.json").read_text())
    config["provenance"]["config"].pop("max_minutes")  # what the other stages had left of the minutes
    weights = (folder / "weights" / "model.safetensors").read_bytes(), config
    picture = (learning / "best.png").read_bytes()
    return data, weights, records, figures, numbers["data"], numbers["training"]["step"], picture


def test_another_hand_other_minutes_and_a_damaged_plan_are_refused(prepared, tmp_path):
    folder = tmp_path / "hand"
    shutil.copytree(prepared, folder)
    with pytest.raises(
        InputError, match=r"is a plan with `minutes` 30, got 60; give the same, or remove .*learning to"
    ):
        learn_hand(folder, minutes=60.0)
    with pytest.raises(InputError, match="is a plan with `seed` 3, got 4"):
        learn_hand(folder, seed=4)
    for wrong in (0.0, -1.0, float("nan"), float("inf"), 1e300):
        with pytest.raises(InputError, match=r"`minutes` is .*; expected more than 0"):
            learn_hand(folder, minutes=wrong)
    with (
        owned_folder(folder / "learning"),
        pytest.raises(OutputError, match="is being written by"),
    ):
        learn_hand(folder)
    before = hand_digest(folder)
    yaml = folder / "hand.yaml"
    yaml.write_text(yaml.read_text() + "\n")
    assert hand_digest(folder) != before
    with pytest.raises(InputError, match=r"is not the one that .*plan\.json was made for"):
        learn_hand(folder)
    path = folder / "learning" / "plan.json"
    content = json.loads(path.read_text())
    for name, wrong in (("objects", "many"), ("minutes", -1.0), ("steps", 1.5), ("more", 1)):
        path.write_text(json.dumps({**content, "plan": {**content["plan"], name: wrong}}))
        with pytest.raises(InputError, match=r"plan\.json: plan.*; expected .*; remove .*learning to learn anew"):
            learn_hand(folder)
    yaml.write_text(yaml.read_text()[:-1])
    for name, twisted in (("objects", 5), ("steps", 100), ("draws", 0), ("scenes", [])):
        path.write_text(json.dumps({**content, "plan": {**content["plan"], name: twisted}}))
        with pytest.raises(
            InputError, match=r"plan\.json has changed since it was written.*; put it back as it was, or"
        ):
            learn_hand(folder)


def test_a_foreign_folder_of_weights_is_not_taken_for_a_model(prepared, tmp_path):
    folder = tmp_path / "hand"
    shutil.copytree(prepared, folder)
    (folder / "weights").mkdir()
    with pytest.raises(CheckpointError, match="no weights for hand 'gripper'"):
        Sampler.from_pretrained(load_hand(folder))
