"""What is found out about a scene before anything is sampled: what was understood, what is odd, what cannot work."""

from __future__ import annotations

import numpy as np

from dexnudge.hands.hand import Hand
from dexnudge.scenes.finding import Finding
from dexnudge.scenes.room import room_findings
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.sizes import size_findings

ORDER = {"error": 0, "warning": 1, "note": 2}
UP = np.array([0.0, 0.0, 1.0])


def scene_findings(scene: Scene, hand: Hand | None = None) -> list[Finding]:
    """Return the findings about a scene, errors first; see `Scene.findings`."""
    sizes = size_findings(scene.object_mesh, scene.environment_mesh, scene.mass)
    found = [*(finding for finding in sizes if finding.level != "error"), *scene.misplaced]
    if not scene.misplaced:
        found += room_findings(scene, hand, UP)
    found += [Finding("note", "repaired", note) for note in scene.notes]
    return sorted(found, key=lambda finding: ORDER[finding.level])
