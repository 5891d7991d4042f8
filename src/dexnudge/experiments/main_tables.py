"""The tables that a reader sees first: ours beside no prior, and models beside each other."""

from collections.abc import Mapping, Sequence

from dexnudge.experiments.lines import Line
from dexnudge.experiments.markdown import markdown_table
from dexnudge.experiments.method_names import method_name
from dexnudge.experiments.reproduction_parts import MAIN

RATES = ("single", "single robust", "top-ranked", "top-ranked robust")


def main_table(lines: Sequence[Line]) -> str:
    """Rates in percent of what was attempted and speed of the methods in `MAIN`, by scene."""
    rows = [
        [line.scene, method_name(line.method), *_rates(line), *_speed(line)]
        for scene in dict.fromkeys(line.scene for line in lines)
        for method in MAIN
        for line in lines
        if (line.scene, line.method) == (scene, method)
    ]
    return markdown_table(["scene", "method", *RATES, "verified/s", "s per verified"], rows)


def model_table(models: Mapping[str, Sequence[Line]]) -> str:
    """The same rates, by scene and method, one row for each model that has them; `models`: name -> its lines."""
    keys = dict.fromkeys((line.scene, line.method) for lines in list(models.values())[1:] for line in lines)
    rows = [
        [scene, method_name(method), model, *_rates(line), *_speed(line)]
        for scene, method in keys
        for model, lines in models.items()
        for line in lines
        if (line.scene, line.method) == (scene, method)
    ]
    return markdown_table(["scene", "method", "weights", *RATES, "verified/s", "s per verified"], rows, names=3)


def _rates(line: Line) -> list[str]:
    return [rate.percent() for rate in (line.single, line.single_robust, line.top, line.top_robust)]


def _speed(line: Line) -> list[str]:
    return [line.verified_per_second.text(1), line.verified_per_second.inverse().text()]
