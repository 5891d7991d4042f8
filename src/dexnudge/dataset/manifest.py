"""The dataset's manifest: which hand, which objects, which settings; `manifest.json`."""

import json
import os
import re
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from dexnudge.dataset.schema import FORMAT_VERSION
from dexnudge.errors import DatasetError, check_path
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.atomic_files import replace_atomically
from dexnudge.jobs.json_files import MAX_TABLE_BYTES, from_fields, read_json_object

MANIFEST_NAME = "manifest.json"
UNITS = {"length": "m", "angle": "rad"}
JOINT_GROUPS_KEY = "digit_joints"  # in the file, which is older than the name in the code
ABOVE = f"..{os.sep}"  # begins the path of a hand that lies above its dataset
_OBJECT_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.\-]*")


AGAIN = (
    "the shards beside it are not lost: `dexnudge dataset generate` with the options that made them, which README.md there "
    "names, writes it anew from them"
)


class DamagedManifestError(DatasetError):
    """A manifest that is missing or cannot be read: generating the dataset again makes it anew from its shards."""


@dataclass(kw_only=True)
class Manifest:
    """What a dataset folder holds.

    hand: its name; joint_names: (d) in the order of q; joint_groups: digit name -> indices into joint_names;
    sliding_joints: those of joint_names whose entries in q are in metres; in the file only where there are some;
    objects: object name -> sha256 of the mesh it was generated from, None before it is known; failed_objects: object
    name -> reason, none of them in `objects`; config, seed, versions: what generated it; counts: behaviour -> totals
    over all shards, filled in when generation ends.
    """

    hand: str
    joint_names: tuple[str, ...]
    joint_groups: dict[str, tuple[int, ...]]
    objects: dict[str, str | None]
    sliding_joints: tuple[str, ...] = ()
    failed_objects: dict[str, str] = field(default_factory=dict)
    config: dict[str, object] = field(default_factory=dict)
    seed: int = 0
    versions: dict[str, str] = field(default_factory=dict)
    counts: dict[str, dict[str, object]] = field(default_factory=dict)

    @property
    def sliding(self) -> Bool[np.ndarray, " joint"]:
        """Which joints slide."""
        return np.isin(np.array(self.joint_names, dtype=str), self.sliding_joints)

    def load_hand(self, folder: Path | str) -> Hand:
        """Return the hand that the dataset in `folder` was generated for; raises HandError or UnknownNameError."""
        hand = str(self.config.get("hand", self.hand))
        beside = Path(folder) / hand
        return load_hand(beside if hand.startswith(ABOVE) and beside.is_file() else hand)


def recorded_hand(hand: str, loaded: Hand, folder: Path) -> str:
    """Return how the dataset in `folder` records its hand: as it was given, or relative to `folder` where it can move along.

    It moves along where its file lies in a folder above, as in a prepared hand's folder with its data below.
    """
    file = loaded.source and loaded.source.resolve()
    if file is None or file.parent not in folder.resolve().parents:
        return hand
    return os.path.relpath(file, folder.resolve())


def is_object_name(name: str) -> bool:
    """Return whether `name` can be part of a file name inside the dataset folder."""
    return _OBJECT_NAME.fullmatch(name) is not None


def check_object_name(name: str) -> str:
    """Return `name` if it can be part of a file name inside the dataset folder; else raise DatasetError."""
    if not is_object_name(name):
        raise DatasetError(
            f"object name {name!r} cannot be part of a file name; expected letters, digits, '_', '-' and '.', "
            "starting with a letter or digit; rename the object."
        )
    return name


def write_manifest(folder: Path | str, manifest: Manifest) -> Path:
    """Write `manifest.json` atomically and return its path; equal manifests give equal bytes, in whatever order filled."""
    for name in (*manifest.objects, *manifest.failed_objects):
        check_object_name(name)
    path = Path(folder) / MANIFEST_NAME
    fields = {JOINT_GROUPS_KEY if key == "joint_groups" else key: value for key, value in asdict(manifest).items()}
    if not manifest.sliding_joints:  # as it was before joints could slide
        del fields["sliding_joints"]
    content = {"format_version": FORMAT_VERSION, "units": UNITS, **fields}
    content |= {key: dict(sorted(content[key].items())) for key in ("objects", "failed_objects", "versions", "counts")}
    with replace_atomically(path) as temporary:
        temporary.write_text(json.dumps(content, indent=2, default=str) + "\n", encoding="utf-8")
    return path


def read_manifest(folder: Path | str) -> Manifest:
    """Read `manifest.json`; raises DatasetError when it is missing, broken, or of another version or unit."""
    check_path("folder", folder, DatasetError)
    path = Path(folder) / MANIFEST_NAME
    if path.is_dir():
        raise DatasetError(f"{path} is a folder; expected a file; move the folder away")
    expected = f"a dataset folder with a {MANIFEST_NAME}; make one with `dexnudge dataset generate` or correct the path"
    content = read_json_object(
        path, error=DamagedManifestError, expected=expected, again=AGAIN, largest=MAX_TABLE_BYTES
    )
    if content.get("format_version") != FORMAT_VERSION:
        raise DatasetError(
            f"{path} has format version {content.get('format_version')!r}, expected {FORMAT_VERSION}; "
            "generate the dataset again with this version of dexnudge."
        )
    if content.get("units") != UNITS:
        raise DatasetError(f"{path} has units {content.get('units')!r}, expected {UNITS}; convert the dataset.")
    given = {key: value for key, value in content.items() if key not in ("format_version", "units")}
    if JOINT_GROUPS_KEY in given:
        given["joint_groups"] = given.pop(JOINT_GROUPS_KEY)
    manifest = from_fields(given, Manifest, str(path), error=DamagedManifestError, again=AGAIN)
    for name in (*manifest.objects, *manifest.failed_objects):
        check_object_name(name)
    owned = [joint for group in manifest.joint_groups.values() for joint in group]
    names = manifest.joint_names
    if len({*names}) < len(names) or len({*owned}) < len(owned) or not {*owned} <= {*range(len(names))}:
        raise DamagedManifestError(
            f"{path}: joint_names or {JOINT_GROUPS_KEY} name a joint twice, or one that there is not; expected each joint "
            f"in one digit at most; {AGAIN}"
        )
    return manifest


def joint_groups(hand: Hand) -> dict[str, tuple[int, ...]]:
    """Return digit name -> indices into `hand.joint_names`, from the palm outwards.

    A digit owns the joints between its fingertip and the palm; a joint that several digits share goes to the first of
    them, so that every joint has one digit, and a jaw that follows another none. Joints that lead to no fingertip, such
    as a wrist's, come last as "wrist".
    """
    owned: set[int] = set()
    groups: dict[str, tuple[int, ...]] = {}
    for digit, fingertip in hand.fingertips.items():
        joints: list[int] = []
        link = hand.link_names.index(fingertip)
        while link > 0:
            joint = hand.joints[link]
            if joint is not None and joint.index is not None and joint.index not in owned:
                owned.add(joint.index)
                joints.append(joint.index)
            link = int(hand.link_parent[link])
        groups[digit] = tuple(reversed(joints))
    others = tuple(index for index in range(len(hand.joint_names)) if index not in owned)
    if others:
        groups["wrist"] = others
    return groups
