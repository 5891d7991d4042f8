"""A map of where an arm may stand, from above: places coloured by share, the surroundings below them, object and motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from dexnudge.errors import InputError
from dexnudge.scenes.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANEL = 6.0  # [inch] of a map's side
ARROW = 0.25  # [m] at least of the arrow, so that it is seen
INK, GREY, GROUND, OBJECT = "#1f2933", "#9aa5b1", "#e4e7eb", "#e07b39"


def base_picture(
    scene: Scene,
    x: Float[np.ndarray, " column"],
    y: Float[np.ndarray, " row"],
    heights: Float[np.ndarray, " height"],
    share: Float[np.ndarray, "height row column"],
    best: tuple[int, int, int] | None,
    arm: str,
) -> Figure:
    """Return the picture, a map for each height side by side.

    x, y: of the places [m, world]. heights: over the object's underside [m]. share: NaN where the surroundings stand. best:
    place that is marked, as an index of `share`.

    Raises:
        InputError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError("the picture of a map needs matplotlib: `pip install 'dexnudge[plots]'`") from error

    figure = Figure(figsize=(PANEL * len(heights), 1.15 * PANEL), layout="constrained")
    panels = figure.subplots(1, len(heights), squeeze=False)[0]
    for index, (axes, height) in enumerate(zip(panels, heights.tolist(), strict=True)):
        _draw_world(axes, scene)
        taken = np.argwhere(np.isnan(share[index]))
        cells = axes.pcolormesh(x, y, share[index], vmin=0.0, vmax=1.0, cmap="GnBu", edgecolors="white", zorder=2)
        axes.scatter(
            x[taken[:, 1]], y[taken[:, 0]], marker="x", color=GREY, zorder=2, label="taken by the surroundings"
        )
        if best and best[0] == index:
            _draw_place(axes, np.array([x[best[2]], y[best[1]]]), float(x[1] - x[0]), scene)
        step = (x[1] - x[0]) / 2
        axes.set(xlim=(x[0] - step, x[-1] + step), ylim=(y[0] - step, y[-1] + step), aspect="equal")
        axes.set(xlabel="x [m]", ylabel="y [m]")
        axes.set_title(f"{arm}, base {height:+.2f} m", loc="left")
    figure.colorbar(
        cells, ax=list(panels), location="bottom", aspect=40, label="share of configurations reached from there"
    )
    figure.legend(
        *panels[best[0] if best else 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=9
    )
    return figure


def _draw_world(axes: Axes, scene: Scene) -> None:
    """Draw the surroundings, the object's outline and the motion."""
    from matplotlib.collections import PolyCollection

    surroundings, body = scene.environment_mesh, scene.object_in_world()
    lying = np.abs(surroundings.face_normals[:, 2]) > 1e-3
    ground = surroundings.triangles[lying][:, :, :2]
    axes.add_collection(PolyCollection(ground, facecolors=GROUND, edgecolors=GROUND, zorder=1))
    outline = np.asarray(body.vertices[:, :2])
    axes.fill(*outline[ConvexHull(outline).vertices].T, facecolor=OBJECT, edgecolor=INK, zorder=3, label="object")
    middle, way = body.bounds.mean(axis=0), max(ARROW, scene.motion_length) * scene.motion
    axes.quiver(*middle[:2], *way[:2], angles="xy", scale_units="xy", scale=1.0, width=0.006, color=INK, zorder=4)
    axes.plot([], [], color=INK, linewidth=3.0, label="motion")


def _draw_place(axes: Axes, place: Float[np.ndarray, "2"], step: float, scene: Scene) -> None:
    """Draw a ring around the best place, and where an arm faces that stands there."""
    facing = scene.object_in_world().bounds.mean(axis=0)[:2] - place
    ahead = place + 1.2 * step * facing / max(float(np.linalg.norm(facing)), 1e-9)
    axes.plot(*place[:, None], "o", mfc="none", mec=OBJECT, mew=3.0, ms=14.0, zorder=4, label="best place")
    axes.plot(*np.transpose([place, ahead]), color=OBJECT, linewidth=2.0, zorder=4)
