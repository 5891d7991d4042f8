"""What it brings that sampling feels an arm's reach, against ranking by reach alone: by hand, scene and place of the arm."""

import time
from dataclasses import dataclass

import numpy as np
import tyro

from dexnudge.arms.arm import Arm
from dexnudge.arms.registry import load_arm
from dexnudge.arms.standing import default_base
from dexnudge.cli.arguments import stdout, table
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.progress import progress
from dexnudge.jobs.provenance import machine, versions
from dexnudge.planning.reach_term import ReachTerm
from dexnudge.results.samples import Samples
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import build_scene
from dexnudge.scenes.scene import Scene

TOP = 8  # configurations that a planner tries
PLACES = (
    (0.6, 0.0),
    (0.7, 0.0),
    (0.6, 0.2),
    (0.6, -0.2),
)  # [m] of the base: distance from the object, height over its base


def standing(arm: Arm, scene: Scene, distance: float, height: float) -> Arm:
    """Return the arm at a distance from the object and a height [m]; the default place is 0.6 m away, at height 0."""
    base = default_base(arm, scene)
    base[:3, 3] += (0.6 - distance) * base[:3, 0] + (0.0, 0.0, height)
    return arm.standing_at(base)


@dataclass(frozen=True)
class Benchmark:
    """Sample with and without the term; judge all draws by reach."""

    arm: str = "panda"
    """Built-in arm, or a URDF or MJCF file."""
    hands: tuple[str, ...] = ("shadow_lite", "allegro")
    """Built-in hands."""
    scenes: tuple[str, ...] = ("table", "shelf")
    """Scene families."""
    objects: tuple[str, ...] = ("phone", "tablet")
    """Built-in objects."""
    weights: tuple[float, ...] = (1.0, 10.0)
    """Of the term."""
    num: int = 32
    """Draws of one run."""
    seeds: int = 1
    """Runs of each kind."""

    def run(self) -> None:
        """Print machine, versions, and a line for each hand, scene and place."""
        console = stdout()
        console.print("; ".join(f"{key} {value}" for key, value in {**machine(), **versions()}.items()), soft_wrap=True)
        kinds = ["rank", *(f"term {weight:g}" for weight in self.weights)]
        shares = table("verified and reachable of all draws", *kinds)
        tops = table(f"the same of the first {TOP}", *kinds)
        seconds = table("seconds of a run", *kinds)
        arm = load_arm(self.arm)
        with progress() as bars:
            bar = bars.add_task("sampling", total=len(self.hands) * len(self.scenes))
            for name in self.hands:
                for family in self.scenes:
                    for place, found in self._measure(arm, name, family).items():
                        label = f"{name}, {family}, {place[0]:g} m away, {place[1]:+g} m high"
                        mean = {kind: np.mean(rows, axis=0) for kind, rows in found.items()}
                        for shown, column, form in ((shares, 0, "{:.1%}"), (tops, 1, "{:.1%}"), (seconds, 2, "{:.2f}")):
                            shown.add_row(label, *(form.format(mean[kind][column]) for kind in kinds))
                    bars.advance(bar)
        for shown in (shares, tops, seconds):
            console.print(shown)

    def _measure(self, arm: Arm, name: str, family: str) -> dict[tuple[float, float], dict[str, list[list[float]]]]:
        hand = load_hand(name)
        plain = Sampler.from_pretrained(hand)
        found: dict[tuple[float, float], dict[str, list[list[float]]]] = {place: {} for place in PLACES}
        for number, what in enumerate(self.objects * self.seeds):
            scene = build_scene(family, what, seed=number)
            plain.sample(scene, num=4, seed=0)  # warms up: what is known about a scene is kept with it
            start = time.perf_counter()
            free = plain.sample(scene, num=self.num, seed=number)
            spent = time.perf_counter() - start
            for place, rows in found.items():
                there = standing(arm, scene, *place)
                rows.setdefault("rank", []).append(_row(free, there, spent))
                for weight in self.weights:
                    sampler = Sampler(hand, terms=[ReachTerm(there, weight=weight)], weights=plain.prior)
                    start = time.perf_counter()
                    felt = sampler.sample(scene, num=self.num, seed=number)
                    felt_spent = time.perf_counter() - start
                    rows.setdefault(f"term {weight:g}", []).append(_row(felt, there, felt_spent))
        return found


def _row(samples: Samples, arm: Arm, spent: float) -> list[float]:
    """Return the shares that are verified and reachable, of all draws and of the first, and the seconds with ranking."""
    start = time.perf_counter()
    success = samples.rank(arm).success
    return [success.mean(), success[:TOP].mean(), spent + time.perf_counter() - start]


if __name__ == "__main__":
    tyro.cli(Benchmark).run()
