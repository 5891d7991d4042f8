"""What a folder holds for the studio: a scene and a hand, with draws and with what can be played, as far as there are."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dexnudge.errors import InputError, check_path
from dexnudge.execution.episode_files import ARRAYS
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand
from dexnudge.objects.builtin import KINDS, builtin_object
from dexnudge.results.folder import CONFIGURATIONS, load_samples
from dexnudge.results.samples import Samples
from dexnudge.scenes.families import build_scene
from dexnudge.scenes.files import SCENE_FILE
from dexnudge.scenes.scene import Scene
from dexnudge.studio.playback import Recordings, plan_recordings, recordings
from dexnudge.trajectories.plan_folder import PLAN, load_plan

SAME_SIZE = 1e-6  # [m] of a mesh that was written and read
OBJECT, FAMILY = "phone", "table"  # of the scene at the start, where no folder is given


@dataclass(frozen=True, eq=False)
class Content:
    """What the studio begins with.

    Attributes:
        name: of the folder, or of object and family.
        scene: the scene.
        hand: what is sampled.
        samples: the draws; None where there are none yet.
        recordings: what can be played, by name.
        played: whether a plan or an execution was opened, rather than a result or a scene.
    """

    name: str
    scene: Scene
    hand: Hand
    samples: Samples | None = None
    recordings: Recordings = field(default_factory=dict)
    played: bool = False


def read_content(
    folder: Path | str | None, *, execution: Path | str | None = None, hand: str = "shadow_lite"
) -> Content:
    """Return what a folder holds.

    Args:
        folder: that of a result, a plan (or its plan.json), a scene, or an execution inside a result; None for a phone on a
            table.
        execution: a folder of executions beside that of the result.
        hand: what is sampled where the folder brings no hand.

    Raises:
        InputError: no such folder, or a file in it that is damaged.
    """
    if folder is None:
        if execution is not None:
            raise InputError("`execution` is given without a result folder; expected both")
        return Content(f"{OBJECT}-{FAMILY}", build_scene(FAMILY, OBJECT, seed=0), load_hand(hand))
    check_path("folder", folder)
    folder = Path(folder)
    folder = folder.parent if folder.name == PLAN and folder.is_file() else folder
    name = folder.resolve().name
    if (folder / PLAN).is_file():
        plan = load_plan(folder)
        return Content(name, plan.scene, plan.robot.hand, recordings=plan_recordings(folder, folder), played=True)
    result = next((place for place in (folder, *folder.resolve().parents[:2]) if _has_result(place, folder)), None)
    if result is not None:
        samples = load_samples(result)
        found = recordings(folder, samples.scene, samples.hand)
        if execution is not None:
            beside = recordings(Path(execution), samples.scene, samples.hand)
            if not beside:
                raise InputError(f"`execution` {execution} holds no {ARRAYS}; expected the folder that `execute` wrote")
            found |= beside
        played = result != folder and bool(found)
        return Content(result.resolve().name, samples.scene, samples.hand, samples, found, played)
    if (folder / SCENE_FILE).is_file():
        return Content(name, Scene.load(folder), load_hand(hand))
    raise InputError(
        f"{folder} holds neither {CONFIGURATIONS}, {PLAN}, {ARRAYS} nor {SCENE_FILE}; expected a folder that `sample`, "
        "`plan`, `execute` or `scene` wrote"
    )


def builtin_kind(scene: Scene) -> str | None:
    """Return the built-in object that a scene is of; None for any other mesh."""
    mesh = scene.object_mesh
    same = (kind for kind in KINDS if np.allclose(builtin_object(kind).extents, mesh.extents, rtol=0, atol=SAME_SIZE))
    return next(same, None)


def _has_result(place: Path, folder: Path) -> bool:
    """Whether a folder holds a result, which may be the one that an execution inside it belongs to."""
    inside = place == folder or any(folder.glob(f"{end}{ARRAYS}") for end in ("", "*/"))
    return inside and (place / CONFIGURATIONS).is_file()
