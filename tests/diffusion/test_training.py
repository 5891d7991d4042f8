"""Training learns a known distribution, and an interruption changes nothing."""

import dataclasses
import itertools
import json
import math
import os
import shutil
import signal
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from dexnudge.dataset.loading import load_dataset
from dexnudge.dataset.manifest import write_manifest
from dexnudge.dataset.schema import NUM_DIRECTIONS, BehaviourCounts, ConfigurationRow
from dexnudge.dataset.shards import write_shard
from dexnudge.diffusion.checkpoint import (
    MODEL_FOLDER,
    STATE_NAME,
    WEIGHTS_NAME,
    read_provenance,
    read_state_header,
    save_state,
)
from dexnudge.diffusion.config import TrainingConfig
from dexnudge.diffusion.distributed import has_bfloat16
from dexnudge.diffusion.prior import SLIDE, DiffusionPrior
from dexnudge.diffusion.schedule import ddim_step
from dexnudge.diffusion.training import TrainingLog, TrainingPlan, plan_training, train
from dexnudge.diffusion.training_run import TrainingRun
from dexnudge.errors import CheckpointError, DexnudgeError, InputError, OutputError


@pytest.fixture(scope="module")
def dataset_folder(toy, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    toy.write_toy_dataset(folder)
    return folder


@pytest.fixture(scope="module")
def short(architecture):
    """Twelve steps with everything in them."""
    return TrainingConfig(
        steps=12,
        groups=2,
        rows_per_group=4,
        num_points=32,
        warmup_steps=3,
        validate_every=6,
        checkpoint_every=4,
        log_every=1,
        num_threads=1,  # threads wait for each other on a busy machine
        architecture=architecture,
    )


@pytest.fixture(scope="module")
def uninterrupted(dataset_folder, short, tmp_path_factory):
    folder = tmp_path_factory.mktemp("uninterrupted")
    result = train(dataset_folder, folder, short)
    assert result.finished
    return folder


def outcome(folder):
    """Everything a run leaves behind, without the wall-clock times in it."""
    with (folder / STATE_NAME).open("rb") as file:
        size = int.from_bytes(file.read(8), "little")
        header, tensors = json.loads(file.read(size)), file.read()
    log = [json.loads(line) for line in (folder / "train.jsonl").read_text().splitlines()]
    for line in log:
        line.pop("train/steps_per_s", None)
        line.pop("train/loss", None)  # a running mean that starts afresh with each continuation
    config = json.loads((folder / "model" / "config.json").read_text())
    header.pop("__metadata__")
    return header, tensors, log, config, (folder / "model" / "model.safetensors").read_bytes()


def test_a_continued_run_ends_in_the_same_bits(dataset_folder, short, uninterrupted, tmp_path):
    for stop in (2, 7):
        result = train(dataset_folder, tmp_path, short, stop_at_step=stop)
        assert (result.step, result.finished) == (stop, False)
    assert train(dataset_folder, tmp_path, short).finished
    assert outcome(tmp_path) == outcome(uninterrupted)


@pytest.mark.parametrize(("moment", "taken"), [("before", 5), ("after", 6)])
def test_sigterm_saves_and_stops(moment, taken, dataset_folder, short, uninterrupted, tmp_path, monkeypatch):
    advance = TrainingRun.advance

    def terminated_in_step_5(run, between):
        if run.step == 5 and moment == "before":
            os.kill(os.getpid(), signal.SIGTERM)
        loss = advance(run, between)
        if run.step == 6 and moment == "after":
            os.kill(os.getpid(), signal.SIGTERM)
        return loss

    former = signal.getsignal(signal.SIGTERM)
    with monkeypatch.context() as patch:
        patch.setattr(TrainingRun, "advance", terminated_in_step_5)
        result = train(dataset_folder, tmp_path, short)
    assert (result.step, result.finished) == (taken, False)
    assert signal.getsignal(signal.SIGTERM) is former
    train(dataset_folder, tmp_path, short)
    assert outcome(tmp_path) == outcome(uninterrupted)


def test_a_crash_costs_only_the_steps_since_the_last_checkpoint(
    dataset_folder, short, uninterrupted, tmp_path, monkeypatch
):
    advance = TrainingRun.advance

    def crash_in_step_6(run, between):
        if run.step == 6:
            raise MemoryError
        return advance(run, between)

    with monkeypatch.context() as patch:
        patch.setattr(TrainingRun, "advance", crash_in_step_6)
        with pytest.raises(MemoryError):
            train(dataset_folder, tmp_path, short)
    (tmp_path / f".writing-1-{STATE_NAME}").write_bytes(b"half a state")
    train(dataset_folder, tmp_path, short)
    assert outcome(tmp_path) == outcome(uninterrupted)


def test_a_finished_run_is_not_trained_again(dataset_folder, short, uninterrupted):
    before = outcome(uninterrupted)
    again = train(dataset_folder, uninterrupted, short)
    assert again.step == 12
    assert again.validation == read_provenance(uninterrupted / "model")["validation"] != {}
    assert outcome(uninterrupted) == before


@pytest.mark.parametrize("left", ["earlier model", "no model", "new weights beside the old config", "half"])
def test_a_run_killed_before_its_last_model_was_written_writes_it(dataset_folder, short, uninterrupted, tmp_path, left):
    train(dataset_folder, tmp_path, short, stop_at_step=7)
    model, last = tmp_path / MODEL_FOLDER, uninterrupted / MODEL_FOLDER / WEIGHTS_NAME
    shutil.copy(uninterrupted / STATE_NAME, tmp_path)
    if left == "no model":
        shutil.rmtree(model)
    elif left == "new weights beside the old config":
        shutil.copy(last, model)
    elif left == "half":
        (model / WEIGHTS_NAME).write_bytes(last.read_bytes()[:1000])
    assert train(dataset_folder, tmp_path, short).finished
    assert (model / WEIGHTS_NAME).read_bytes() == last.read_bytes()
    assert read_provenance(model)["step"] == 12


def test_another_run_is_not_continued(toy, dataset_folder, short, uninterrupted, tmp_path):
    with pytest.raises(
        CheckpointError, match=r"cannot be continued: learning_rate was 0.001, is now 0.5; use the same"
    ):
        train(dataset_folder, uninterrupted, dataclasses.replace(short, learning_rate=0.5))
    toy.write_toy_dataset(tmp_path, seed=1)
    with pytest.raises(CheckpointError, match="cannot be continued: dataset was"):
        train(tmp_path, uninterrupted, short)


def test_epsilon_starts_where_some_signal_is_left(dataset_folder, short, tmp_path):
    architecture = dataclasses.replace(short.architecture, prediction_type="epsilon", zero_terminal_snr=None)
    train(dataset_folder, tmp_path, dataclasses.replace(short, architecture=architecture))
    prior = DiffusionPrior.from_folder(tmp_path / "model")
    assert not prior.config.architecture.zero_terminal_snr
    clean = prior.predict_clean(prior.noise(8), 999, prior.condition(torch.rand(1, 50, 6)))
    assert clean.isfinite().all()


def test_a_truncated_state_is_named(dataset_folder, short, uninterrupted, tmp_path):
    data = (uninterrupted / STATE_NAME).read_bytes()
    for share in (0.0, 0.01, 0.9):
        (tmp_path / STATE_NAME).write_bytes(data[: int(share * len(data))])
        with pytest.raises(CheckpointError, match="truncated or not a training state"):
            train(dataset_folder, tmp_path, short)


@pytest.mark.parametrize("place", [-1, -1000, 0.5])
def test_a_flipped_bit_in_a_state_is_named(dataset_folder, short, uninterrupted, tmp_path, place):
    data = bytearray((uninterrupted / STATE_NAME).read_bytes())
    data[place if place < 0 else int(place * len(data))] ^= 1
    (tmp_path / STATE_NAME).write_bytes(data)
    with pytest.raises(CheckpointError, match=rf"{STATE_NAME} is damaged: its SHA-256 is not"):
        train(dataset_folder, tmp_path, short)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("step", -1),
        ("step", None),
        ("minutes", "x"),
        ("loss", []),
        ("validation", 5),
        ("validation", {"loss": 10**400}),
        ("validation", {"[/]": 1.0}),
        ("config", 3),
        ("config", {}),
    ],
)
def test_a_state_of_another_header_is_named(uninterrupted, tmp_path, key, value):
    save_state(tmp_path, {}, read_state_header(uninterrupted) | {key: value})
    with pytest.raises(CheckpointError, match="not a training state"):
        read_state_header(tmp_path)


@pytest.mark.parametrize("change", [lambda tensor: tensor[..., :0], lambda tensor: tensor * math.nan, lambda _: None])
def test_a_tensor_that_a_state_lacks_is_named(dataset_folder, short, uninterrupted, tmp_path, change):
    tensors = load_file(uninterrupted / STATE_NAME)
    name = next(key for key in tensors if key.startswith("second_moment/"))
    changed = {key: change(tensor) if key == name else tensor for key, tensor in tensors.items()}
    kept = {key: tensor for key, tensor in changed.items() if tensor is not None}
    save_state(tmp_path, kept, read_state_header(uninterrupted))
    with pytest.raises(CheckpointError, match=name):
        train(dataset_folder, tmp_path, short)


def test_stopping_before_the_first_step_writes_no_model(dataset_folder, short, tmp_path):
    result = train(dataset_folder, tmp_path, short, stop_at_step=0)
    assert not result.model_folder.exists()


@pytest.fixture
def clock(monkeypatch):
    """A clock that goes on by 5 ms each time it is looked at, however busy the machine is."""
    ticks = SimpleNamespace(perf_counter=itertools.count(0.0, 0.005).__next__)
    monkeypatch.setattr("dexnudge.diffusion.training.time", ticks)


@pytest.mark.usefixtures("clock")
def test_a_time_limit_ends_the_run_at_the_lowest_learning_rate(dataset_folder, short, tmp_path):
    config = dataclasses.replace(short, steps=10**9, max_minutes=0.01)
    result = train(dataset_folder, tmp_path, config)
    assert result.finished
    assert result.step in (60, 61)  # 0.6 s, of which a step with what is due after it takes 10 ms
    assert result.validation
    log = [json.loads(line) for line in (tmp_path / "train.jsonl").read_text().splitlines()]
    rates = [line["train/learning_rate"] for line in log if "train/learning_rate" in line]
    assert rates[-1] <= 0.05 * max(rates)


@pytest.mark.usefixtures("clock")
def test_a_plan_fills_the_time_limit_with_steps(dataset_folder, short):
    dataset = load_dataset(dataset_folder)
    plan = plan_training(dataset, dataclasses.replace(short, steps=None, max_minutes=5.0, validate_every=1000))
    assert 0.5 * 300.0 < plan.steps * plan.seconds_per_step < 300.0  # less what measuring took, and a reserve
    assert str(plan).startswith(f"{plan.steps} steps of ")


def test_a_planned_run_has_the_weights_of_as_many_steps_and_keeps_its_plan(dataset_folder, short, tmp_path):
    config = dataclasses.replace(short, steps=None, max_minutes=60.0)
    plans = []
    planned = TrainingPlan(max_minutes=60.0, seconds_per_step=0.1, steps=12)
    with pytest.MonkeyPatch.context() as patch:  # an hour would be too long: a plan of twelve steps
        patch.setattr("dexnudge.diffusion.training.plan_training", lambda *_: planned)
        train(dataset_folder, tmp_path / "planned", config, stop_at_step=7, on_plan=plans.append)
    assert plans == [planned]
    result = train(dataset_folder, tmp_path / "planned", config, on_plan=plans.append)
    assert (result.step, result.finished, len(plans)) == (12, True, 1)
    train(dataset_folder, tmp_path / "given", dataclasses.replace(short, steps=12))
    weights = [(tmp_path / name / "model" / "model.safetensors").read_bytes() for name in ("planned", "given")]
    assert weights[0] == weights[1]


def test_a_resumed_log_is_on_disk_before_its_next_line(tmp_path):
    """A kill at any moment after a resumption finds every line up to the state's step in the file."""
    path = tmp_path / "train.jsonl"
    lines = [json.dumps({"step": step, "train/loss": 1.0}) + "\n" for step in range(1, 9)]
    path.write_text("".join(lines) + '{"step": 9, "train/lo')
    log = TrainingLog(tmp_path, step=6)
    assert path.read_text() == "".join(lines[:6])
    log.write(7, {"train/loss": 2.0})
    assert path.read_text() == "".join(lines[:6]) + '{"step": 7, "train/loss": 2.0}\n'
    log.close()


def test_a_diverging_run_stops_with_the_reason(dataset_folder, short, tmp_path):
    config = dataclasses.replace(short, learning_rate=1e30, gradient_clip=1e30, warmup_steps=1)
    with pytest.raises(
        DexnudgeError, match=r"training diverged at step \d+: the loss is (nan|inf); .*lower `learning_rate`"
    ):
        train(dataset_folder, tmp_path, config)


def test_held_out_objects_are_named_and_not_trained_on(dataset_folder, uninterrupted):
    provenance = read_provenance(uninterrupted / "model")
    assert provenance["objects"] == 2
    assert len(provenance["held_out_objects"]) == 1


def test_bfloat16_where_the_machine_has_it(dataset_folder, short, tmp_path, monkeypatch):
    config = dataclasses.replace(short, steps=4, precision="bfloat16", validate_every=2)
    if has_bfloat16(torch.device("cpu")):
        result = train(dataset_folder, tmp_path, config)
        assert result.step == 4
        assert np.isfinite(list(result.validation.values())).all()
        assert {tensor.dtype for tensor in load_file(tmp_path / STATE_NAME).values()} == {torch.float32}
        with pytest.raises(CheckpointError, match="precision was 'bfloat16', is now 'float32'"):
            train(dataset_folder, tmp_path, dataclasses.replace(config, precision="float32"))
    monkeypatch.setattr("dexnudge.diffusion.distributed.has_bfloat16", lambda device: False)
    with pytest.raises(
        InputError, match=r"precision is bfloat16, which cpu cannot compute: .*set `precision` to float32"
    ):
        train(dataset_folder, tmp_path / "other", config)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_a_gpu_that_is_not_there(dataset_folder, short, tmp_path):
    with pytest.raises(InputError, match=r"needs a CUDA device of its own; torch .* sees 0; set `device` to cpu"):
        train(dataset_folder, tmp_path, dataclasses.replace(short, device="cuda"))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"steps": 0}, "`steps` is 0; expected a number from 1 to"),
        ({"grasp_fraction": 1.5}, "`grasp_fraction` is 1.5; expected a number from 0 to 1"),
        ({"scale_jitter": 1.0}, "`scale_jitter` is 1.0; expected a number from 0 to 0.99"),
        ({"point_noise": -0.1}, "`point_noise` is -0.1; expected a number from 0 to 1"),
        ({"seed": -1}, "`seed` is -1; expected a whole number from 0"),
        ({"learning_rate": float("nan")}, "`learning_rate` is nan; expected a number from 1e-30"),
        ({"groups": 4096, "rows_per_group": 4096}, "make 16,777,216 configurations; expected at most 262,144"),
        ({"max_minutes": 0.0}, "`max_minutes` is 0.0; expected a number from 1e-06"),
    ],
)
def test_impossible_settings(settings, message):
    with pytest.raises(InputError, match=message):
        TrainingConfig(**settings)


def modes_in_frame_c(dimension):
    """Two ways to push toward +x, from behind left and behind right, and one grasp from above."""
    push_left, push_right, grasp = np.zeros((3, dimension))
    push_left[:9] = [-0.15, 0.08, 0.02, 0, 0, -1, 0, 1, 0]
    push_right[:9] = [-0.15, -0.08, 0.02, 0, 1, 0, 0, 0, -1]
    grasp[:9] = [0.0, 0.0, 0.2, 1, 0, 0, 0, -1, 0]
    push_left[9:], push_right[9:], grasp[9:] = 0.2, 1.2, 0.7
    return push_left, push_right, grasp


@pytest.mark.slow
@pytest.mark.parametrize(
    ("prediction_type", "loss_weighting", "steps"),
    [("epsilon", "uniform", 1200), ("sample", "min_snr", 400), ("v_prediction", "uniform", 800)],
)
def test_samples_recover_the_modes_that_belong_to_the_condition(
    toy, architecture, tmp_path, prediction_type, loss_weighting, steps
):
    rng = np.random.default_rng(0)
    manifest = toy.toy_manifest(2)
    push_left, push_right, grasp = modes_in_frame_c(toy.DIMENSION)
    write_manifest(tmp_path / "data", manifest)
    margin = np.full(NUM_DIRECTIONS, -1.0)
    margin[4] = 2.0  # only toward +y of the resting frame: frame C is turned by -90 degrees against it
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

    def row(mode, behaviour):
        q = mode + np.concatenate([rng.normal(0, 0.005, 3), np.zeros(6), rng.normal(0, 0.03, toy.DIMENSION - 9)])
        q[:9] = (q[:9].reshape(3, 3) @ quarter.T).reshape(-1)
        return ConfigurationRow(
            behaviour=behaviour,
            q=q,
            direction_margin=margin if behaviour == "push" else np.full(NUM_DIRECTIONS, -1.0),
            contact_links=(),
            contact_points=np.zeros((0, 3)),
            digits=(),
            penetration_object=0.0,
            penetration_environment=0.0,
            penetration_self=0.0,
            seed=0,
        )

    for name in manifest.objects:
        rows = [row(mode, kind) for mode, kind in [(push_left, "push"), (push_right, "push"), (grasp, "grasp")] * 40]
        counts = {"push": BehaviourCounts(attempted=80, kept=80), "grasp": BehaviourCounts(attempted=40, kept=40)}
        write_shard(tmp_path / "data", manifest, name, rows, toy.toy_cloud(rng), counts)
    config = TrainingConfig(
        steps=steps,
        groups=4,
        rows_per_group=32,
        num_points=64,
        warmup_steps=20,
        learning_rate=4e-3,
        ema_decay=0.98,
        yaw_jitter=0.0,
        loss_weighting=loss_weighting,
        architecture=dataclasses.replace(architecture, prediction_type=prediction_type, zero_terminal_snr=None),
    )
    result = train(tmp_path / "data", tmp_path / "run", config)
    log = [json.loads(line) for line in (tmp_path / "run" / "train.jsonl").read_text().splitlines()]
    losses = [line["train/loss"] for line in log if "train/loss" in line]
    assert losses[-1] < 0.5 * losses[0]

    prior = DiffusionPrior.from_folder(result.model_folder)
    cloud = torch.from_numpy(toy.toy_cloud(rng)).float()[None]

    def sample(behaviour, *, twist):
        condition = prior.condition(cloud, behaviour, twist=twist)
        generator = torch.Generator().manual_seed(0)
        with torch.inference_mode():
            x = prior.noise(64, generator=generator)
            timesteps = prior.schedule.timesteps(20)
            for t, t_previous in zip(timesteps, [*timesteps[1:], -1], strict=True):
                x = ddim_step(prior.schedule, x, prior.predict_clean(x, t, condition), t, t_previous)
            return prior.normaliser.denormalise(x).numpy()

    pushes = sample("non_prehensile", twist=SLIDE)
    left = np.linalg.norm(pushes[:, :3] - push_left[:3], axis=1) < 0.04
    right = np.linalg.norm(pushes[:, :3] - push_right[:3], axis=1) < 0.04
    assert (left | right).mean() > 0.9
    assert 0.2 < left.mean() < 0.8
    np.testing.assert_allclose(pushes[left, 9:].mean(axis=0), push_left[9:], atol=0.1)
    np.testing.assert_allclose(pushes[right, 9:].mean(axis=0), push_right[9:], atol=0.1)
    np.testing.assert_allclose(pushes[left, 3:9].mean(axis=0), push_left[3:9], atol=0.15)
    grasps = sample("grasp", twist=None)
    assert (np.linalg.norm(grasps[:, :3] - grasp[:3], axis=1) < 0.04).mean() > 0.9


def test_a_folder_of_something_else_is_left_alone(dataset_folder, short, tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"holds 'thesis\.txt' and no training"):
        train(dataset_folder, tmp_path, short)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
