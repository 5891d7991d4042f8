"""Results, scenes and executions into the files of other tools, and their grasps into results that are verified here."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError, OutputError, UnknownNameError, did_you_mean
from dexnudge.execution.episode_files import ARRAYS
from dexnudge.formats.bodex import check_object_scale, read_bodex, read_dexgraspbench, write_bodex, write_dexgraspbench
from dexnudge.formats.dexgraspnet import read_dexgraspnet, write_dexgraspnet
from dexnudge.formats.lerobot import write_lerobot
from dexnudge.formats.object_arrays import read_object_array
from dexnudge.formats.scene_files import write_mujoco, write_usd
from dexnudge.geometry.transforms import transform_configurations
from dexnudge.hands.hand import Hand
from dexnudge.jobs.folders import new_folder
from dexnudge.results.folder import CONFIGURATIONS, load_samples, read_inputs
from dexnudge.results.samples import Samples
from dexnudge.scenes.files import SCENE_FILE
from dexnudge.scenes.scene import Scene
from dexnudge.verification.verdicts import Verdicts, verify
from dexnudge.version import __version__

GRASPDATA = "graspdata"  # of DexGraspBench: a folder of records for each object
GRASPS: dict[str, tuple[Callable[..., None], str]] = {  # what writes a folder of samples, and an entry that only it has
    "dexgraspnet": (write_dexgraspnet, "dataset"),
    "bodex": (write_bodex, "scene.npy"),
    "dexgraspbench": (write_dexgraspbench, GRASPDATA),
}
SCENES: dict[str, Callable[..., None]] = {"usd": write_usd, "mujoco": write_mujoco}
EPISODES, BACK = "lerobot", "dexnudge"
FORMATS = (*GRASPS, EPISODES, *SCENES, BACK)
MOST_HANDS = 10_000  # of one conversion, as draws of one call; DexGraspBench has one in each file
AT_ONCE = 256  # hands that are verified between two reports: some seconds
MOST_NAMED = 10  # folders in a message


def convert(source: Path, to: str, out: Path, *, every: bool = False) -> str:
    """Write `out` in the format `to` and return in words what was written.

    source: a folder that `sample` wrote; of `usd` and `mujoco` also one of a scene, of `lerobot` one with executions.
    every: also the configurations that are not verified.

    Raises:
        UnknownNameError: no such format.
        InputError: `source` is none of these, or holds nothing to write.
        OutputError: `out` exists or cannot be written.
    """
    if to not in FORMATS or to == BACK:
        raise UnknownNameError(
            f"unknown format {to!r}{did_you_mean(to, FORMATS)}; expected one of {', '.join(FORMATS)}"
        )
    if not source.is_dir():
        raise InputError(
            f"{source} is not a folder; expected one that `dexnudge sample`, `dexnudge scene` or `dexnudge execute` wrote"
        )
    if to == EPISODES:
        return _episodes(source, out)
    has_hands = (source / CONFIGURATIONS).is_file()
    if not has_hands and (to in GRASPS or not (source / SCENE_FILE).is_file()):
        needed = CONFIGURATIONS if to in GRASPS else f"{CONFIGURATIONS} or {SCENE_FILE}"
        raise InputError(f"{source} holds no {needed}; expected a folder that `dexnudge sample` wrote, for {to}")
    samples = load_samples(source) if has_hands else None
    if samples is not None and not every:
        samples = samples.verified
        if not len(samples):
            raise InputError(f"{source} has no verified configuration; expected one; sample again, or take `every` one")
    if to in GRASPS:
        assert samples is not None
        write, marker = GRASPS[to]
        with new_folder(out, overwrite=None, marker=marker) as folder:
            write(samples, folder, name=source.resolve().name)
        return _counted(len(samples))
    if out.exists():
        raise OutputError(f"{out} exists; expected a new file; choose another `out`")
    if samples is None:
        SCENES[to](Scene.load(source), out)
        return "the scene"
    q = samples.q if to == "mujoco" else samples.q[0]
    SCENES[to](samples.scene, out, hand=samples.hand, q=q)
    return f"the scene and {_counted(len(q) if to == 'mujoco' else 1)}"


def _counted(number: int) -> str:
    return "1 configuration" if number == 1 else f"{number} configurations"


def _episodes(source: Path, out: Path) -> str:
    places = [place for place in (source, *source.absolute().parents) if (place / SCENE_FILE).is_file()]
    if not places and not any(source.rglob(ARRAYS)):
        raise InputError(f"{source} holds no {ARRAYS}; expected a folder that `dexnudge execute` wrote")
    hand, what = "hand", ""
    if places and (places[0] / CONFIGURATIONS).is_file():
        scene, found = read_inputs(places[0])
        hand, what = found.name, f" {round(1e3 * scene.motion_length)} mm along its motion in scene '{scene.name}'"
    with new_folder(out, overwrite=None, marker="meta") as folder:
        number = write_lerobot(source, folder, task=f"push the object{what}", robot=hand, version=__version__)
    return f"{number} episode{'s' * (number > 1)}"


def read_back(
    source: Path,
    scene: Scene,
    hand: Hand,
    *,
    scale: float | None = None,
    on_verified: Callable[[int, int], None] | None = None,
) -> Samples:
    """Return the grasps of a DexGraspNet, BODex or DexGraspBench file, or folder of the last, verified in a scene.

    Of DexGraspBench a folder of records, or one that holds such a folder for a single object.

    The object lies in the scene where the scene has it; the hands come with it. Ranked by what is verified.

    on_verified: called with hands that are verified and with all.

    Raises:
        InputError: a file of another form, of another hand, of an object of another size, or with more hands than
            `MOST_HANDS`.
    """
    files = _records(source) if source.is_dir() else [source]
    if not files or len(files) > MOST_HANDS:
        raise InputError(f"{source} holds {len(files)} .npy files; expected 1 to {MOST_HANDS} of DexGraspBench")
    radius = float(np.linalg.norm(scene.object_mesh.vertices, axis=1).max())
    parts = [_read(file, hand, scale, radius) for file in files]
    if (number := sum(map(len, parts))) > MOST_HANDS:
        raise InputError(f"{source} holds {number} hands; expected at most {MOST_HANDS}; split it into several files")
    q = transform_configurations(scene.T_world_object, np.concatenate(parts))
    verdicts = []
    for begin in range(0, max(number, 1), AT_ONCE):  # none are verified, too
        verdicts.append(verify(scene, hand, q[begin : begin + AT_ONCE]))
        if on_verified:
            on_verified(min(begin + AT_ONCE, number), number)
    return Samples(scene, hand, q, Verdicts.concatenate(verdicts)).best_first()


def _records(folder: Path) -> list[Path]:
    """Return the .npy files of a folder or, where it has none, of the one folder in its `graspdata` that has some."""
    found = sorted(folder.glob("*.npy"))
    below = folder / GRASPDATA if (folder / GRASPDATA).is_dir() else folder
    objects = [] if found else sorted({file.parent for file in below.glob("*/*.npy")})
    if len(objects) > 1:
        more = f" and {len(objects) - MOST_NAMED} more" if len(objects) > MOST_NAMED else ""
        raise InputError(
            f"{folder} holds grasps of {len(objects)} objects; expected those of one; give one of "
            f"{', '.join(map(str, objects[:MOST_NAMED]))}{more}"
        )
    return sorted(objects[0].glob("*.npy")) if objects else found


def _read(file: Path, hand: Hand, scale: float | None, radius: float) -> Float[np.ndarray, "n coordinates"]:
    content: Any = read_object_array(file)
    if isinstance(content, list):
        return read_dexgraspnet(content, hand, where=str(file), scale=scale, radius=radius)
    if isinstance(content, dict):
        check_object_scale(content, radius, str(file))
    if isinstance(content, dict) and "robot_pose" in content:
        return read_bodex(content, hand, path=file)
    if isinstance(content, dict) and "grasp_qpos" in content:
        return read_dexgraspbench(content, hand, where=str(file))
    raise InputError(
        f"{file} is of none of the formats dexgraspnet, bodex, dexgraspbench; expected a list of qpos and scale, "
        "or robot_pose, or grasp_qpos"
    )
