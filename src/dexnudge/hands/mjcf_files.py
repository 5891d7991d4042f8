"""An MJCF file compiled by MuJoCo, once nothing in it opens other files or asks for much."""

import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from xml.etree.ElementTree import Element

import mujoco
import numpy as np

from dexnudge.errors import HandError
from dexnudge.hands.link_meshes import allowing, description_folders
from dexnudge.hands.tree import MAX_LINKS, MAX_SHAPES
from dexnudge.hands.xml_text import read_xml

FOLDER_ATTRIBUTES = ("meshdir", "texturedir", "assetdir")
NO_HAND_HAS = ("hfield", "flexcomp", "composite", "flex")  # and a few letters of them can ask for gigabytes
MAX_COPIES = 100  # of a `replicate`
MAX_SIZE = 10_000  # of what <size> sets aside for each joint, body or state
MAX_SIZES = {"memory": 2.0**30, "nstack": 1e8, "njmax": 1e6, "nconmax": 1e6}  # [bytes], and counts
MAX_PIXELS = 4096  # a side of a texture
MIN_MASS, MIN_INERTIA = 1e-3, 1e-8  # [kg], [kg m^2] of bodies that have none; only kinematics are read


def compiled_model(path: Path, packages: Mapping[str, Path | str], notes: list[str] | None = None) -> mujoco.MjModel:
    """Return MuJoCo's model of an MJCF file, with other masses and a note where it refuses those of the file.

    Raises:
        HandError: the file names files elsewhere, asks for too much, or MuJoCo cannot compile it.
    """
    _check_files(path, packages)
    with _quiet():
        return _compiled(path, notes)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep MuJoCo from writing warnings to stderr and to MUJOCO_LOG.TXT in the current folder, and from raising them."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        mujoco.set_mju_user_warning(before)


def _compiled(path: Path, notes: list[str] | None) -> mujoco.MjModel:
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError) as error:
        fault = " ".join(str(error).split())
    try:
        if "inertia" in fault:
            spec = mujoco.MjSpec.from_file(str(path))
            spec.compiler.boundmass, spec.compiler.boundinertia = MIN_MASS, MIN_INERTIA
            spec.compiler.balanceinertia = 1
            spec.compiler.inertiafromgeom = int(mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE)
            model = spec.compile()
            if notes is not None:
                notes.append(f"masses of the geometry take the place of the file's, which MuJoCo refuses: {fault}")
            return model
    except (ValueError, mujoco.FatalError) as error:
        fault = " ".join(str(error).split())
    raise HandError(f"{path}: MuJoCo cannot compile it: expected a valid MJCF model, got '{fault}'; mend the file")


def _check_files(path: Path, packages: Mapping[str, Path | str]) -> None:
    """Refuse entities, and files outside the main file's folders, in an MJCF file and all that it includes."""
    home = path.parent.resolve()
    roots = [*description_folders(home), *(Path(place).resolve() for place in packages.values())]
    waiting, checked, folders = [path.resolve()], set(), {home}
    attached: set[Path] = set()
    bodies = shapes = 0
    while waiting:
        file = waiting.pop()
        checked.add(file)
        root = read_xml(file, root_tag="mujoco" if file == path.resolve() else None)
        bodies, shapes = (bodies + _copies(root, "body"), shapes + _copies(root, "geom"))
        if bodies > MAX_LINKS or shapes > MAX_SHAPES:
            raise HandError(
                f"{path}: expected at most {MAX_LINKS:,} bodies and {MAX_SHAPES:,} geoms, found {bodies:,} and {shapes:,}; "
                "leave the hand alone in the file"
            )
        for element in root.iter("compiler"):
            folders |= {place / element.get(key, "") for key in FOLDER_ATTRIBUTES for place in (home, file.parent)}
        folders.add(file.parent)
        for element in root.iter():
            _refuse_excess(element, file)
            if element.tag == "model" or (element.tag == "include" and file in attached):
                attached.add((home / element.get("file", "")).resolve())
            if (element.tag == "model" and file in attached) or path.resolve() in attached:
                raise HandError(f"{file}: <model> in a model that is itself attached: expected one level; copy it in")
            named = (
                value for key, value in element.attrib.items() if key.startswith("file") or key in FOLDER_ATTRIBUTES
            )
            for value in filter(None, named):
                places = [(folder / value).resolve() for folder in folders]
                if not all(any(place.is_relative_to(allowed) for allowed in roots) for place in places):
                    raise HandError(
                        f"{file}: '{value}' lies outside the description's folder: expected a file below {home}; "
                        f"copy the files beside the description and name them relative to it{allowing(home, places)}"
                    )
                if element.tag in ("include", "model") and (home / value).resolve() not in checked:
                    waiting.append((home / value).resolve())


def _copies(root: Element, tag: str) -> int:
    """Return how many elements of this tag a file has, with the copies of each `replicate`."""
    count = sum(1 for _ in root.iter(tag))
    for element in root.iter("replicate"):
        count += int(min(_number(element.get("count")), MAX_COPIES)) * sum(1 for _ in element.iter(tag))
    return count


def _refuse_excess(element: Element, file: Path) -> None:
    """Refuse what a hand does not have and what a few letters can make huge."""
    too_much = element.tag in NO_HAND_HAS
    if element.tag == "replicate":
        too_much = element.find(".//replicate") is not None or _number(element.get("count")) > MAX_COPIES
    elif element.tag == "worldbody":
        too_much = len(element.findall(".//attach")) > MAX_COPIES
    elif element.tag in ("texture", "mesh"):
        sides = (element.get(key) for key in ("width", "height", *(("params",) if element.tag == "mesh" else ())))
        too_much = any(_number(word) > MAX_PIXELS for side in sides if side for word in side.split())
    elif element.tag == "size":
        too_much = any(_size(value) > MAX_SIZES.get(key, MAX_SIZE) for key, value in element.attrib.items())
    limits = element.get("range", "").split()
    if element.tag == "joint" and len(limits) == 2 and _number(limits[0]) > _number(limits[1]):
        raise HandError(
            f"{file}: joint '{element.get('name', element.tag)}': expected lower limit <= upper limit in 'range', got "
            f"'{element.get('range')}'; swap or mend them"
        )
    odd = [key for key, value in element.attrib.items() if key not in ("name", "class") and _not_finite(value)]
    if odd:
        raise HandError(
            f"{file}: <{element.tag}>: expected finite numbers in '{odd[0]}', got '{element.attrib[odd[0]][:100]}'; mend it"
        )
    if too_much:
        raise HandError(
            f"{file}: <{element.tag} {' '.join(f'{key}={value!r}' for key, value in element.attrib.items())[:100]}>: "
            f"expected what a robot consists of: no {', '.join(NO_HAND_HAS)}, no nested or more than {MAX_COPIES} copies, "
            f"textures of at most {MAX_PIXELS} pixels a side, sizes of at most {MAX_SIZE:,}; remove it"
        )


def _not_finite(text: str) -> bool:
    """Whether all words are numbers, and one of them NaN or infinite."""
    try:
        return not np.isfinite([float(word) for word in re.sub(r"(?i)nan\([^)]*\)", "nan", text).split()]).all()
    except ValueError:
        return False


def _size(text: str) -> float:
    """Return a number that may end in K, M, G, T, P or E, as bytes do."""
    word = text.strip().upper()
    return _number(word.rstrip("KMGTPE")) * 1024.0 ** (
        1 + "KMGTPE".find(word[-1:]) if word[-1:] in "KMGTPE" and word else 0
    )


def _number(text: str | None) -> float:
    try:
        return float(text or 0)
    except ValueError:
        return 0.0  # MuJoCo refuses it
