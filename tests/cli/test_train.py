"""Options of `dexnudge train` mean the settings that they are named after."""

import json
import re
from dataclasses import asdict, fields, replace

import pytest
import tyro

from dexnudge.cli.train import Batches, Compute, Network, Reports, Train
from dexnudge.diffusion.config import LAYOUTS, Architecture
from dexnudge.diffusion.model_card import WITHOUT_OPTION, training_recipe
from dexnudge.diffusion.training_config import TrainingConfig

CHANGED = TrainingConfig(
    steps=7,
    max_minutes=2.5,
    groups=4,
    rows_per_group=3,
    learning_rate=2e-3,
    grasp_fraction=0.2,
    behaviour_balance=1.0,
    unconditional_fraction=0.3,
    direction_dropout=0.15,
    behaviour_dropout=0.05,
    min_direction_margin=1.5,
    yaw_jitter=0.1,
    scale_jitter=0.02,
    point_noise=0.001,
    loss_weighting="velocity",
    validate_every=5,
    checkpoint_every=6,
    seed=3,
    num_threads=1,
    precision="bfloat16",
    device="cuda",
    architecture=Architecture(
        width=64,
        depth=2,
        num_heads=2,
        schedule="linear",
        prediction_type="sample",
        zero_terminal_snr=False,
        token_layout="scalars",  # noqa: S106
    ),
)


def parsed(*arguments):
    options = ("--data", "DATA", "--out", "RUN", *arguments)
    return tyro.cli(Train, args=options, config=(tyro.conf.OmitArgPrefixes,)).config()


def test_without_options_the_settings_are_the_defaults():
    assert parsed() == TrainingConfig()


@pytest.mark.parametrize("config", [TrainingConfig(), CHANGED, replace(CHANGED, architecture=Architecture())])
def test_the_command_of_the_card_gives_the_settings_back(config):
    recipe = training_recipe(json.loads(json.dumps({**asdict(config), "processes": 1})))
    command = re.fullmatch(r"```\ndexnudge train --data DATA --out RUN ?(.*)\n```", recipe)[1]
    assert parsed(*command.split()) == config


def test_the_command_of_the_card_starts_as_many_processes():
    settings = {**asdict(TrainingConfig()), "processes": 4}
    assert "torchrun --nproc-per-node 4 -m dexnudge train --data DATA" in training_recipe(settings)


def test_every_setting_has_an_option_or_is_listed_as_having_none():
    options = {field.name for group in (Train, Batches, Compute, Network, Reports) for field in fields(group)}
    settings = {field.name for group in (TrainingConfig, Architecture) for field in fields(group)} - {"architecture"}
    assert settings - options == set(WITHOUT_OPTION)


def test_epsilon_needs_no_second_option():
    assert parsed("--prediction-type", "epsilon").architecture.zero_terminal_snr is False


def test_the_help_names_the_layouts_and_the_defaults(dexnudge):
    text = " ".join(dexnudge("train", "--help").out.replace("│", " ").split())
    assert f"{{None,{','.join(LAYOUTS)}}}" in text
    defaults = {**asdict(TrainingConfig()), **asdict(Architecture())}
    for group in (Batches, Reports, Network):
        for field in fields(group):
            option = text.split(f"--{field.name.replace('_', '-')} ")[1].split("(default:")[0]
            stated = re.search(r"(\S+) unless given", option)[1]
            assert stated == str(defaults[field.name]).removesuffix(".0"), field.name
