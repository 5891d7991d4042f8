"""Valid grasps per CPU second: our descent against DexGraspNet's annealing, on the same objects, hand and verifier."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, fields

import numpy as np
import torch
import trimesh
import tyro
from annealed.annealing import AnnealConfig, anneal_grasps

from dexnudge.cli.arguments import stdout, table
from dexnudge.energies.kernel_inputs import build_scene_fields
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.geometry.surface_points import surface_points
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.provenance import machine, versions
from dexnudge.objects.sets import resolve_object_set
from dexnudge.synthesis.acceptance import GraspVerifier, floating_scene
from dexnudge.synthesis.grasps import GraspConfig, descend_to_grasp
from dexnudge.synthesis.object_data import TARGET_SPACING, at_rest

STEERED_NOISE, REFERENCE = "descent", "annealed"
UNCLEAN = ("penetration", "no contact")  # how the verifier's reasons begin for hands that it does not simulate
WARM_UP = 8  # hands drawn before the clock starts, so that kernels are compiled and grids of the hand are built


@dataclass
class Tally:
    """What one method made of its attempts: clean and touching by the exact check, and of these held in MuJoCo."""

    attempts: int = 0
    clean: int = 0
    held: int = 0
    draw_seconds: float = 0.0
    verify_seconds: float = 0.0
    reasons: Counter[str] = field(default_factory=Counter)

    def __add__(self, other: "Tally") -> "Tally":
        return Tally(*(getattr(self, entry.name) + getattr(other, entry.name) for entry in fields(Tally)))

    @property
    def rate(self) -> float:
        """Held grasps per second of one core, drawing and verification together."""
        return self.held / max(self.draw_seconds + self.verify_seconds, 1e-9)

    def cells(self) -> list[str]:
        """One line of the table."""
        shares = [f"{100 * part / max(self.attempts, 1):.1f}" for part in (self.clean, self.held)]
        return [
            str(self.attempts),
            *shares,
            f"{self.draw_seconds:.2f}",
            f"{self.verify_seconds:.2f}",
            f"{self.rate:.2f}",
        ]


@dataclass(frozen=True)
class Benchmark:
    """Draw and verify grasps on one thread; grids and checks of an object are built before the clock starts."""

    objects: str = "builtin:test"
    """Set of objects."""
    num_objects: int = 2
    """How many of the set, from its start."""
    batch: int = 64
    """Hands that each method draws for an object."""
    methods: tuple[str, ...] = (STEERED_NOISE, REFERENCE)
    """Methods to compare: descent (ours), annealed (DexGraspNet's)."""
    iterations: int = AnnealConfig().iterations
    """Of the annealing."""
    hand: str = "shadow_lite"
    """Hand."""
    seed: int = 0
    """Seed of the draws."""

    def run(self) -> None:
        """Print machine, versions, one line for each object and method, the totals and their ratio."""
        torch.set_num_threads(1)
        console = stdout()
        console.print("; ".join(f"{key} {value}" for key, value in {**machine(), **versions()}.items()), soft_wrap=True)
        console.print(f"annealing: {self.iterations} iterations; batches of {self.batch}; seed {self.seed}")
        shown = table("object, method", "attempts", "clean %", "held %", "draw s", "verify s", "held/s")
        totals = {method: Tally() for method in self.methods}
        for entry in resolve_object_set(self.objects)[: self.num_objects]:
            mesh = at_rest(entry.load())
            for method, tally in self._compare(mesh).items():
                totals[method] += tally
                shown.add_row(f"{entry.name}, {method}", *tally.cells())
        for method, tally in totals.items():
            shown.add_row(f"all, {method}", *tally.cells())
        console.print(shown)
        for method, tally in totals.items():
            reasons = ", ".join(f"{reason} {count}" for reason, count in tally.reasons.most_common())
            console.print(f"{method}: rejected for {reasons}", soft_wrap=True)
        if {STEERED_NOISE, REFERENCE} <= totals.keys():
            ours, reference = totals[STEERED_NOISE], totals[REFERENCE]
            for label, one, other in (
                ("held per second and core", ours.rate, reference.rate),
                ("held per attempt", ours.held / ours.attempts, reference.held / reference.attempts),
                ("seconds to draw", ours.draw_seconds, reference.draw_seconds),
            ):
                console.print(
                    f"ours / reference, {label}: {f'{one / other:.3g}' if other else 'the reference has none'}"
                )

    def _compare(self, mesh: trimesh.Trimesh) -> dict[str, Tally]:
        hand = load_hand(self.hand)
        grids, surface = build_scene_fields(mesh, None), surface_points(mesh, spacing=TARGET_SPACING)
        centre, verifier = centre_of_mass(mesh), GraspVerifier(hand, floating_scene(mesh))
        draws: dict[str, Callable[[int, int], torch.Tensor]] = {
            STEERED_NOISE: lambda batch, _: descend_to_grasp(
                hand, grids, surface, centre, config=GraspConfig(batch=batch), generator=generator
            ),
            REFERENCE: lambda batch, iterations: anneal_grasps(
                hand,
                grids,
                mesh,
                centre,
                config=AnnealConfig(batch=batch, iterations=iterations),
                generator=generator,
            ),
        }
        found = {}
        for method in self.methods:
            generator = np.random.default_rng(self.seed)
            verifier(draws[method](WARM_UP, 2).numpy())
            start = time.process_time()
            q = draws[method](self.batch, self.iterations).numpy()
            drawn = time.process_time()
            reasons = verifier(q).reason
            verified = time.process_time()
            rejected = Counter(reason for reason in reasons if reason)
            unclean = sum(count for reason, count in rejected.items() if reason.startswith(UNCLEAN))
            found[method] = Tally(
                attempts=len(q),
                clean=len(q) - unclean,
                held=reasons.count(""),
                draw_seconds=drawn - start,
                verify_seconds=verified - drawn,
                reasons=rejected,
            )
        return found


if __name__ == "__main__":
    tyro.cli(Benchmark).run()
