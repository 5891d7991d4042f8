"""The verdict on hand configurations: every criterion, one after another."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from dexnudge.errors import InputError, check_kind
from dexnudge.geometry.devices import check_device, own_modes
from dexnudge.hands.batch import HandBatch
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import (
    ROBUST_MARGIN,
    VALID_POSE,
    BuiltinCriterion,
    Criterion,
    check_criteria,
    judge,
    missing_criteria,
)
from dexnudge.verification.measurements import measure


@dataclass(frozen=True, eq=False, repr=False)
class Verdicts:
    """What was found about each of n configurations.

    Attributes:
        success: every criterion passes.
        reasons: name of the first criterion that fails; "" for a success.
        values: what each criterion measured, by its name, in the order of judging. A configuration that fails
            `valid_pose` has no others: its force margin and contacts are 0, the rest NaN.
        contacts: with the object, one for each configuration; none for one without a pose.
        contact_links: names of the links in contact with the object.
        sentences: what a failure means, by the name of each criterion that some configuration fails.
        criteria: what judged, in this order.
        foresight: what is predicted of them beside the values, by name; see `Samples.foresight`.
    """

    success: Bool[np.ndarray, " n"]
    reasons: list[str]
    values: dict[str, Float[np.ndarray, " n"]]
    contacts: list[HandContacts]
    contact_links: list[list[str]]
    sentences: dict[str, str] = field(default_factory=dict)
    criteria: tuple[Criterion, ...] = ()
    foresight: dict[str, Float[np.ndarray, " n"]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.success)

    def __repr__(self) -> str:
        rejected = ", ".join(f"{count} {reason}" for reason, count in self.rejections().items())
        return f"Verdicts on {len(self)} configurations: {int(self.success.sum())} verified; rejected: {rejected or 'none'}"

    @property
    def penetration_object(self) -> Float[np.ndarray, " n"]:
        """Greatest depth of hand and object in each other [m], 0 if none."""
        return self._value("penetration_object")

    @property
    def penetration_environment(self) -> Float[np.ndarray, " n"]:
        """Greatest depth of hand and surroundings in each other [m], 0 if none."""
        return self._value("penetration_environment")

    @property
    def penetration_self(self) -> Float[np.ndarray, " n"]:
        """Greatest depth of the hand's links in each other [m], 0 if none."""
        return self._value("penetration_self")

    @property
    def deepest_penetration(self) -> Float[np.ndarray, " n"]:
        """The greatest of the three depths [m]."""
        return np.maximum.reduce([self.penetration_object, self.penetration_environment, self.penetration_self])

    @property
    def force_margin(self) -> Float[np.ndarray, " n"]:
        """Largest factor in [0, 3] on friction_environment at which forces balance."""
        return self._value("force_margin")

    @property
    def robust(self) -> Bool[np.ndarray, " n"]:
        """Which succeed with a force margin of at least 1.5."""
        return self.success & (self.force_margin >= ROBUST_MARGIN)

    def rejections(self) -> dict[str, int]:
        """Return the number of rejected configurations by reason, most frequent first."""
        return dict(Counter(reason for reason in self.reasons if reason).most_common())

    def criteria_again(self, *, but: object = None) -> list[Criterion]:
        """Return the criteria that judged, to judge again, without the one of the name `but`.

        Raises:
            InputError: a built-in one was left out, or one is not at hand that the values are from.
        """
        at_hand = {criterion.name: criterion for criterion in self.criteria if criterion.name != but}
        missing = missing_criteria(at_hand) + [name for name in self.values if name not in (*at_hand, but)]
        if missing:
            raise InputError(
                f"the samples cannot be verified again by {', '.join(missing)}; expected all built-in criteria, and those "
                "of your own installed; verify them again by criteria that are at hand"
            )
        return list(at_hand.values())

    def take(self, rows: slice | Int[np.ndarray, " m"] | Bool[np.ndarray, " n"]) -> Verdicts:
        """Return the verdicts at the given places, in that order."""
        places = np.arange(len(self))[rows]
        return Verdicts(
            success=self.success[places],
            reasons=[self.reasons[i] for i in places],
            values={name: value[places] for name, value in self.values.items()},
            contacts=[self.contacts[i] for i in places],
            contact_links=[self.contact_links[i] for i in places],
            sentences=self.sentences,
            criteria=self.criteria,
            foresight={name: value[places] for name, value in self.foresight.items()},
        )

    @classmethod
    def concatenate(cls, parts: Sequence[Verdicts]) -> Verdicts:
        """Return the verdicts of several batches, found by the same criteria, as those of one."""
        return cls(
            success=np.concatenate([part.success for part in parts]),
            reasons=list(chain.from_iterable(part.reasons for part in parts)),
            values={name: np.concatenate([part.values[name] for part in parts]) for name in parts[0].values},
            contacts=list(chain.from_iterable(part.contacts for part in parts)),
            contact_links=list(chain.from_iterable(part.contact_links for part in parts)),
            sentences={name: sentence for part in parts for name, sentence in part.sentences.items()},
            criteria=parts[0].criteria,
        )

    def _value(self, name: str) -> Float[np.ndarray, " n"]:
        if name not in self.values:
            raise InputError(f"nothing was measured of `{name}`; expected its criterion among {', '.join(self.values)}")
        return self.values[name]


@own_modes()
def verify(
    scene: Scene,
    hand: Hand,
    q: Float[np.ndarray, "n coordinates"] | Float[Tensor, "n coordinates"],
    criteria: Sequence[Criterion] | None = None,
    *,
    device: str = "cpu",
) -> Verdicts:
    """Return the verdicts on configurations q (n, 9 + d) of the hand in the world.

    Args:
        scene: the problem.
        hand: what is configured.
        q: [root translation (3) [m] | 6D rotation (6) | joint angles (d) [rad]], world frame.
        criteria: what a configuration must meet to succeed; `default_criteria()` if left out. Add your own to those:
            `[*default_criteria(), MyCriterion()]`. Whatever they are, a configuration must be a pose.
        device: where kinematics, distances and force balances are computed, and the criteria find the hands.

    Raises:
        InputError: an argument of another class, q that is not of shape (n, 9 + d), or a criterion that fails or returns
            what does not fit.
    """
    return verify_in([scene], hand, q, criteria, device=device)[0]


def verify_in(
    scenes: Sequence[Scene],
    hand: Hand,
    q: Float[np.ndarray, "n coordinates"] | Float[Tensor, "n coordinates"],
    criteria: Sequence[Criterion] | None = None,
    *,
    device: str = "cpu",
) -> list[Verdicts]:
    """Return the verdicts on the same configurations in each of several scenes; see `verify`.

    Where scenes share their surroundings, as those of a displaced object do, depths in these are measured once.
    """
    for scene in scenes:
        check_kind("scene", scene, Scene, 'build_scene("table", "phone")')
    check_kind("hand", hand, Hand, 'load_hand("shadow_lite")')
    q, device = _checked(hand, q), check_device(device)
    chosen, every = check_criteria(criteria), HandBatch(hand, torch.from_numpy(q).to(device), dense=True)
    if not scenes:
        return []
    valid = judge(VALID_POSE, every, scenes[0])[1]
    posed = every if valid.all() else HandBatch(hand, torch.from_numpy(q[valid]).to(device), dense=True)
    return [_verdicts(scene, every, posed, chosen) for scene in scenes]


def _verdicts(scene: Scene, every: HandBatch, posed: HandBatch, criteria: Sequence[Criterion]) -> Verdicts:
    """Return the verdicts on every hand, of which those with valid poses are judged further."""
    error, valid, sentence = judge(VALID_POSE, every, scene)
    values, passed = {VALID_POSE.name: error}, {VALID_POSE.name: valid}
    sentences = {} if valid.all() else {VALID_POSE.name: sentence}
    for criterion in criteria[1:]:
        name = criterion.name
        without_pose = criterion.value_without_pose if isinstance(criterion, BuiltinCriterion) else np.nan
        values[name] = np.full(len(every), without_pose)
        passed[name] = np.zeros(len(every), dtype=bool)
        if not len(posed):
            continue
        values[name][valid], passed[name][valid], sentence = judge(criterion, posed, scene)
        if not passed[name][valid].all():
            sentences[name] = sentence
    contacts, links = _contacts(posed, scene, valid)
    reasons = [next((name for name, ok in passed.items() if not ok[row]), "") for row in range(len(every))]
    return Verdicts(
        success=np.array([not reason for reason in reasons], dtype=bool),
        reasons=reasons,
        values=values,
        contacts=contacts,
        contact_links=links,
        sentences=sentences,
        criteria=tuple(criteria),
    )


def contacts_of(scene: Scene, hand: Hand, q: Float[np.ndarray, "n coordinates"]) -> list[HandContacts]:
    """Return each configuration's contacts with the object; none for one without a pose.

    Raises:
        InputError: q is not of shape (n, 9 + d).
    """
    q = _checked(hand, q)
    valid = judge(VALID_POSE, HandBatch(hand, torch.from_numpy(q)), scene)[1]
    return _contacts(HandBatch(hand, torch.from_numpy(q[valid])), scene, valid)[0]


def _checked(hand: Hand, q: object) -> Float[np.ndarray, "n coordinates"]:
    try:
        if isinstance(q, Tensor):
            q = q.detach().cpu().resolve_conj().resolve_neg()
            q = q.double() if q.is_floating_point() else q
        array = np.asarray(q)
    except (ValueError, TypeError, NotImplementedError) as error:  # ragged rows, and tensors that are sparse or meta
        raise InputError(f"`q` cannot be read as an array ({error}); expected numbers, a row for each hand") from error
    coordinates = ROOT_COORDINATES + len(hand.joint_names)
    if array.ndim != 2 or array.shape[1] != coordinates or array.dtype.kind not in "fiu":
        raise InputError(
            f"`q` is {array.dtype} of shape {array.shape}; hand '{hand.name}' expects numbers of shape (n, {coordinates}): "
            f"translation (3), 6D rotation (6), {len(hand.joint_names)} joint angles"
        )
    return array.astype(np.float64)


def _contacts(
    hands: HandBatch, scene: Scene, valid: Bool[np.ndarray, " n"]
) -> tuple[list[HandContacts], list[list[str]]]:
    """Return contacts and their links of all n configurations, from those that have poses."""
    nothing = HandContacts(points=np.zeros((0, 3)), normals=np.zeros((0, 3)), link=np.zeros(0, dtype=np.int64))
    found = measure(hands, scene)
    contacts, links = iter(found.contacts), iter(found.contact_links)
    return [next(contacts) if ok else nothing for ok in valid], [next(links) if ok else [] for ok in valid]
