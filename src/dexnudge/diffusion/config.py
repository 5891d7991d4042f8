"""The numbers that define a model and its training. Free of torch, so that `dexnudge train --help` answers at once."""

import math
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, get_args

from dexnudge.errors import CheckpointError, InputError, UnknownNameError, check_seed, quote

PredictionType = Literal["epsilon", "sample", "v_prediction"]
ScheduleName = Literal["cosine", "linear"]
TokenLayout = Literal["digits", "single", "scalars"]
LossWeighting = Literal["uniform", "min_snr", "velocity"]
Precision = Literal["float32", "bfloat16"]

JointGroups = tuple[tuple[int, ...], ...]  # joint indices of each digit
Tokens = tuple[tuple[int, ...], ...]  # indices into x of each token
FIRST_JOINT = 9  # in q, after translation (3) and rotation (6)


def token_parts(layout: TokenLayout, joint_groups: JointGroups) -> Tokens:
    """Return the indices into x of each token; together they hold each of the 9 + d entries exactly once."""
    joints = (tuple(FIRST_JOINT + joint for joint in group) for group in joint_groups)
    digits = ((0, 1, 2), (3, 4, 5, 6, 7, 8), *joints)
    entries = tuple(index for token in digits for index in token)
    return {"digits": digits, "single": (entries,), "scalars": tuple((index,) for index in entries)}[layout]


# Far above what trains on a workstation. A damaged or hostile config.json is refused before it takes memory or time.
_SIZES = {
    "width": (1, 4096),
    "depth": (1, 64),
    "num_heads": (1, 64),
    "mlp_ratio": (1, 16),
    "feature_width": (1, 4096),
    "num_train_timesteps": (2, 100_000),
}
_MOST_PARAMETERS = 500_000_000  # of the transformer: 2 GB of float32
_CHOICES = {
    "schedule": ("noise schedule", ScheduleName),
    "prediction_type": ("prediction type", PredictionType),
    "token_layout": ("token layout", TokenLayout),
}


@dataclass(frozen=True, kw_only=True)
class Architecture:
    """The network's shape and the noise schedule that it is trained with."""

    width: int = 128
    """Channels of the transformer."""
    depth: int = 6
    """Blocks of the transformer."""
    num_heads: int = 4
    """Attention heads."""
    mlp_ratio: int = 4
    """Width of a block's hidden layer over that of the transformer."""
    encoder_widths: tuple[int, ...] = (64, 128, 256)
    """Channels of PointNet's per-point layers."""
    feature_width: int = 256
    """Channels of the pooled object feature."""
    schedule: ScheduleName = "cosine"
    """Noise schedule."""
    num_train_timesteps: int = 1000
    """Steps of the noise schedule."""
    prediction_type: PredictionType = "v_prediction"
    """What the network predicts."""
    zero_terminal_snr: bool | None = None
    """Whether the last step is pure noise; unless given True, but for epsilon, where it cannot be."""
    clean_limit: float = 6.0
    """Limit of the clean estimate's entries [standard deviations]."""
    token_layout: TokenLayout = "digits"  # noqa: S105 - a transformer's tokens, no secret
    """One token a digit, one for all, or one a coordinate."""

    def __post_init__(self) -> None:
        for name in _CHOICES:
            check_choice(name, getattr(self, name))
        if self.zero_terminal_snr is None:
            object.__setattr__(self, "zero_terminal_snr", self.prediction_type != "epsilon")
        for name, (least, most) in _SIZES.items():
            _check_size(name, getattr(self, name), least, most)
        if not self.encoder_widths:
            raise InputError("`encoder_widths` is empty; expected at least one layer.")
        for width in self.encoder_widths:
            _check_size("encoder_widths", width, *_SIZES["width"])
        parameters = self.width**2 * (self.depth * (10 + 2 * self.mlp_ratio) + 2)
        if parameters > _MOST_PARAMETERS:
            raise InputError(
                f"`width` {self.width} and `depth` {self.depth} make {parameters:,} parameters; "
                f"expected at most {_MOST_PARAMETERS:,}."
            )
        if self.width % self.num_heads:
            raise InputError(
                f"`width` {self.width} is not a multiple of `num_heads` {self.num_heads}; choose one that is."
            )
        if not 0.0 < self.clean_limit < math.inf:
            raise InputError(f"`clean_limit` is {self.clean_limit}; expected more than 0.")
        if self.zero_terminal_snr and self.prediction_type == "epsilon":
            raise InputError(
                "zero_terminal_snr cannot be used with epsilon prediction: x_0 is undefined where x_t is pure noise; "
                "set zero_terminal_snr=False or predict 'sample' or 'v_prediction'."
            )


def check_choice(name: str, value: object) -> None:
    """Raise UnknownNameError unless `value` is one that the setting `name` of an architecture can have."""
    what, kind = _CHOICES[name]
    if value not in get_args(kind):
        raise UnknownNameError(f"unknown {what} {value!r}; expected one of {', '.join(get_args(kind))}.")


def _check_size(name: str, value: object, least: int, most: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
        raise InputError(f"`{name}` is {value!r}; expected a whole number from {least} to {most}.")


CONFIG_VERSION = 2  # raised whenever a weight changes its meaning or is new
SLIDES_ONLY = 1  # version of models from before objects could turn: without the columns for the angular part
JOINT_GROUPS_KEY = "digit_joints"  # in model files, which are older than the name in the code


@dataclass(frozen=True, kw_only=True)
class ModelConfig:
    """The hand that a model is made for, and the model's shape.

    joint_names: (d) in the order of q; joint_groups: joint indices of each digit, one token a digit.
    """

    hand: str
    joint_names: tuple[str, ...]
    joint_groups: JointGroups
    architecture: Architecture = field(default_factory=Architecture)

    def __post_init__(self) -> None:
        owned = sorted(joint for joints in self.joint_groups for joint in joints)
        if owned != list(range(len(self.joint_names))):
            raise CheckpointError(
                f"joint_groups {self.joint_groups} do not cover each of the {len(self.joint_names)} joints exactly once; "
                "give every joint to one digit."
            )

    @property
    def dimension(self) -> int:
        """Length 9 + d of q."""
        return FIRST_JOINT + len(self.joint_names)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, with the version that `from_dict` expects."""
        values = asdict(self)
        return {"config_version": CONFIG_VERSION, JOINT_GROUPS_KEY: values.pop("joint_groups"), **values}

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> "ModelConfig":
        """Return the config that `to_dict` wrote.

        Raises:
            CheckpointError: another version, unexpected fields, or sizes that no model has.
        """
        values = dict(content)
        version = values.pop("config_version", None)
        if version not in (SLIDES_ONLY, CONFIG_VERSION):
            raise CheckpointError(
                f"model config has version {version!r}, expected {SLIDES_ONLY} or {CONFIG_VERSION}; "
                "train the model again with this version of dexnudge."
            )
        try:
            shape = dict(values["architecture"])
            shape["encoder_widths"] = tuple(shape["encoder_widths"])
            values["architecture"] = Architecture(**shape)
            values["joint_names"] = tuple(values["joint_names"])
            values["joint_groups"] = tuple(tuple(joints) for joints in values.pop(JOINT_GROUPS_KEY))
            return cls(**values)
        except InputError as error:
            raise CheckpointError(f"model config cannot be used: {error} Copy the model again.") from error
        except (KeyError, TypeError, ValueError) as error:
            raise CheckpointError(
                f"model config has missing or unexpected fields ({error}); train the model again."
            ) from error


DEFAULT_STEPS = 20_000
# May differ between a run and its continuation: they do not change the weights of a run that ends by its steps.
_BUDGET_FIELDS = ("max_minutes", "checkpoint_every", "validate_every", "log_every", "num_threads")
_LARGEST = 1e30  # of numbers that only have to stay finite in single precision
_LIMITS: dict[str, tuple[float, float]] = {
    **dict.fromkeys(("steps", "validate_every", "checkpoint_every", "log_every"), (1, 10**9)),
    **dict.fromkeys(("groups", "rows_per_group"), (1, 4096)),
    "num_points": (1, 1024),  # as many as a dataset holds of an object
    "num_threads": (1, 1024),
    "warmup_steps": (0, 10**9),
    "max_minutes": (1e-6, 10**7),
    **dict.fromkeys(("learning_rate", "gradient_clip", "snr_limit"), (1e-30, _LARGEST)),
    **dict.fromkeys(
        (
            "ema_decay",
            "grasp_fraction",
            "behaviour_balance",
            "unconditional_fraction",
            "direction_dropout",
            "turn_fraction",
            "behaviour_dropout",
        ),
        (0, 1),
    ),
    "weight_decay": (0, _LARGEST),
    "min_direction_margin": (-1, 3),  # force margins are no larger
    "yaw_jitter": (0, math.pi),
    "point_noise": (0, 1),
    "scale_jitter": (0, 0.99),
}
_MOST_ROWS = 2**18  # configurations in a batch, some GB of memory


@dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """Settings of `train`. A batch has `groups` x `rows_per_group` configurations.

    A group is one object turned to frame C with one motion; its surface is encoded once.
    """

    steps: int | None = None
    """Optimiser steps of the whole run; unless given as many as `max_minutes` allows, or 20000."""
    max_minutes: float | None = None
    """Time limit over all continuations [min]; a run that stops for time is not reproducible bit by bit."""
    groups: int = 16
    """Objects, each with one motion, in a batch."""
    rows_per_group: int = 16
    """Configurations of each of them."""
    learning_rate: float = 1e-3
    """Peak learning rate; it follows half a cosine over the steps."""
    warmup_steps: int = 500
    """Steps over which the learning rate rises."""
    weight_decay: float = 0.01
    """Weight decay of AdamW."""
    gradient_clip: float = 1.0
    """Largest norm of the gradient."""
    ema_decay: float = 0.999
    """Decay of the averaged weights, which are the model."""
    grasp_fraction: float = 0.25
    """Share of groups that are grasps; 1 trains the grasp-only baseline."""
    behaviour_balance: float = 0.5
    """0 draws rows evenly, 1 draws push, press and hook equally often."""
    unconditional_fraction: float = 0.1
    """Share of groups that lose class and motion."""
    direction_dropout: float = 0.1
    """Share of groups that lose the motion."""
    turn_fraction: float = 0.3
    """Share of the groups that move an object which turn or tip it, where the dataset says which hands can."""
    behaviour_dropout: float = 0.1
    """Share of groups that lose the class."""
    min_direction_margin: float = 1.0
    """Force margin from which a configuration counts as able to move the object."""
    yaw_jitter: float = 0.0873
    """Largest error of the motion's direction [rad]."""
    point_noise: float = 5e-4
    """Standard deviation of the error of surface points [m]."""
    scale_jitter: float = 0.01
    """Largest relative error of the object's size, as of a mesh that was measured wrong; hands keep their size."""
    num_points: int = 256
    """Surface points of a group, drawn anew each time."""
    loss_weighting: LossWeighting = "uniform"
    """Weight of the loss over noise levels."""
    snr_limit: float = 5.0
    """Limit of the signal-to-noise ratio in weights other than uniform."""
    validate_every: int = 1000
    """Steps between validations on held-out objects."""
    checkpoint_every: int = 1000
    """Steps between saved states."""
    log_every: int = 50
    """Steps between lines of the log."""
    start_from: str | None = None
    """Hand whose shipped weights the run starts from, or a model folder of any hand; from nothing unless given."""
    seed: int = 0
    """Seed of weights, noise and batches."""
    num_threads: int | None = None
    """Threads of torch; as many as there are cores unless given."""
    device: Literal["cpu", "cuda"] = "cpu"
    """cuda takes one GPU for each process."""
    precision: Precision = "float32"
    """bfloat16 is slower on processors without units for matrices in it, such as AMX."""
    architecture: Architecture = field(default_factory=Architecture)

    def __post_init__(self) -> None:
        for name, (least, most) in _LIMITS.items():
            value = getattr(self, name)
            if value is not None and not least <= value <= most:
                raise InputError(f"`{name}` is {quote(value)}; expected a number from {least:g} to {most:g}.")
        check_seed(self.seed)
        if self.groups * self.rows_per_group > _MOST_ROWS:
            raise InputError(
                f"`groups` {self.groups} and `rows_per_group` {self.rows_per_group} make "
                f"{self.groups * self.rows_per_group:,} configurations; expected at most {_MOST_ROWS:,}."
            )

    def identity(self) -> dict[str, object]:
        """Return the settings that a continuation must share with the run that it continues."""
        return {name: value for name, value in asdict(self).items() if name not in _BUDGET_FIELDS}
