"""Fit and check the probability that a verified configuration holds in physics (`results.probability`).

draw, then execute, then fit; each goes on where it was stopped.
"""

import json
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from scipy.optimize import minimize

from dexnudge.errors import DexnudgeError
from dexnudge.execution.executor import Executor
from dexnudge.experiments.tables import save_chart
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.provenance import versions
from dexnudge.objects.sets import resolve_object_set
from dexnudge.results.probability import MODEL, features
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import build_scene
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.uncertainty import Uncertainty
from dexnudge.simulation.model import QUANTITIES, changed_physics, scene_model
from dexnudge.verification.verdicts import contacts_of, verify

WORLDS = Uncertainty(friction=(0.5, 1.25), friction_environment=(0.75, 1.5), mass=(0.5, 2.0))
"""Scenes other than the default ones, in which configurations are verified, planned and executed; half stay as they are."""
L2 = 3.0  # weight of the squared weights: of some hundred executions a few dozen failed
FOLDS, BINS = 8, 5  # of objects that are left out together; of executions, equally many, in the plot
DRAWS, EXECUTED = "q.npy", "executed.jsonl"


@dataclass(frozen=True, kw_only=True)
class Draw:
    """Draw and verify configurations for a set of objects; only those that are verified are kept."""

    objects: str
    """Set of objects."""
    out: Path
    """Folder of the runs."""
    scenes: tuple[str, ...] = ("table", "layers", "shelf")
    """Scene families."""
    hand: str = "shadow_lite"
    """Hand."""
    num: int = 12
    """Draws for each object and scene."""

    def run(self) -> None:
        """Draw what is missing."""
        torch.set_num_threads(1)
        hand = load_hand(self.hand)
        sampler = Sampler.from_pretrained(hand)
        for entry in resolve_object_set(self.objects):
            for family in self.scenes:
                folder = self.out / f"{entry.name}-{family}"
                if (folder / DRAWS).exists():
                    continue
                seed = zlib.crc32(folder.name.encode())
                try:
                    build_scene(family, entry.load(), seed=seed).save(folder)
                    samples = sampler.sample(Scene.load(folder), num=self.num, seed=seed)
                except DexnudgeError as error:
                    print(f"{folder.name}: {error}", flush=True)
                    continue
                np.save(folder / DRAWS, samples.verified.q)
                print(f"{folder.name}: {samples.num_verified} of {self.num} verified", flush=True)


@dataclass(frozen=True, kw_only=True)
class Execute:
    """Execute some verified configurations of each scene, at random, in it and in one of other frictions and mass."""

    out: Path
    """Folder of the runs."""
    hand: str = "shadow_lite"
    """Hand."""
    each: int = 4
    """Configurations for each scene and world."""

    def run(self) -> None:
        """Execute what is missing."""
        torch.set_num_threads(1)
        hand, done = load_hand(self.hand), {(row["scene"], row["world"]) for row in executed(self.out)}
        folders = [path.parent for path in self.out.glob(f"*/{DRAWS}")]
        for folder in sorted(folders, key=lambda path: zlib.crc32(path.name.encode())):
            scene, q = Scene.load(folder), np.load(folder / DRAWS).astype(np.float64)
            seed, simulation = zlib.crc32(folder.name.encode()), None
            for world, physics in enumerate(({}, replace(WORLDS, seed=seed, worlds=2).sampled(scene)[0][0])):
                if (folder.name, world) in done or not len(q):
                    continue
                there = replace(scene, **physics)
                verified = np.flatnonzero(verify(there, hand, q).success)
                chosen = np.random.default_rng([seed, world]).permutation(verified)[: self.each]
                if simulation is None:
                    simulation = scene_model(hand, scene)
                factors = {name: value / getattr(scene, name) for name, value in physics.items() if name in QUANTITIES}
                executor = Executor(there, changed_physics(simulation, **factors))
                rows = []
                for index in chosen.tolist():
                    verdict = executor(q[index]).verdict
                    row = {"scene": folder.name, "world": world, "draw": index, "physics": physics}
                    rows.append(row | {"outcome": verdict.outcome.value, "reached": verdict.length_reached})
                with (self.out / EXECUTED).open("a", encoding="utf-8") as file:
                    file.writelines(json.dumps(row) + "\n" for row in rows)
                print(folder.name, world, [row["outcome"] for row in rows], flush=True)


def executed(out: Path) -> list[dict[str, Any]]:
    """Return the executions so far, a row each."""
    path = out / EXECUTED
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Fit the probability, measure it on objects that did not help to fit it, write the model and the reliability plot."""

    out: Path
    """Folder of the runs."""
    hand: str = "shadow_lite"
    """Hand."""
    on: str = "objects of train51.txt"
    """What the objects were, for the record."""
    model: Path = MODEL
    """Where the model is written."""
    plot: Path = Path("docs/images/execution_probability.png")
    """Where the plot is written."""

    def run(self) -> None:
        """Print AUC and Brier score by leave-objects-out, then write."""
        rows = executed(self.out)
        figures, held = self._figures(rows), np.array([row["outcome"] == "success" for row in rows], dtype=float)
        objects = np.array([row["scene"].rpartition("-")[0] for row in rows])
        families = np.array([row["scene"].rpartition("-")[2] for row in rows])
        as_said = np.array([row["world"] == 0 for row in rows])
        names = list(figures)
        X = np.stack([figures[name] for name in names], axis=1)
        found = {"fitted": left_out(X, held, objects), "margin": left_out(X[:, [names.index("margin")]], held, objects)}
        found["mean"] = left_out(X[:, :0], held, objects)
        groups = {"all": np.full(len(rows), True), "scenes as they are": as_said, "other frictions, mass": ~as_said}
        groups |= {family: families == family for family in np.unique(families)}
        print(f"{'':24}{'n':>5}{'held':>7}" + "".join(f"{name + ' AUC':>13}{'Brier':>7}" for name in found))
        for name, rows_of in groups.items():
            figures_of = [(auc(p[rows_of], held[rows_of]), np.mean((p - held)[rows_of] ** 2)) for p in found.values()]
            shown = "".join(f"{area:13.2f}{brier:7.3f}" for area, brier in figures_of)
            print(f"{name:24}{rows_of.sum():5}{held[rows_of].mean():7.2f}{shown}")
        bias, weight, mean, scale = logistic(X, held)
        of = {
            name: {
                "mean": mean[k],
                "scale": scale[k],
                "weight": weight[k],
                "least": X[:, k].min(),
                "greatest": X[:, k].max(),
            }
            for k, name in enumerate(names)
        }
        for k in np.argsort(-np.abs(weight)):
            print(f"{names[k]:24}{weight[k]:8.3f}")
        calibrated = {
            "on": self.on,
            "hand": self.hand,
            "objects": len(np.unique(objects)),
            "scenes": np.unique(families).tolist(),
            "executions": len(rows),
            "held": round(float(held.mean()), 4),
            "auc_on_other_objects": round(auc(found["fitted"], held), 4),
            "brier_on_other_objects": round(float(np.mean((found["fitted"] - held) ** 2)), 4),
            "brier_of_the_mean": round(float(np.mean((found["mean"] - held) ** 2)), 4),
            "versions": versions(),
        }
        rounded = {name: {key: float(f"{value:.6g}") for key, value in each.items()} for name, each in of.items()}
        written = {"calibrated": calibrated, "bias": float(f"{bias:.6g}"), "features": rounded}
        self.model.write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")
        self._draw(found["fitted"], held, as_said)

    def _figures(self, rows: list[dict[str, Any]]) -> dict[str, np.ndarray]:
        """Return the features of each row."""
        hand, found = load_hand(self.hand), list[dict[str, float]]({} for _ in rows)
        for name, world in sorted({(row["scene"], row["world"]) for row in rows}):
            places = [k for k, row in enumerate(rows) if (row["scene"], row["world"]) == (name, world)]
            folder = self.out / name
            scene = replace(Scene.load(folder), **rows[places[0]]["physics"])
            q = np.load(folder / DRAWS).astype(np.float64)[[rows[k]["draw"] for k in places]]
            figures = features(scene, contacts_of(scene, hand, q))
            for at, k in enumerate(places):
                found[k] = {feature: float(value[at]) for feature, value in figures.items()}
        return {feature: np.array([each[feature] for each in found]) for feature in found[0]}

    def _draw(self, p: np.ndarray, held: np.ndarray, as_said: np.ndarray) -> None:
        """Draw how often pushes held against the probability that was foretold, on objects that were left out."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(5.2, 4.6))
        axes = figure.add_subplot()
        axes.plot([0, 100], [0, 100], color="#bbbbbb", linewidth=1)
        for colour, (label, mask) in enumerate(
            {"scenes as they are": as_said, "other frictions and mass": ~as_said}.items()
        ):
            order = np.argsort(p[mask])
            for place, bin_ in enumerate(np.array_split(order, BINS)):
                if not len(bin_):
                    continue
                said, came = p[mask][bin_].mean(), held[mask][bin_]
                low, high = wilson(came.sum(), len(came))
                at = 100 * said
                axes.plot([at, at], [100 * low, 100 * high], color=f"C{colour}", linewidth=1.2)
                name = f"{label}, n = {mask.sum()}" if not place else None
                axes.plot(at, 100 * came.mean(), "os"[colour], color=f"C{colour}", label=name)
        axes.set(xlabel="foretold probability [%]", ylabel="held in physics [%]; line: 95 % interval", xlim=(0, 100))
        axes.set_ylim(0, 102)
        axes.set_title("Objects that were left out of the fit", loc="left", fontsize=11, weight="bold")
        axes.legend(loc="upper left", fontsize=8, frameon=False)
        axes.spines[["top", "right"]].set_visible(False)
        save_chart(figure, self.plot)


def logistic(X: np.ndarray, y: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Return bias, weights of standardised features, their means and scales: the least regularised log loss."""
    mean, scale = X.mean(axis=0), np.maximum(X.std(axis=0), 1e-9)
    Z = (X - mean) / scale

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        score = w[0] + Z @ w[1:]
        p = 1 / (1 + np.exp(-score))
        value = np.logaddexp(0, score).sum() - y @ score + L2 * (w[1:] @ w[1:])
        return float(value), np.concatenate([[(p - y).sum()], Z.T @ (p - y) + 2 * L2 * w[1:]])

    w = minimize(loss, np.zeros(1 + Z.shape[1]), jac=True, method="L-BFGS-B").x
    return float(w[0]), w[1:], mean, scale


def left_out(X: np.ndarray, y: np.ndarray, objects: np.ndarray) -> np.ndarray:
    """Return each row's probability from a fit without its object, nor those that fall into the same fold."""
    fold = np.array([zlib.crc32(name.encode()) % FOLDS for name in objects])
    p = np.zeros(len(y))
    for k in np.unique(fold):
        out = fold == k
        bias, weight, mean, scale = logistic(X[~out], y[~out])
        inside = np.clip(X[out], X[~out].min(axis=0), X[~out].max(axis=0))
        p[out] = 1 / (1 + np.exp(-bias - (inside - mean) / scale @ weight))
    return p


def auc(p: np.ndarray, y: np.ndarray) -> float:
    """Return the probability that a push that held was foretold a greater one than a push that did not; NaN without both."""
    held, failed = p[y == 1][:, None], p[y == 0]
    return float(((held > failed) + 0.5 * (held == failed)).mean()) if len(held) and len(failed) else float("nan")


def wilson(successes: float, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson)."""
    z = 1.96
    middle, share = 1 + z**2 / count, successes / count
    half = z * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    centre = share + z**2 / (2 * count)
    return float((centre - half) / middle), float((centre + half) / middle)


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"draw": Draw, "execute": Execute, "fit": Fit}, description=__doc__).run()
