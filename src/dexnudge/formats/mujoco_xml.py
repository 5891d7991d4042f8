"""A scene as one MJCF file that needs no other: what executions simulate, with a key frame for each configuration."""

from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
from jaxtyping import Float

from dexnudge.hands.hand import Hand
from dexnudge.jobs.folders import replace_atomically
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.convex_pieces import environment_pieces
from dexnudge.simulation.model import add_scene, scene_model


def write_mujoco(
    scene: Scene, path: Path, *, hand: Hand | None = None, q: Float[np.ndarray, "n coordinates"] | None = None
) -> None:
    """Write the scene, with the hand and key frames of it at each q (world) where one is given.

    Raises:
        MeshError: object or surroundings cannot be cut into convex pieces.
        OutputError: the file cannot be written.
    """
    if hand is None or q is None:
        spec = mujoco.MjSpec()
        add_scene(spec, scene, environment_pieces(scene.environment_mesh, scene.way_bounds()))
        text = str(spec.to_xml())
    else:
        simulation = scene_model(hand, scene)
        root = ElementTree.fromstring(simulation.xml)  # noqa: S314 - the text is our own
        keys = ElementTree.SubElement(root, "keyframe")
        for number, configuration in enumerate(q.astype(np.float64)):
            simulation.place(configuration)
            data = simulation.data
            values = {"qpos": data.qpos, "ctrl": data.ctrl, "mpos": data.mocap_pos[0], "mquat": data.mocap_quat[0]}
            texts = {name: " ".join(f"{each:.9g}" for each in value) for name, value in values.items()}
            ElementTree.SubElement(keys, "key", texts, name=f"configuration {number}")
        ElementTree.indent(root)
        text = ElementTree.tostring(root, encoding="unicode")
    with replace_atomically(path) as part:
        part.write_text(text, encoding="utf-8")
