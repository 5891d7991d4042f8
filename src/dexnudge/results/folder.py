"""The folder of a result: scene and hand first, then what was drawn, as verified from those files.

configurations.npz holds every draw, verified ones first, best first; read it with `numpy.load(allow_pickle=False)`:

    q              (n, 9 + d) float32, world frame
    joint_names    (d,), in the order of q
    success        (n,) bool
    reasons        (n,) name of the first criterion that fails; "" for a success
    contact_links  (n,) names of the hand links that touch the object, joined by ","; a backslash stands before a comma or
                   a backslash that is part of a name
    NAME           (n,) what the criterion of that name measured
    probability      (n,) that a verified draw holds in physics; NaN for others
    share_of_worlds  (n,) see `Samples.foresight`; only where something is uncertain

summary.json counts them, and tells what failing each criterion means and what the run took. criteria/NAME holds what a
criterion needs beside its name, such as the arm of `reach`.
"""

import json
import re
import time
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError, check_path, is_name, quote
from dexnudge.geometry.devices import own_modes
from dexnudge.geometry.rigid import FARTHEST
from dexnudge.hands.export import HAND_FILES, export_hand
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.archives import read_arrays
from dexnudge.jobs.folders import new_folder
from dexnudge.jobs.json_files import MAX_TABLE_BYTES, read_json_object
from dexnudge.jobs.processes import trim_memory
from dexnudge.jobs.provenance import machine, peak_memory_mb, versions
from dexnudge.planning.reach import Reach
from dexnudge.plugins import attribute, call_foreign, load_plugin, plugin_title
from dexnudge.results.samples import Samples
from dexnudge.scenes.files import SCENE_FILES
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import (
    FORESIGHT,
    RESERVED,
    Criterion,
    check_criteria,
    find_criterion,
    missing_criteria,
)
from dexnudge.verification.verdicts import Verdicts, contacts_of, verify

CONFIGURATIONS, SUMMARY = "configurations.npz", "summary.json"
HAND = Path("hand", "hand.urdf")
PAGE, PICTURE = "view.html", "view.png"
CRITERIA = "criteria"
OURS: dict[str, Any] = {Reach.name: Reach}
"""Criteria of this package that need more than a name."""
RESULT_FILES = (
    *SCENE_FILES,
    *(f"{HAND.parent}/{file}" for file in HAND_FILES),
    f"{CRITERIA}/*/*",
    SUMMARY,
    PAGE,
    PICTURE,
)
"""What a result folder consists of beside configurations.npz, as patterns of paths."""
BLOCKED = "motion_not_blocked"
LONGEST_QUOTE = 200  # characters of a file's content in a message
KINDS = {"f": "float", "U": "text", "b": "bool"}
"""How messages call the kinds of arrays."""


def result_folder(out: Path | str, *, overwrite: bool) -> AbstractContextManager[Path]:
    """Own `out` and yield an empty folder that becomes it; `overwrite` replaces a result there (see `new_folder`)."""
    return new_folder(out, overwrite=overwrite, marker=CONFIGURATIONS, ours=RESULT_FILES)


def write_inputs(folder: Path, scene: Scene, hand: Hand) -> tuple[Scene, Hand]:
    """Write scene and hand into `folder` and return them as read back.

    What is read back is what draws are verified with: then the verdicts are those of the files, rounding included, and
    `check` finds the same.
    """
    scene.save(folder)
    export_hand(hand, folder / HAND.parent)
    return read_inputs(folder)


def read_inputs(folder: Path) -> tuple[Scene, Hand]:
    """Return scene and hand of a result folder.

    Raises:
        InputError: a file is missing, damaged, or points outside the folder.
    """
    return Scene.load(folder), load_hand(str(folder / HAND))


def write_configurations(
    folder: Path, q: Float[np.ndarray, "n coordinates"], joint_names: Sequence[str], verdicts: Verdicts
) -> None:
    """Write configurations.npz."""
    links = [",".join(re.sub(r"([\\,])", r"\\\1", link) for link in each) for each in verdicts.contact_links]
    arrays: dict[str, Any] = {
        "q": q.astype(np.float32),
        "joint_names": np.array(joint_names, dtype=np.str_),
        "success": verdicts.success,
        "reasons": np.array(verdicts.reasons, dtype=np.str_),
        "contact_links": np.array(links, dtype=np.str_),
        **verdicts.values,
        **verdicts.foresight,
    }
    np.savez_compressed(folder / CONFIGURATIONS, **arrays)


def read_configurations(folder: Path) -> tuple[Float[np.ndarray, "n coordinates"], tuple[str, ...], Verdicts]:
    """Return q, joint names, and the verdicts without contacts and criteria.

    Raises:
        InputError: the file is missing, damaged, or its arrays do not fit together; the message says which.
    """
    path = folder / CONFIGURATIONS
    arrays = read_arrays(
        path,
        folder="the folder that `dexnudge sample` or Samples.save wrote",
        content="an npz archive without pickles; sample again",
    )
    missing = [*(key for key in RESERVED if key not in arrays), *missing_criteria(arrays)]
    if missing:
        raise InputError(
            f"{path} lacks {', '.join(missing)}; expected {', '.join(RESERVED)} and the values of all built-in criteria, "
            "which dexnudge 0.6 and before did not write; sample again"
        )
    values = {key: array for key, array in arrays.items() if key not in (*RESERVED, *FORESIGHT)}
    foresight = {key: arrays[key] for key in FORESIGHT if key in arrays}
    q = arrays["q"]
    expected: dict[str, tuple[str, tuple[object, ...]]] = {
        "q": ("f", q.shape if q.ndim == 2 else ("n", "9 + d")),
        "joint_names": ("U", (q.shape[-1] - ROOT_COORDINATES,)),
        "success": ("b", (len(q),)),
        **dict.fromkeys(("reasons", "contact_links"), ("U", (len(q),))),
        **dict.fromkeys((*values, *foresight), ("f", (len(q),))),
    }
    for key, (kind, shape) in expected.items():
        array = arrays[key]
        if array.dtype.kind != kind or array.shape != shape:
            raise InputError(
                f"{path}: {key} is {array.dtype} of shape {array.shape}; expected {KINDS[kind]} of shape "
                f"({', '.join(map(str, shape))}); sample again"
            )
    if not len(q):
        raise InputError(f"{path} holds no configurations; expected at least one; sample again")
    if not (np.abs(q) <= FARTHEST).all():
        raise InputError(
            f"{path}: q holds NaN, infinity or a number above {FARTHEST:g}; expected metres and radians; sample again"
        )
    names = [re.findall(r"(?:\\.|[^\\,])+", links, re.DOTALL) for links in arrays["contact_links"].tolist()]
    verdicts = Verdicts(
        success=arrays["success"],
        reasons=arrays["reasons"].tolist(),
        values=values,
        contacts=[],
        contact_links=[[re.sub(r"\\(.)", r"\1", name, flags=re.DOTALL) for name in each] for each in names],
        foresight=foresight,
    )
    return q, tuple(arrays["joint_names"].tolist()), verdicts


def count_draws(verdicts: Verdicts) -> dict[str, Any]:
    """Return counts and rates of all draws: drawn = verified + the sum of `rejected` (reason -> draws)."""
    drawn, verified, robust = len(verdicts), int(verdicts.success.sum()), int(verdicts.robust.sum())
    return {
        "drawn": drawn,
        "verified": verified,
        "robust": robust,
        "rejected": verdicts.rejections(),
        "verified_rate": verified / drawn,
        "robust_rate": robust / drawn,
        "best_force_margin": float(verdicts.force_margin[0]) if verified else None,
    }


def nothing_verified(summary: dict[str, Any]) -> str:
    """One sentence for a summary without verified draws; `rejected` stands in order, most frequent first.

    A blocked motion is a property of the scene, so one draw that got as far as to fail for it speaks for all.
    """
    rejected, reasons = summary["rejected"], summary["reasons"]
    reason, count = next(iter(rejected.items()))
    said = f"none of {summary['drawn']} draws is verified; {count} of them fail '{reason}'"
    if sentence := reasons[reason].strip():  # a criterion of somebody's own may have none
        said += f": {sentence}"
    if reason != BLOCKED and BLOCKED in rejected:
        return f"{said}; and {reasons[BLOCKED]}"
    return said


def write_summary(folder: Path, summary: dict[str, Any]) -> None:
    """Write summary.json."""
    text = json.dumps(summary, indent=2, allow_nan=False, default=lambda array: array.tolist())
    (folder / SUMMARY).write_text(text + "\n", encoding="utf-8")


def write_results(
    folder: Path, samples: Samples, *, title: str, seconds: dict[str, float], details: dict[str, Any]
) -> dict[str, Any]:
    """Write configurations, page, picture and summary beside scene and hand; return the summary.

    Args:
        folder: where `write_inputs` wrote.
        samples: verified with the scene and the hand that `write_inputs` returned.
        title: plain text above page and picture.
        seconds: of the stages before the first draw; those of drawing and writing are added.
        details: further entries of the summary, such as the options of the run.
    """
    write_configurations(folder, samples.q, samples.hand.joint_names, samples.verdicts)
    write_criteria(folder, samples.verdicts.criteria, samples.hand)
    start = time.perf_counter()
    samples.page(folder / PAGE, title=title)
    trim_memory()
    samples.picture(folder / PICTURE)
    seconds = {**seconds, **samples.seconds, "picture": time.perf_counter() - start}
    summary = {
        **count_draws(samples.verdicts),
        "best_foresight": samples[0].calibrated if samples.num_verified else {},
        "reasons": {reason: samples.verdicts.sentences[reason] for reason in samples.rejections()},
        "criteria": list(samples.verdicts.values),
        **details,
        "seconds": {stage: round(value, 4) for stage, value in seconds.items()},
        "seconds_total": round(sum(seconds.values()), 4),
        "peak_memory_mb": round(peak_memory_mb(), 1),
        "machine": machine(),
        "versions": versions(),
        "sampler": list(samples.reports),
    }
    write_summary(folder, summary)
    return summary


def save_samples(samples: Samples, out: Path, *, title: str, overwrite: bool) -> Samples:
    """Write the folder of `Samples.save`; return the samples as written."""
    if not len(samples):
        raise InputError("there are no samples to save; expected at least one")
    criteria = samples.verdicts.criteria_again()
    with result_folder(out, overwrite=overwrite) as folder:
        scene, hand = write_inputs(folder, samples.scene, samples.hand)
        q = samples.q.astype(np.float32)  # as the file holds it
        verdicts = verify(scene, hand, q, criteria)
        written = replace(samples, scene=scene, hand=hand, q=q, verdicts=verdicts).best_first()
        title = title or f"{hand.name}, {scene.name}"
        write_results(folder, written, title=title, seconds={}, details={"scene": scene.name, "hand": hand.name})
    return written


@own_modes()
def load_samples(folder: Path | str) -> Samples:
    """Read a result folder that `dexnudge sample` or `Samples.save` wrote; nothing is verified again (see `check`).

    Raises:
        InputError: a file is missing, damaged, or does not belong to the others.
    """
    samples = read_result(folder)[0]
    contacts = contacts_of(samples.scene, samples.hand, samples.q)
    return replace(samples, verdicts=replace(samples.verdicts, contacts=contacts))


def subject(folder: Path, samples: Samples) -> str:
    """Return what the samples of a folder are of: the object as `dexnudge sample` named it, else the hand; and the scene."""
    name = _read_summary(folder).get("object")
    return f"{name if is_name(name) else samples.hand.name}, {samples.scene.name}"


def read_result(folder: Path | str) -> tuple[Samples, dict[str, Any], dict[str, str]]:
    """Return the samples of a folder without their contacts, its summary, and why each missing criterion is missing.

    Raises:
        InputError: a file is missing, damaged, or does not belong to the others.
    """
    check_path("folder", folder)
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; expected the one that `dexnudge sample` or Samples.save wrote")
    q, joint_names, verdicts = read_configurations(folder)
    summary = _read_summary(folder)
    scene, hand = read_inputs(folder)
    if tuple(hand.joint_names) != joint_names:
        raise InputError(
            f"{folder}: the configurations have the joints {', '.join(joint_names)}, the hand in hand/ has "
            f"{', '.join(hand.joint_names)}; expected the same joints in the same order; sample again"
        )
    names, nameless = summary.get("criteria"), [name for name in verdicts.values if not _is_criterion(name)]
    if not isinstance(names, list) or sorted(map(str, names)) != sorted(verdicts.values) or nameless:
        raise InputError(
            f"{folder}: summary.json lists the criteria {quote(names)}, configurations.npz has the values of "
            f"{quote(nameless or [*verdicts.values])}; expected the same, with names that a folder can have; sample again"
        )
    criteria: list[Criterion] = []
    missing: dict[str, str] = {}
    for name in verdicts.values:
        try:
            criteria.append(read_criterion(folder, name))
        except InputError as error:
            if name in OURS:
                raise
            missing[name] = str(error)
    verdicts = replace(verdicts, criteria=tuple(criteria), sentences=dict(summary.get("reasons", {})))
    seconds, reports = dict(summary.get("seconds", {})), tuple(summary.get("sampler", ()))
    return Samples(scene, hand, q, verdicts, seconds=seconds, reports=reports), summary, missing


def _is_criterion(name: str) -> bool:
    return is_name(name) and Path(name).name == name and "\\" not in name


def _read_summary(folder: Path) -> dict[str, Any]:
    path = folder / SUMMARY
    expected = "the folder that `dexnudge sample` or Samples.save wrote"
    summary = read_json_object(path, error=InputError, expected=expected, again="sample again", largest=MAX_TABLE_BYTES)
    if not isinstance(summary.get("rejected"), dict):
        raise InputError(f"{path} has no counts; expected drawn, verified and rejected; sample again")
    for key, kind in (("reasons", dict), ("seconds", dict), ("sampler", list)):
        if not isinstance(summary.get(key, kind()), kind):
            what = "an object" if kind is dict else "a list"
            raise InputError(f"{path}: {key} is {str(summary[key])[:LONGEST_QUOTE]}; expected {what}; sample again")
    return summary


def write_criteria(folder: Path, criteria: Iterable[Criterion], hand: Hand) -> None:
    """Have each criterion that has parameters save them."""
    for criterion in criteria:
        save = attribute(f"criterion '{criterion.name}'", criterion, "save")
        if save is not None:
            own = folder / CRITERIA / criterion.name
            own.mkdir(parents=True, exist_ok=True)
            call_foreign(f"criterion '{criterion.name}' cannot be saved", save, own, hand)


def read_criterion(folder: Path, name: str) -> Criterion:
    """Return the criterion of that name: from its own folder where it has one, else by its name alone.

    Raises:
        UnknownNameError: no such criterion.
        InputError: its files are missing or damaged.
    """
    own = folder / CRITERIA / name
    if name in OURS:
        return OURS[name].load(own)
    if not own.is_dir():
        return find_criterion(name)
    kind = load_plugin("criterion", name)
    what = plugin_title("criterion", name)
    load = attribute(what, kind, "load")
    if load is None:
        raise InputError(f"{what} has no `load`; expected the class whose `save` wrote {own}; install that version")
    found = call_foreign(f"{what} cannot be read from {own}", load, own)
    check_criteria([found])
    return found
