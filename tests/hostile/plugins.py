"""Hostile packages: entry points that raise, print, end the process, return the wrong thing, or are called anything."""

from __future__ import annotations

import random
import sys
from typing import Any

from hostile.case import CONTROL, MARKUP, MISSING_HAND, Draw, Hostile

sys.path.insert(0, "")  # a command finds packages in its own folder, as `python -m dexnudge` does
GROUPS = {
    "hands": "--hand",
    "scenes": "--scene",
    "energy_terms": "--term",
    "criteria": "--criterion",
    "guidance_rules": "--method",
}
MODULES = {
    "raises at import": "raise ValueError('no')",
    "ends the process at import": "import sys; sys.exit(7)",
    "interrupts nothing": "raise BaseException('no')",
    "recurs": "def f(*a, **k): return f(*a, **k)",
    "raises": "def f(*a, **k): raise RuntimeError('<script>alert(1)</script>')",
    "raises what cannot be told": "class E(Exception):\n    def __str__(self): raise ValueError\ndef f(*a, **k): raise E",
    "says control characters": f"def f(*a, **k): raise ValueError({CONTROL!r})",
    "says 10 MB": "def f(*a, **k): raise ValueError('a' * 10_000_000)",
    "returns None": "def f(*a, **k): return None",
    "returns a number": "f = 5",
    "returns itself": "def f(*a, **k): return f",
    "has no name": "class f:\n    weight = 1.0\n    def __call__(self, *a): return None",
    "has a name of a list": "class f:\n    name, weight = [], 1.0\n    def __call__(self, *a): return None",
    "has a name that raises": "class f:\n    weight = 1.0\n    @property\n    def name(self): raise ValueError\n    def __call__(self, *a): return None",
    "has a tolerance that raises": "class f:\n    name = 'evil'\n    @property\n    def tolerance(self): raise KeyError\n    def __call__(self, *a): return None",
    "has a weight that raises": "class f:\n    name = 'evil'\n    @property\n    def weight(self): raise KeyError\n    def __call__(self, *a): return None",
    "has a signature that raises": "class F:\n    @property\n    def __signature__(self): raise KeyError\n    def __call__(self, *a): return None\nf = F()",
    "has a weight of NaN": "class f:\n    name, weight = 'evil', float('nan')\n    def __call__(self, *a): return None",
    "wants arguments": "def f(a, b, c, d, e): return None",
    "no syntax": "def f(:",
    "not there": "g = 1",
    "NUL": "x = '\0'",
    "no memory": "def f(*a, **k): raise MemoryError",
}  # fmt: skip
NAMES = ("evil", "a b", MARKUP, "contact", "table", "shadow_lite", "é", "a" * 5000, CONTROL.replace("\n", ""), "..")
VALUES = ("evil:f", "evil", "evil:f.g.h", "evil:", ":", "nothing:f", "evil:f [extra]", "os:system", "")


def case(group: str, what: str, name: str = "evil", value: str = "evil:f", *, used: bool = False) -> Hostile:
    """Return the case of a package that registers something in a group, which a command lists or uses."""
    info = "evil-1.0.dist-info"
    files = {
        "evil.py": MODULES[what].encode("utf-8", "surrogatepass"),
        f"{info}/METADATA": b"Metadata-Version: 2.1\nName: evil\nVersion: 1.0\n",
        f"{info}/entry_points.txt": f"[dexnudge.{group}]\n{name} = {value}\n".encode("utf-8", "surrogatepass"),
    }
    use = ("sample", "phone", "--out", "out", f"{GROUPS[group]}={name}")
    arguments: tuple[str, ...] = (
        (*use, *(() if group == "hands" else ("--hand", MISSING_HAND))) if used else ("plugins",)
    )
    expected: Any = "refused" if used and name == "evil" and group != "scenes" else "either"
    return Hostile("plugins", f"{group}: {what}, {name[:20]} = {value}", files, arguments, expected)


def _draw(rng: random.Random) -> Hostile:
    group, what = rng.choice([*GROUPS]), rng.choice([*MODULES])
    return case(group, what, rng.choice(NAMES), rng.choice(VALUES), used=rng.random() < 0.5)


HANDMADE = [case(group, what, used=used) for used in (False, True) for group in GROUPS for what in MODULES]
DRAWS: dict[str, Draw] = {"plugins": _draw}
