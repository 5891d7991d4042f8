"""Chart of the forces in an episode that `execute` wrote: of each link on the object, and of the base."""

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import tyro

from dexnudge.execution.episode_files import ARRAYS, FIGURES
from dexnudge.viewer.page import BANDS, COLOURS, LIMIT_COLOUR

LEAST_SHOWN = 0.05  # [N] that a link presses with at some time, to have a curve
LEAST_NAMED = 0.045  # of the time axis, for the name of a phase to stand above it

mpl.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402 - after the choice of its backend


@dataclass(frozen=True)
class Chart:
    """Draw the chart."""

    episode: tyro.conf.Positional[Path]
    """Folder with episode.npz and episode.json."""
    out: Path = Path(__file__).parents[1] / "docs/images/forces.png"
    """Picture."""

    def run(self) -> None:
        """Write the picture."""
        limits = json.loads((self.episode / FIGURES).read_text())["limits"]
        with np.load(self.episode / ARRAYS, allow_pickle=False) as arrays:
            time, phase, link_force = arrays["time"], arrays["phase"], arrays["link_force"]
            names, wrench = arrays["link_names"], arrays["base_wrench"]
        figure, (links, base) = plt.subplots(2, 1, sharex=True, figsize=(9, 5.2), layout="constrained")
        strongest = link_force.max(axis=0)
        for index, link in enumerate(np.argsort(-strongest, kind="stable")):
            if strongest[link] > LEAST_SHOWN:
                links.plot(time, link_force[:, link], color=COLOURS[index % len(COLOURS)], label=str(names[link]))
        for index, axis in enumerate("xyz"):
            base.plot(time, wrench[:, index], color=COLOURS[index], label=axis)
        links.axhline(limits["link_force"], color=LIMIT_COLOUR, linestyle="--", label="limit")
        links.set(ylabel="link on object [N]", ylim=(0, 1.2 * limits["link_force"]))
        base.set(xlabel="time [s]", ylabel="base on hand [N]", xlim=(time[0], time[-1]))
        for axes in (links, base):
            axes.legend(ncols=6, loc="upper left", frameon=False, fontsize=8)
            axes.spines[["top", "right"]].set_visible(False)
        shade(links, base, time=time, phase=phase)
        figure.savefig(self.out, dpi=120)
        print(self.out)


def shade(*panels: Any, time: np.ndarray, phase: np.ndarray) -> None:
    """Put a band behind each phase in all panels, and its name above the first where there is room."""
    edges = [0, *(np.flatnonzero(phase[1:] != phase[:-1]) + 1), len(time) - 1]
    for index, (start, end) in enumerate(pairwise(edges)):
        for axes in panels:
            axes.axvspan(time[start], time[end], color=BANDS[index % 2], zorder=0, linewidth=0)
        if time[end] - time[start] > LEAST_NAMED * (time[-1] - time[0]):
            middle = (time[start] + time[end]) / 2
            panels[0].annotate(
                str(phase[start]), (middle, 1.01), xycoords=("data", "axes fraction"), ha="center", fontsize=8
            )


if __name__ == "__main__":
    tyro.cli(Chart).run()
