"""The draws for a scene with their verdicts: looked at, saved, and read back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, overload

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from dexnudge.arms.arm import Arm
from dexnudge.errors import InputError, check_integer, check_path, quote
from dexnudge.finding import probability_text
from dexnudge.geometry.devices import own_modes
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.plugins import attribute
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import Criterion
from dexnudge.verification.verdicts import Verdicts, verify
from dexnudge.viewer.visual_scene import VisualScene, visual_scenes

PLACES = "an integer, a slice, a mask with an entry for each, or an array of places"
Places = slice | Sequence[int] | Sequence[bool] | Int[np.ndarray, " m"] | Bool[np.ndarray, " n"] | Tensor
NOT_ON_PAGE = ("valid_pose", "joint_limits", "contact", "motion_not_blocked")  # their values say little


@dataclass(frozen=True, eq=False, repr=False)
class Sample:
    """One configuration with the scene and the hand that it belongs to.

    Attributes:
        scene: the scene that it stands in.
        hand: the kind of hand.
        q: [root translation (3) [m] | 6D rotation (6) | joint angles (d) [rad]], world frame.
        success: every criterion passes.
        reason: name of the first criterion that fails; "" for a success.
        values: what each criterion measured, by its name.
        contacts: with the object.
        contact_links: names of the hand links that touch it.
        foresight: what is predicted of it beside those, see `Samples.foresight`.
    """

    scene: Scene
    hand: Hand
    q: Float[np.ndarray, " coordinates"]
    success: bool
    reason: str
    values: dict[str, float]
    contacts: HandContacts
    contact_links: tuple[str, ...]
    foresight: dict[str, float] = field(default_factory=dict)

    @property
    def probability(self) -> float:
        """Probability that it holds in physics, predicted without playing it; NaN where it is not verified.

        It is one for slides of `shadow_lite`; for other hands, and motions that turn or tip, no more than an order.
        """
        return self.foresight.get("probability", np.nan)

    @property
    def calibrated(self) -> dict[str, float]:
        """`foresight` without a probability where that is only an order."""
        from dexnudge.results.probability import calibrated

        return calibrated(self.foresight, self.scene, self.hand)

    @property
    def share_of_worlds(self) -> float:
        """Share in which it is verified of the worlds in which the scene may be found; NaN: not tried, or all is certain."""
        return self.foresight.get("share_of_worlds", np.nan)

    @property
    def force_margin(self) -> float:
        """Largest factor on friction_environment at which forces balance, at most 3."""
        return self.values["force_margin"]

    @property
    def joint_angles(self) -> dict[str, float]:
        """Angle of each joint [rad], by its name."""
        return dict(zip(self.hand.joint_names, self.q[ROOT_COORDINATES:].tolist(), strict=True))

    @property
    def T_world_palm(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the palm in the world."""
        q = torch.from_numpy(self.q[None].astype(np.float64))
        return self.hand.forward_kinematics(q)[0, 0].numpy()

    def __repr__(self) -> str:
        verdict = "verified" if self.success else f"rejected ({self.reason})"
        probability = self.calibrated.get("probability", np.nan)
        verdict += "" if np.isnan(probability) else f", holds in physics with {probability_text(probability)}"
        verdict += "" if np.isnan(self.share_of_worlds) else f" in {self.share_of_worlds:.0%} of the worlds"
        touching = ", ".join(self.contact_links) or "nothing"
        return (
            f"Sample of {self.hand.name} in '{self.scene.name}': {verdict}, force margin "
            f"{self.force_margin:.2f}, touching with {touching}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Samples:
    """Every draw for a scene with its verdict: verified ones first, best first.

    `samples[0]` is the best as a `Sample`; a slice, a mask or an array of places gives `Samples`.

    Attributes:
        scene: the scene that they stand in.
        hand: the kind of hand.
        q: [root translation (3) [m] | 6D rotation (6) | joint angles (d) [rad]], world frame.
        verdicts: what was found about each draw.
        own_rank: the place that the sampler itself gave each draw of a call, before anything was verified; None for
            samples that were read from a folder.
        seconds: by stage.
        reports: the sampler's own, one for each call.
    """

    scene: Scene
    hand: Hand
    q: Float[np.ndarray, "n coordinates"]
    verdicts: Verdicts
    own_rank: Int[np.ndarray, " n"] | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    reports: tuple[dict[str, Any], ...] = ()

    @property
    def success(self) -> Bool[np.ndarray, " n"]:
        """Which draws pass every criterion."""
        return self.verdicts.success

    @property
    def reasons(self) -> list[str]:
        """Name of the first criterion that each draw fails; "" for a success."""
        return self.verdicts.reasons

    @property
    def foresight(self) -> dict[str, Float[np.ndarray, " n"]]:
        """What is predicted of draws beside what the criteria measure, by name; they are ranked by the share alone.

        probability: that a verified draw holds in physics, see `results.probability`; NaN for others.
        share_of_worlds: where something is uncertain (`Scene.uncertainty`), the share of the worlds in which each draw is
        verified; NaN for one that was not tried.
        """
        return self.verdicts.foresight

    @property
    def num_verified(self) -> int:
        """How many draws succeed."""
        return int(self.success.sum())

    @property
    def verified(self) -> Samples:
        """The draws that succeed, best first."""
        return self[self.success]

    def rejections(self) -> dict[str, int]:
        """Return the number of rejected draws by reason, most frequent first."""
        return self.verdicts.rejections()

    @own_modes()
    def rank(self, by: Arm | Criterion, *, mount: Any = None) -> Samples:
        """Return the samples judged by one more criterion and ranked anew: those first that pass every one.

        Args:
            by: the criterion, in place of one of its name; of an arm, where it stands, its `Reach`.
            mount: T_flange_mount, see `Reach`; only with an arm.

        Raises:
            InputError: no criterion, one that fails, or one of before that no installed package brings any more.
        """
        from dexnudge.planning.reach import Reach

        if mount is not None and not isinstance(by, Arm):
            raise InputError("`mount` is given without an arm; expected both or neither; give the criterion its own")
        criterion = Reach(by, mount=mount) if isinstance(by, Arm) else by
        name = attribute(f"a {type(criterion).__name__}", criterion, "name")
        verdicts = verify(self.scene, self.hand, self.q, [*self.verdicts.criteria_again(but=name), criterion])
        return replace(self, verdicts=verdicts, seconds=dict(self.seconds)).best_first()

    def best_first(self) -> Samples:
        """Return the samples ranked anew by their verdicts, with the share of worlds in which they hold."""
        from dexnudge.results.ranking import ranking

        found = ranking(self.scene, self.verdicts, self.hand, self.q)
        return replace(self, verdicts=replace(self.verdicts, foresight=found.foresight))[found.order]

    def __len__(self) -> int:
        return len(self.q)

    def __iter__(self) -> Iterator[Sample]:
        return (self[index] for index in range(len(self)))

    @overload
    def __getitem__(self, key: int | np.integer) -> Sample: ...
    @overload
    def __getitem__(self, key: Places) -> Samples: ...
    def __getitem__(self, key: int | np.integer | Places) -> Sample | Samples:
        key = self._places(key)
        if isinstance(key, int):
            if not -len(self) <= key < len(self):
                raise IndexError(
                    f"place {key} of {len(self)} samples; expected one from {-len(self)} to {len(self) - 1}"
                )
            place = range(len(self))[key]
            return Sample(
                scene=self.scene,
                hand=self.hand,
                q=self.q[place],
                success=bool(self.success[place]),
                reason=self.reasons[place],
                values={name: float(value[place]) for name, value in self.verdicts.values.items()},
                contacts=self.verdicts.contacts[place],
                contact_links=tuple(self.verdicts.contact_links[place]),
                foresight={name: float(value[place]) for name, value in self.foresight.items()},
            )
        places = key
        own_rank = None if self.own_rank is None else self.own_rank[places]
        return replace(
            self, q=self.q[places], verdicts=self.verdicts.take(places), own_rank=own_rank, seconds=dict(self.seconds)
        )

    def _places(self, key: object) -> int | Int[np.ndarray, " m"]:
        """Return one place, or the places that a slice, a mask or an array means; InputError for anything else."""
        every = np.arange(len(self))
        try:
            given = every[key] if isinstance(key, slice) else np.asarray(key)
        except (TypeError, ValueError, RuntimeError) as error:
            raise InputError(f"samples[{quote(key)}]: {error}; expected {PLACES}") from error
        if given.ndim == 0 and given.dtype.kind in "iu":
            return int(given)
        mask = given.dtype.kind == "b" and given.shape == every.shape
        if not mask and (given.ndim != 1 or (given.size and given.dtype.kind not in "iu")):
            raise InputError(f"samples[{quote(key)}] of {len(self)} samples; expected {PLACES}")
        if not mask and given.size and not (-len(self) <= given.min() and given.max() < len(self)):
            raise IndexError(f"samples[{quote(key)}] of {len(self)} samples; expected {PLACES}")
        return every[given if mask else given.astype(np.int64)]

    def __repr__(self) -> str:
        lines = [f"{len(self)} samples of {self.hand.name} in '{self.scene.name}': {self.num_verified} verified"]
        lines += [f"  {count} rejected, first reason: {reason}" for reason, count in self.rejections().items()]
        if self.num_verified:
            lines.append(f"  best: {self[0]!r}")
        return "\n".join(lines)

    @own_modes()
    def save(self, out: Path | str, *, title: str = "", overwrite: bool = False) -> Samples:
        """Write a result folder: scene, hand, configurations, summary, page and picture, as `dexnudge sample` does.

        Every draw is verified again with scene and hand as they stand in the files, rounding included, so that what is
        written is what `check` finds there. Returns the samples as they were written.

        Args:
            out: the folder to make.
            title: above page and picture.
            overwrite: replace an existing result folder; other files in it stay.

        Raises:
            OutputError: `out` exists without `overwrite`, is no result folder, or cannot be written.
            InputError: there are no samples, or a criterion is missing: a built-in one that was left out, or one that no
                installed package brings any more.
        """
        from dexnudge.results.folder import save_samples

        check_path("out", out)

        return save_samples(self, Path(out), title=title, overwrite=overwrite)

    @own_modes()
    def picture(self, path: Path | str, *, index: int = 0) -> Path:
        """Write a PNG of one configuration in its scene, the best one unless told otherwise.

        Raises:
            InputError: no sample at `index`, or a path that does not end in .png.
            OutputError: the file cannot be written.
        """
        from dexnudge.viewer.picture import render_png

        if not len(self):
            raise InputError("there are no samples to show; expected at least one")
        check_integer("index", index, least=-len(self), most=len(self) - 1)
        return render_png(self._visual_scenes[index], path)

    @own_modes()
    def page(self, path: Path | str, *, title: str = "") -> Path:
        """Write a self-contained 3-D page of the configurations, of the first 500 where there are more.

        Raises:
            InputError: there are no samples.
            OutputError: the file cannot be written.
        """
        from dexnudge.results.probability import calibrated
        from dexnudge.viewer.page import Figures, write_page

        values = {name: value for name, value in self.verdicts.values.items() if name not in NOT_ON_PAGE}
        values |= calibrated(self.foresight, self.scene, self.hand)
        found = self.verdicts
        figures = [
            Figures(
                success=bool(found.success[i]),
                values={name: float(value[i]) for name, value in values.items()},
                contact_links=tuple(found.contact_links[i]),
                reason=found.reasons[i],
            )
            for i in range(len(self))
        ]
        title = title or f"{self.hand.name}, {self.scene.name}"
        return write_page(self._visual_scenes, path, title=title, figures=figures)

    @cached_property
    def _visual_scenes(self) -> list[VisualScene]:
        """What page and picture show; made once, and so is the camera that is chosen for each."""
        contacts = [each.points for each in self.verdicts.contacts]
        return visual_scenes(self.scene, self.hand, self.q.astype(np.float64), contacts=contacts)
