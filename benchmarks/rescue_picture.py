"""Draws a push that slips in open loop and that feedback saves, one above the other: docs/images/rescue.png.

The hand's friction is less than approach and forces were planned for. Objects are tried in order until one shows it.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from PIL import Image

import dexnudge as dn
from dexnudge.execution.executor import Executor
from dexnudge.execution.film import film_of_trace, save_film
from dexnudge.objects.sets import resolve_object_set
from dexnudge.simulation.model import scene_model

GAP = 6  # pixels between the rows


@dataclass(frozen=True)
class Rescue:
    """Find a rescued push and draw it."""

    objects: str = "builtin:test"
    """Set of objects, as `evaluate --objects` takes it."""
    scene: str = "table"
    """Family of the scene."""
    friction: float = 0.6
    """The hand's friction in the world, as a share of what was planned for."""
    num: int = 8
    """Draws for each object, of which the best is played."""
    out: Path = Path(__file__).parents[1] / "docs" / "images" / "rescue.png"
    """The picture."""

    def run(self) -> None:
        """Play objects until one shows it, and write the picture."""
        hand = dn.load_hand("shadow_lite")
        sampler = dn.Sampler(hand)
        for item in resolve_object_set(self.objects):
            scene = dn.build_scene(self.scene, item.load(), seed=0)
            q = sampler.sample(scene, num=self.num, seed=0).q.astype(np.float64)
            world = scene_model(hand, replace(scene, friction_hand=self.friction * scene.friction_hand))
            played = {policy: Executor(scene, world, policy)(q[0], None) for policy in (dn.OpenLoop(), dn.Feedback())}
            came = [f"{type(policy).__name__}: {each.verdict.outcome.value}" for policy, each in played.items()]
            print(item.name, *came, flush=True)
            if [each.verdict.success for each in played.values()] == [False, True]:
                rows = []
                for policy, each in played.items():
                    name, outcome = type(policy).__name__, each.verdict.outcome
                    says = {"subtitle": f"{name}: {outcome.sentence}", "success": each.verdict.success}
                    film = film_of_trace(scene, world, each.trace, **says, length=each.verdict.length_asked)
                    row = self.out.with_stem(name)
                    rows.append(np.asarray(Image.open(save_film(film, row)).convert("RGB")))
                    row.unlink()
                gap = np.full((GAP, rows[0].shape[1], 3), 255, np.uint8)
                Image.fromarray(np.concatenate([rows[0], gap, rows[1]])).save(self.out)
                print(f"written: {self.out}")
                return


if __name__ == "__main__":
    tyro.cli(Rescue).run()
