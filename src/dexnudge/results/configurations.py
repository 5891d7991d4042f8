"""configurations.npz: every draw with its verdict, verified ones first, best first."""

import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from dexnudge.errors import InputError
from dexnudge.verification.verdicts import ROBUST_MARGIN

FILE = "configurations.npz"
LINK_SEPARATOR = ","  # between the names of one draw's contact links
ROOT_COORDINATES = 9  # translation (3) and 6D rotation (6) stand before the joint angles in q


@dataclass(frozen=True)
class Configurations:
    """All draws of one result, in ranked order.

    Attributes:
        q: [root translation (3) [m] | first two columns of R (6) | joint angles (d) [rad]], world frame.
        joint_names: the d joints in the order of q.
        success: every criterion passes.
        reasons: name of the first criterion that fails; "" for a success.
        penetration_object, penetration_environment, penetration_self: depth [m], 0 where nothing penetrates.
        force_margin: largest factor on friction_environment that the contacts still overcome, at most 3.
        contact_links: hand links within contact distance of the object, for each draw.
    """

    q: Float[np.ndarray, "n coordinates"]
    joint_names: tuple[str, ...]
    success: Bool[np.ndarray, " n"]
    reasons: tuple[str, ...]
    penetration_object: Float[np.ndarray, " n"]
    penetration_environment: Float[np.ndarray, " n"]
    penetration_self: Float[np.ndarray, " n"]
    force_margin: Float[np.ndarray, " n"]
    contact_links: tuple[tuple[str, ...], ...]

    @property
    def robust(self) -> Bool[np.ndarray, " n"]:
        """Which succeed with a force margin of at least 1.5."""
        return self.success & (self.force_margin >= ROBUST_MARGIN)

    def save(self, folder: Path) -> None:
        """Write `FILE` into `folder`; readable with `numpy.load(allow_pickle=False)`."""
        np.savez_compressed(
            folder / FILE,
            q=self.q.astype(np.float32),
            joint_names=np.array(self.joint_names, dtype=np.str_),
            success=self.success.astype(bool),
            reasons=np.array(self.reasons, dtype=np.str_),
            penetration_object=self.penetration_object,
            penetration_environment=self.penetration_environment,
            penetration_self=self.penetration_self,
            force_margin=self.force_margin,
            contact_links=np.array([LINK_SEPARATOR.join(links) for links in self.contact_links], dtype=np.str_),
        )


KEYS = tuple(Configurations.__dataclass_fields__)
MEASURES = ("penetration_object", "penetration_environment", "penetration_self", "force_margin")


def load_configurations(folder: Path) -> Configurations:
    """Read `FILE` from `folder`.

    Raises:
        InputError: the file is missing, damaged, or its arrays do not fit together; the message says which.
    """
    path = folder / FILE
    if not path.is_file():
        raise InputError(f"{path} is missing; expected the folder that `dexnudge sample --out` wrote")
    try:
        with path.open("rb") as file, np.lib.npyio.NpzFile(file, allow_pickle=False) as archive:  # never a bare .npy
            arrays = {key: archive[key] for key in archive.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(
            f"{path} is damaged ({error}); expected an npz archive without pickles; sample again"
        ) from error
    missing = [key for key in KEYS if key not in arrays]
    if missing:
        raise InputError(f"{path} lacks {', '.join(missing)}; expected the arrays {', '.join(KEYS)}; sample again")
    _check_arrays(path, arrays)
    return Configurations(
        q=arrays["q"],
        joint_names=tuple(arrays["joint_names"].tolist()),
        success=arrays["success"],
        reasons=tuple(arrays["reasons"].tolist()),
        contact_links=tuple(
            tuple(links.split(LINK_SEPARATOR)) if links else () for links in arrays["contact_links"].tolist()
        ),
        **{key: arrays[key] for key in MEASURES},
    )


def _check_arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    q, joints = arrays["q"], arrays["joint_names"]
    _expect(path, "q", q, "f", q.shape if q.ndim == 2 else ("n", "9 + d"))
    _expect(path, "joint_names", joints, "U", (q.shape[1] - ROOT_COORDINATES,))
    if not np.isfinite(q).all():
        raise InputError(f"{path}: q holds NaN or infinity; expected finite numbers; sample again")
    for key, kind in (("success", "b"), ("reasons", "U"), ("contact_links", "U"), *((key, "f") for key in MEASURES)):
        _expect(path, key, arrays[key], kind, (len(q),))


def _expect(path: Path, key: str, array: np.ndarray, kind: str, shape: Sequence[int | str]) -> None:
    if array.dtype.kind != kind or array.shape != tuple(shape):
        name = {"f": "float", "U": "text", "b": "bool"}[kind]
        raise InputError(
            f"{path}: {key} is {array.dtype} of shape {array.shape}; expected {name} of shape "
            f"({', '.join(map(str, shape))}); sample again"
        )
