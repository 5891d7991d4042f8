"""configurations.npz: every draw with its verdict, verified ones first, best first."""

import json
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from dexnudge.errors import InputError
from dexnudge.verification.criteria import RESERVED, ROBUST_MARGIN, missing_criteria

FILE = "configurations.npz"
ROOT_COORDINATES = 9  # translation (3) and 6D rotation (6) stand before the joint angles in q


@dataclass(frozen=True)
class Configurations:
    """All draws of one result, in ranked order.

    Attributes:
        q: [root translation (3) [m] | first two columns of R (6) | joint angles (d) [rad]], world frame.
        joint_names: the d joints in the order of q.
        success: every criterion passes.
        reasons: name of the first criterion that fails; "" for a success.
        values: what each criterion measured, by its name; each is an array of the file.
        contact_links: hand links within contact distance of the object, for each draw; in the file a JSON list each.
    """

    q: Float[np.ndarray, "n coordinates"]
    joint_names: tuple[str, ...]
    success: Bool[np.ndarray, " n"]
    reasons: tuple[str, ...]
    values: dict[str, Float[np.ndarray, " n"]]
    contact_links: tuple[tuple[str, ...], ...]

    @property
    def robust(self) -> Bool[np.ndarray, " n"]:
        """Which succeed with a force margin of at least 1.5."""
        return self.success & (self.values["force_margin"] >= ROBUST_MARGIN)

    def save(self, folder: Path) -> None:
        """Write `FILE` into `folder`; readable with `numpy.load(allow_pickle=False)`."""
        arrays: dict[str, Any] = {
            "q": self.q.astype(np.float32),
            "joint_names": np.array(self.joint_names, dtype=np.str_),
            "success": self.success.astype(bool),
            "reasons": np.array(self.reasons, dtype=np.str_),
            "contact_links": np.array([json.dumps(links) for links in self.contact_links], dtype=np.str_),
            **self.values,
        }
        np.savez_compressed(folder / FILE, **arrays)


def load_configurations(folder: Path) -> Configurations:
    """Read `FILE` from `folder`.

    Raises:
        InputError: the file is missing, damaged, or its arrays do not fit together; the message says which.
    """
    path = folder / FILE
    if not path.is_file():
        raise InputError(f"{path} is missing; expected the folder that `dexnudge sample` or Samples.save wrote")
    try:
        with path.open("rb") as file, np.lib.npyio.NpzFile(file, allow_pickle=False) as archive:  # never a bare .npy
            arrays = {key: archive[key] for key in archive.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(
            f"{path} is damaged ({error}); expected an npz archive without pickles; sample again"
        ) from error
    missing = [*(key for key in RESERVED if key not in arrays), *missing_criteria(arrays)]
    if missing:
        raise InputError(
            f"{path} lacks {', '.join(missing)}; expected {', '.join(RESERVED)} and the values of all built-in criteria; "
            "sample again"
        )
    values = {key: array for key, array in arrays.items() if key not in RESERVED}
    _check_arrays(path, arrays, values)
    return Configurations(
        q=arrays["q"],
        joint_names=tuple(arrays["joint_names"].tolist()),
        success=arrays["success"],
        reasons=tuple(arrays["reasons"].tolist()),
        values=values,
        contact_links=tuple(_links(path, text) for text in arrays["contact_links"].tolist()),
    )


def _links(path: Path, text: str) -> tuple[str, ...]:
    try:
        links = json.loads(text)
    except ValueError:
        links = None
    if not isinstance(links, list) or not all(isinstance(link, str) for link in links):
        raise InputError(f"{path}: contact_links holds {text!r}; expected a JSON list of link names; sample again")
    return tuple(links)


def _check_arrays(path: Path, arrays: dict[str, np.ndarray], values: dict[str, np.ndarray]) -> None:
    q, joints = arrays["q"], arrays["joint_names"]
    _expect(path, "q", q, "f", q.shape if q.ndim == 2 else ("n", "9 + d"))
    _expect(path, "joint_names", joints, "U", (q.shape[1] - ROOT_COORDINATES,))
    if not np.isfinite(q).all():
        raise InputError(f"{path}: q holds NaN or infinity; expected finite numbers; sample again")
    for key, kind in (("success", "b"), ("reasons", "U"), ("contact_links", "U"), *((key, "f") for key in values)):
        _expect(path, key, arrays[key], kind, (len(q),))


def _expect(path: Path, key: str, array: np.ndarray, kind: str, shape: Sequence[int | str]) -> None:
    if array.dtype.kind != kind or array.shape != tuple(shape):
        name = {"f": "float", "U": "text", "b": "bool"}[kind]
        raise InputError(
            f"{path}: {key} is {array.dtype} of shape {array.shape}; expected {name} of shape "
            f"({', '.join(map(str, shape))}); sample again"
        )
