"""Hostile options of the command line: numbers, names and paths that no command can take."""

from __future__ import annotations

import random
from typing import Any

from hostile.case import CONTROL, MARKUP, MISSING_HAND, Draw, Hostile
from hostile.checkpoints import TRAIN, data
from hostile.mutations import NAMES, NUMBERS

HAND = ("--hand", MISSING_HAND)
SCENE = ("scene", "phone", "--scene", "table", *HAND, "--out", "out")
SAMPLE = ("sample", "phone", "--scene", "table", *HAND, "--out", "out")
EVALUATE = ("evaluate", "--objects", "builtin:test", "--max-objects", "1", *HAND, "--out", "out")
GENERATE = ("dataset", "generate", "--objects", "builtin:train:2", *HAND, "--out", "out")
BIG = (
    "18446744073709551616",
    "9" * 400,
    "1e300",
    "1e400",
    "-1",
    "0",
    "nan",
    "inf",
    "-inf",
    "",
    " ",
    "1.5",
    "0x10",
    "1_000",
    "٣",
)
PATHS = ("", " ", "a" * 300, "a/" * 3000, "\0", "x\0y", "/dev/zero", "/dev/stdin", "/proc/self/mem", "..", "/", "nothing", "~", MARKUP,
         CONTROL, "\udcff", "-", "C:\\x", "http://127.0.0.1:9/x", "file:///etc/passwd")  # fmt: skip
SCENE_NUMBERS = (
    "--seed",
    "--length",
    "--mass",
    "--friction-hand",
    "--friction-environment",
    "--max-normal-force",
    "--turn",
    "--tip",
)
SAMPLE_NUMBERS = ("--num", "--verified", "--max-draws", "--weight-object", "--clearance-environment", *SCENE_NUMBERS)
TRAIN_NUMBERS = [
    "--steps",
    "--max-minutes",
    "--groups",
    "--rows-per-group",
    "--learning-rate",
    "--warmup-steps",
    "--weight-decay",
    "--gradient-clip",
    "--ema-decay",
    "--grasp-fraction",
    "--behaviour-balance",
    "--direction-dropout",
    "--min-direction-margin",
    "--yaw-jitter",
    "--point-noise",
    "--scale-jitter",
    "--num-points",
    "--snr-limit",
    "--validate-every",
    "--checkpoint-every",
    "--log-every",
    "--seed",
    "--num-threads",
    "--width",
    "--depth",
    "--num-heads",
    "--mlp-ratio",
    "--encoder-widths",
    "--feature-width",
    "--num-train-timesteps",
    "--clean-limit",
]
EVALUATE_NUMBERS = ("--num", "--seed", "--workers", "--max-objects", "--execute-num")
GENERATE_NUMBERS = ("--non-prehensile", "--grasps", "--upright", "--seed", "--workers")
NUMBERS_OF = {SCENE: SCENE_NUMBERS, SAMPLE: SAMPLE_NUMBERS, EVALUATE: EVALUATE_NUMBERS, GENERATE: GENERATE_NUMBERS}
PATHS_OF: dict[tuple[str, ...], tuple[str, ...]] = {
    ("scene", "{}", *HAND, "--out", "out"): ("the object",),
    ("scene", "phone", "--hand", "{}", "--out", "out"): ("the hand",),
    ("scene", "phone", "--environment", "{}", "--object-pose", "{}", "--motion", "1", "0", "0", *HAND): (
        "the surroundings",
    ),
    ("scene", "phone", "--depth", "{}", "--motion", "1", "0", "0", *HAND): ("the images",),
    ("sample", "phone", "--scene", "{}", *HAND, "--out", "out"): ("the scene",),
    ("sample", "phone", "--method", "{}", *HAND, "--out", "out"): ("the method",),
    ("sample", "phone", "--criterion", "{}", *HAND, "--out", "out"): ("the criterion",),
    ("sample", "phone", "--term", "{}", *HAND, "--out", "out"): ("the term",),
    ("sample", "phone", "--uncertain", "{}", *HAND, "--out", "out"): ("what is uncertain",),
    ("check", "{}"): ("the folder",),
    ("execute", "{}", "--out", "out"): ("the folder",),
    ("plan", "{}", "--out", "out"): ("the folder",),
    ("hand", "{}"): ("the hand",),
    ("arm", "{}"): ("the arm",),
    ("dataset", "info", "{}"): ("the folder",),
    ("dataset", "check", "{}"): ("the folder",),
    ("evaluate", "--objects", "{}", "--out", "out"): ("the set",),
    ("train", "--data", "{}", "--out", "out"): ("the data",),
    ("{}",): ("the command",),
}


def case(name: str, arguments: tuple[str, ...], expected: Any = "either", says: str = "") -> Hostile:
    """Return the case of a command with these arguments."""
    files = data() if arguments[0] == "train" else {}
    if arguments[0] in ("evaluate", "dataset") and "--objects" in arguments and "--workers" not in " ".join(arguments):
        arguments = (*arguments, "--workers=1")  # in the process that is looked at, not in two more
    return Hostile("options", name, files, arguments, expected, says)


def _draw(rng: random.Random) -> Hostile:
    if rng.random() < 0.4:
        command = rng.choice([*PATHS_OF])
        value = rng.choice((*PATHS, *NAMES, *NUMBERS))
        return case(f"{PATHS_OF[command][0]}: {value[:40]}", tuple(each.replace("{}", value) for each in command))
    command = rng.choice((SCENE, SAMPLE, EVALUATE, GENERATE, tuple(TRAIN)))
    option = rng.choice(NUMBERS_OF.get(command, TRAIN_NUMBERS))
    value = rng.choice((*BIG, *NUMBERS))
    return case(f"{command[0]} {option} {value[:40]}", (*command, f"{option}={value}"))


def handmade() -> list[Hostile]:
    """Return the cases made by hand."""
    refused = [
        *((SAMPLE, "--seed", value) for value in ("18446744073709551616", "9" * 400, "-1", "1.5", "")),
        *((SAMPLE, "--num", value) for value in ("1000000000", "0", "-1", "1e9")),
        *((SAMPLE, "--friction-hand", value) for value in ("1e300", "nan", "inf", "-1")),
        *((SCENE, "--mass", value) for value in ("1e300", "nan", "0", "-1")),
        *((SCENE, "--turn", value) for value in ("1e300", "nan", "inf")),
        *((tuple(TRAIN), option, value) for option, value in (("--num-heads", "0"), ("--width", "0"), ("--width", "1000000000"),
          ("--depth", "100000"), ("--depth", "0"), ("--groups", "0"), ("--groups", "1000000000"), ("--rows-per-group", "1000000000"),
          ("--num-points", "1000000000"), ("--learning-rate", "nan"), ("--learning-rate", "-1"), ("--weight-decay", "inf"),
          ("--gradient-clip", "nan"), ("--ema-decay", "2"), ("--snr-limit", "nan"), ("--warmup-steps", "-1"),
          ("--num-threads", "1000000000"), ("--clean-limit", "nan"), ("--min-direction-margin", "nan"))),
        *((EVALUATE, option, value) for option, value in (("--num", "1000000000"), ("--workers", "0"), ("--workers", "1000000000"),
          ("--seed", "18446744073709551616"), ("--max-objects", "0"))),
        *((GENERATE, option, value) for option, value in (("--grasps", "-1"), ("--upright", "nan"),
          ("--non-prehensile", "1000000000000"))),
    ]  # fmt: skip
    numbers = [
        case(f"{command[0]} {option} {value[:30]}", (*command, f"{option}={value}"), "refused")
        for command, option, value in refused
    ]
    numbers += [
        case(f"idle: {' '.join(words)}", (*command, *words), "refused", "does nothing")
        for command, words in (
            (SAMPLE, ("--method", "random_start_projection", "--weights", "x")),
            (SAMPLE, ("--method", "unguided", "--projection-report")),
            (EVALUATE, ("--method", "random_start_projection", "--weights", "x")),
            (EVALUATE, ("--scan", "--depth-views", "2", "--noise-mm", "1")),
            (("execute", "x"), ("--then-grasp", "--workers", "3")),
        )
    ]
    paths = [
        case(f"{what[0]} {command[0]}: {path[:30]}", tuple(each.replace("{}", path) for each in command))
        for command, what in PATHS_OF.items()
        for path in ("", "a" * 300, "x\0y", "/dev/zero", "\udcff")
    ]
    return [*numbers, *paths]


HANDMADE = handmade()
DRAWS: dict[str, Draw] = {"options": _draw}
