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
import math
import re
import sys
import time
import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError, check_path, is_name, quote
from dexnudge.hands.export import HAND_FILES, export_hand
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.folders import new_folder
from dexnudge.jobs.json_files import read_json_object
from dexnudge.jobs.provenance import machine, peak_memory_mb, versions
from dexnudge.results.criterion_files import FILES as CRITERION_FILES
from dexnudge.results.criterion_files import OURS, read_criterion, write_criteria
from dexnudge.results.samples import Samples
from dexnudge.scenes.files import SCENE_FILES
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import FORESIGHT, RESERVED, Criterion, missing_criteria
from dexnudge.verification.verdicts import Verdicts, contacts_of, verify

CONFIGURATIONS, SUMMARY = "configurations.npz", "summary.json"
HAND = Path("hand", "hand.urdf")
PAGE, PICTURE = "view.html", "view.png"
RESULT_FILES = (
    *SCENE_FILES,
    *(f"{HAND.parent}/{file}" for file in HAND_FILES),
    *CRITERION_FILES,
    SUMMARY,
    PAGE,
    PICTURE,
)
"""What a result folder consists of beside configurations.npz, as patterns of paths."""
BLOCKED = "motion_not_blocked"
LARGEST_FILE = 2**30
"""Of configurations.npz, unpacked [bytes]: some million draws; more is no result."""
LONGEST_QUOTE = 200  # characters of a file's content in a message
NPY_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
DAMAGE = (
    OSError,
    ValueError,
    EOFError,
    zipfile.BadZipFile,
    zlib.error,
    RuntimeError,  # an unknown compression, a password, or a header with too many brackets
    MemoryError,  # the same, and no lack of memory
    SyntaxError,
    tokenize.TokenError,
)
"""What reading an archive that numpy.savez did not write may raise."""
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
    if not np.isfinite(q).all():
        raise InputError(f"{path}: q holds NaN or infinity; expected finite numbers; sample again")
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


def read_arrays(path: Path, *, folder: str, content: str) -> dict[str, np.ndarray]:
    """Return the arrays of an npz archive; no more is read into memory than its table of contents and headers allow.

    folder, content: what messages expect where the file is missing, and in it.

    Raises:
        InputError: the file is missing or damaged; an entry is no array, is there twice, or is larger than a result can be.
    """
    if not path.is_file():
        raise InputError(f"{path} is missing; expected {folder}")
    try:
        return _read_arrays(path)
    except InputError:
        raise
    except DAMAGE as error:
        raise InputError(f"{path} is damaged ({error}); expected {content}") from error


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {}
    with zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
        size = sum(entry.file_size for entry in entries)
        if size > LARGEST_FILE:
            raise InputError(
                f"{path} unpacks to {size / 2**20:.0f} MiB; expected at most {LARGEST_FILE >> 20} MiB; sample again"
            )
        for entry in entries:
            key, shown = entry.filename.removesuffix(".npy"), repr(entry.filename[:LONGEST_QUOTE])
            if key in arrays:
                raise InputError(f"{path} holds {shown} twice; expected one array of each name; sample again")
            if key == entry.filename:
                raise InputError(f"{path} holds {shown}, which is no array; expected arrays only; sample again")
            arrays[key] = read_array(archive, entry)
    return arrays


def read_array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    """Return the array of an entry; ValueError where its header announces anything but what follows."""
    with archive.open(entry) as file:
        read_header = NPY_HEADERS.get(np.lib.format.read_magic(file))
        if read_header is None:
            raise ValueError("an array is written in an unknown version of the npy format")
        shape, _, dtype = read_header(file)
        if dtype.hasobject:
            raise ValueError("an array holds pickled objects")
        announced, size = math.prod(shape) * dtype.itemsize, entry.file_size - file.tell()
        if not dtype.itemsize or announced != size:
            raise ValueError(f"the header of an array announces {announced} bytes, and {size} follow")
        file.seek(0)
        array: np.ndarray = np.lib.format.read_array(file, allow_pickle=False)
    if dtype.kind == "U":
        codes = array.reshape(-1).view(np.dtype(np.uint32).newbyteorder(dtype.byteorder))
        if codes.max(initial=0) > sys.maxunicode:
            raise ValueError("a text holds what is no character")
    return array


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
    samples.picture(folder / PICTURE)
    seconds = {**seconds, **samples.seconds, "picture": time.perf_counter() - start}
    summary = {
        **count_draws(samples.verdicts),
        "best_foresight": samples[0].foresight if samples.num_verified else {},
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


def load_samples(folder: Path | str) -> Samples:
    """Read a result folder that `dexnudge sample` or `Samples.save` wrote; nothing is verified again (see `check`).

    Raises:
        InputError: a file is missing, damaged, or does not belong to the others.
    """
    samples = read_result(folder)[0]
    contacts = contacts_of(samples.scene, samples.hand, samples.q)
    return replace(samples, verdicts=replace(samples.verdicts, contacts=contacts))


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
    summary = read_json_object(path, error=InputError, expected=expected, again="sample again")
    if not isinstance(summary.get("rejected"), dict):
        raise InputError(f"{path} has no counts; expected drawn, verified and rejected; sample again")
    for key, kind in (("reasons", dict), ("seconds", dict), ("sampler", list)):
        if not isinstance(summary.get(key, kind()), kind):
            what = "an object" if kind is dict else "a list"
            raise InputError(f"{path}: {key} is {str(summary[key])[:LONGEST_QUOTE]}; expected {what}; sample again")
    return summary
