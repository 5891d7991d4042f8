"""The colours of everything that is drawn, so that pictures and pages agree."""

from typing import Literal

Role = Literal["object", "environment", "base", "link", "fingertip", "glass", "contact", "arrow"]

PALETTE: dict[Role, tuple[float, float, float]] = {  # sRGB, 0..1
    "object": (0.94, 0.42, 0.16),
    "environment": (0.87, 0.84, 0.79),
    "base": (0.80, 0.82, 0.85),
    "link": (0.74, 0.77, 0.81),
    "fingertip": (0.36, 0.62, 0.82),
    "glass": (0.76, 0.82, 0.90),
    "contact": (1.00, 0.87, 0.10),
    "arrow": (0.10, 0.60, 0.38),
}
