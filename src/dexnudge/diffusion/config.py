"""The numbers that define a model; `config.json` of a model folder."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Literal

from dexnudge.diffusion.schedule import NoiseSchedule, PredictionType, ScheduleName
from dexnudge.errors import CheckpointError, UnknownNameError

TokenLayout = Literal["digits", "single", "scalars"]
Digits = tuple[tuple[int, ...], ...]  # joint indices of each digit
Parts = tuple[tuple[int, ...], ...]  # indices into x of each token

TRANSLATION, ROTATION = (0, 1, 2), (3, 4, 5, 6, 7, 8)
FIRST_JOINT = 9


def _digits(joint_groups: Digits) -> Parts:
    return (TRANSLATION, ROTATION, *(tuple(FIRST_JOINT + joint for joint in digit) for digit in joint_groups))


def _single(joint_groups: Digits) -> Parts:
    return (tuple(index for part in _digits(joint_groups) for index in part),)


def _scalars(joint_groups: Digits) -> Parts:
    return tuple((index,) for part in _digits(joint_groups) for index in part)


LAYOUTS: dict[str, Callable[[Digits], Parts]] = {"digits": _digits, "single": _single, "scalars": _scalars}


def token_parts(layout: str, joint_groups: Digits) -> Parts:
    """Indices into x of each token; together they hold each of the 9 + d entries exactly once.

    Raises UnknownNameError for a layout that is not in the table.
    """
    if layout not in LAYOUTS:
        raise UnknownNameError(f"unknown token layout {layout!r}; expected one of {', '.join(LAYOUTS)}.")
    return LAYOUTS[layout](joint_groups)


CONFIG_VERSION = 1  # raised whenever a weight changes its meaning
JOINT_GROUPS_KEY = "digit_joints"  # in model files, which are older than the name in the code


@dataclass(frozen=True, kw_only=True)
class Architecture:
    """The network's shape and the noise schedule it is trained with.

    width, depth, num_heads, mlp_ratio: of the transformer; encoder_widths: of PointNet's per-point layers;
    feature_width: of the pooled object feature; clean_limit: |x_0 estimate| is clamped to it, in standard deviations;
    token_layout: see `token_layout.py`; zero_terminal_snr: None follows the prediction type, which epsilon forbids.
    Configs written before `token_layout` was a choice lack it and mean its default.
    """

    width: int = 128
    depth: int = 6
    num_heads: int = 4
    mlp_ratio: int = 4
    encoder_widths: tuple[int, ...] = (64, 128, 256)
    feature_width: int = 256
    schedule: ScheduleName = "cosine"
    num_train_timesteps: int = 1000
    prediction_type: PredictionType = "v_prediction"
    zero_terminal_snr: bool | None = None
    clean_limit: float = 6.0
    token_layout: TokenLayout = "digits"  # noqa: S105 - a transformer's tokens, no secret

    def __post_init__(self) -> None:
        if self.zero_terminal_snr is None:
            object.__setattr__(self, "zero_terminal_snr", self.prediction_type != "epsilon")
        if self.width % self.num_heads:
            raise CheckpointError(
                f"width {self.width} is not a multiple of num_heads {self.num_heads}; choose one that is."
            )
        self.noise_schedule()  # refuses a combination that cannot be trained before anything is made

    def noise_schedule(self) -> NoiseSchedule:
        """The schedule that the model was, or will be, trained with."""
        return NoiseSchedule(
            self.schedule,
            num_train_timesteps=self.num_train_timesteps,
            prediction_type=self.prediction_type,
            zero_terminal_snr=bool(self.zero_terminal_snr),
        )


@dataclass(frozen=True, kw_only=True)
class ModelConfig:
    """The hand that a model is made for, and the model's shape.

    joint_names: (d) in the order of q; joint_groups: joint indices of each digit, one token a digit.
    """

    hand: str
    joint_names: tuple[str, ...]
    joint_groups: tuple[tuple[int, ...], ...]
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
        return 9 + len(self.joint_names)

    def to_dict(self) -> dict[str, object]:
        """As plain values, with the version that `from_dict` expects."""
        values = asdict(self)
        return {"config_version": CONFIG_VERSION, JOINT_GROUPS_KEY: values.pop("joint_groups"), **values}

    @classmethod
    def from_dict(cls, content: dict[str, object]) -> "ModelConfig":
        """The inverse of `to_dict`; raises CheckpointError for another version or unexpected fields."""
        values = dict(content)
        version = values.pop("config_version", None)
        if version != CONFIG_VERSION:
            raise CheckpointError(
                f"model config has version {version!r}, expected {CONFIG_VERSION}; "
                "train the model again with this version of dexnudge."
            )
        try:
            shape = dict(values["architecture"])  # type: ignore[call-overload]
            shape["encoder_widths"] = tuple(shape["encoder_widths"])
            values["architecture"] = Architecture(**shape)
            values["joint_names"] = tuple(values["joint_names"])  # type: ignore[arg-type]
            joint_groups = values.pop(JOINT_GROUPS_KEY)
            values["joint_groups"] = tuple(tuple(joints) for joints in joint_groups)  # type: ignore[attr-defined]
            return cls(**values)  # type: ignore[arg-type]
        except (KeyError, TypeError) as error:
            raise CheckpointError(
                f"model config has missing or unexpected fields ({error}); train the model again."
            ) from error
