"""Options of `dexnudge train` mean the settings that they are named after."""

import json
from dataclasses import asdict, fields, replace
from typing import get_args

import pytest
import tyro

from dexnudge.cli.train import Train
from dexnudge.diffusion.config import DEFAULT_STEPS, Architecture, TokenLayout, TrainingConfig
from dexnudge.diffusion.model_card import training_command

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
    return tyro.cli(Train, args=options, config=(tyro.conf.OmitArgPrefixes,)).training


def command(config: TrainingConfig, processes: int = 1) -> str:
    """The card's command, from the settings as a model's file has them."""
    settings = {**asdict(config), "steps": config.steps or DEFAULT_STEPS, "processes": processes}
    return training_command(json.loads(json.dumps(settings)))


def test_without_options_the_settings_are_the_defaults():
    assert parsed() == TrainingConfig()


@pytest.mark.parametrize(
    "config",
    [
        TrainingConfig(),
        CHANGED,
        replace(CHANGED, architecture=Architecture(encoder_widths=(8, 16), width=32, prediction_type="epsilon")),
        TrainingConfig(steps=7, ema_decay=0.5),
    ],
)
def test_the_command_of_the_card_gives_the_settings_back(config):
    options = command(config).removeprefix("dexnudge train --data DATA --out RUN").split()
    assert parsed(*options) == config


def test_the_command_of_the_card_starts_as_many_processes():
    assert command(TrainingConfig(), 4).startswith("torchrun --nproc-per-node 4 -m dexnudge train --data DATA")


def test_epsilon_needs_no_second_option():
    assert parsed("--prediction-type", "epsilon").architecture.zero_terminal_snr is False


def test_the_help_names_choices_and_every_setting(dexnudge):
    text = " ".join(dexnudge("train", "--help").out.replace("│", " ").split())
    assert f"--token-layout {{{','.join(get_args(TokenLayout))}}}" in text
    for group in (TrainingConfig, Architecture):
        for field in fields(group):
            assert field.name == "architecture" or f"--{field.name.replace('_', '-')} " in text


def test_a_setting_that_is_impossible_is_an_argument_error(dexnudge):
    outcome = dexnudge("train", "--data", "x", "--out", "y", "--steps", "0")
    assert outcome.code == 2
    assert "--steps is 0; expected a number from 1 to" in outcome.err
