"""One HTML file that shows a hand in 3-D, with a slider for each joint."""

from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.hands.closing import closing
from dexnudge.hands.hand import Hand
from dexnudge.viewer.camera import framing_camera
from dexnudge.viewer.hand_view import hand_legend, hand_summary, hand_views, palm_in_view
from dexnudge.viewer.page import write_template
from dexnudge.viewer.page_data import ASPECT, page_data

AZIMUTH, ELEVATION = np.radians(35.0), np.radians(18.0)  # of the first view, onto the palm's face from aside


def write_hand_page(hand: Hand, path: Path | str) -> Path:
    """Write the page: a 3-D view, a slider for each joint, and buttons for the rest, open and closed pose.

    Raises:
        OutputError: the file cannot be written.
    """
    found = closing(hand)
    poses = {"rest": found.rest, "open": found.open, "closed": found.closed}
    buttons = "".join(f'<button type="button">{name}</button>' for name in poses)
    sliders = "\n".join(
        f'<label class="control"><span>{escape(name)}</span>'
        f'<input type="range" min="{lower:.6g}" max="{upper:.6g}" step="any"><output></output></label>'
        for name, lower, upper in zip(hand.joint_names, hand.lower, hand.upper, strict=True)
    )
    return write_template(
        path,
        "hand",
        _hand_data(hand, poses),
        hand_legend(hand),
        title=escape(hand.name),
        subtitle=hand_summary(hand),
        buttons=buttons,
        sliders=sliders,
    )


def _hand_data(hand: Hand, poses: dict[str, Float[np.ndarray, " joint"]]) -> dict[str, Any]:
    """Return what `page_data` has of the hand, with its tree and what its joints do; see `Joint`.

    root: pose of the palm's frame in the view (3 x 4, row by row); body_links: of each body the link that carries it,
    null for the arrow.
    """
    views = hand_views(hand, list(poses.values()))
    seen = np.concatenate([view.vertices("link", "fingertip", "arrow") for view in views])
    camera = framing_camera(seen, azimuth=AZIMUTH, elevation=ELEVATION, aspect=ASPECT)
    names = {name: index for index, name in enumerate(hand.link_names)}
    links: list[dict[str, Any]] = [{"parent": -1}]
    for parent, joint in zip(hand.link_parent[1:].tolist(), hand.joints[1:], strict=True):
        assert joint is not None
        links.append(
            {
                "parent": parent,
                "origin": joint.origin[:3].reshape(-1).tolist(),
                "axis": joint.axis.tolist(),
                "slides": joint.slides,
                "index": joint.index,
                "multiplier": joint.multiplier,
                "offset": joint.offset,
            }
        )
    return {
        **page_data(views[:1], camera=camera),
        "root": palm_in_view(hand)[:3].reshape(-1).tolist(),
        "links": links,
        "body_links": [names.get(part.name) if part.role != "arrow" else None for part in views[0].parts],
        "joints": [{"slides": bool(slides)} for slides in hand.sliding],
        "couplings": hand.coupled_indices.tolist(),
        "poses": [{"name": name, "angles": angles.tolist()} for name, angles in poses.items()],
    }
