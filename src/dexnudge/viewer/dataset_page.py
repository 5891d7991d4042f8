"""One HTML file about a dataset: pictures of random rows, charts and tables; no server, no internet, no script."""

import base64
import io
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from dexnudge.dataset.atomic import replace_atomically
from dexnudge.dataset.info import DatasetInfo
from dexnudge.dataset.info_tables import coverage_tables, summary, tables
from dexnudge.dataset.schema import BEHAVIOURS
from dexnudge.dataset.tables import Table
from dexnudge.viewer.bar_chart import bar_chart, range_chart
from dexnudge.viewer.dataset_samples import Sample
from dexnudge.viewer.picture import write_png
from dexnudge.viewer.sheet import arrange

PAGE_FILE = "dataset.html"
CAPTION_ROOM = 0.22  # of a picture's height: white above it on a sheet, for two lines of text


def write_dataset_page(info: DatasetInfo, samples: list[Sample], folder: Path | str) -> list[Path]:
    """Write `dataset.html`, and for each behaviour that has samples a sheet `samples-<behaviour>.png`.

    Returns:
        The page's path, then the sheets'.

    Raises:
        OutputError: the folder cannot be written.
    """
    folder = Path(folder)
    package = files("dexnudge.viewer")
    page = Template((package / "dataset_page.html").read_text(encoding="utf-8")).substitute(
        title=escape(f"Dataset of the hand {info.manifest.hand}"),
        summary=escape(summary(info)),
        samples="\n".join(_section(behaviour, samples) for behaviour in BEHAVIOURS),
        charts="\n".join(_charts(info)),
        tables="\n".join(_table(table) for table in tables(info)),
    )
    with replace_atomically(folder / PAGE_FILE) as temporary:
        temporary.write_text(page, encoding="utf-8")
    written = [folder / PAGE_FILE]
    for behaviour in BEHAVIOURS:
        shown = [sample for sample in samples if sample.behaviour == behaviour]
        if shown:
            written.append(write_png(_sheet(shown), folder / f"samples-{behaviour}.png"))
    return written


def _sheet(samples: list[Sample]) -> UInt8[np.ndarray, "height width 3"]:
    room = round(CAPTION_ROOM * samples[0].picture.shape[0])
    pictures = [np.pad(sample.picture, ((room, 0), (0, 0), (0, 0)), constant_values=255) for sample in samples]
    return arrange(pictures, ["\n".join(sample.caption) for sample in samples], columns=len(samples))


def _section(behaviour: str, samples: list[Sample]) -> str:
    shown = [sample for sample in samples if sample.behaviour == behaviour]
    if not shown:
        return f"<h2>{escape(behaviour)}</h2>\n<p>no rows</p>"
    figures = "\n".join(
        f'<figure><img alt="{escape(behaviour)}: {escape(", ".join(sample.caption))}" src="{_data_url(sample.picture)}">'
        f"<figcaption>{'<br>'.join(map(escape, sample.caption))}</figcaption></figure>"
        for sample in shown
    )
    return f'<h2>{escape(behaviour)}: random samples</h2>\n<div class="samples">\n{figures}\n</div>'


def _charts(info: DatasetInfo) -> list[str]:
    """The histograms, what of the coverage is counted by behaviour, the directions, and the joints' ranges."""
    charts = [
        bar_chart(
            histogram.title,
            [f"{edge:.4g}" for edge in histogram.edges[:-1]],
            {label: counts.tolist() for label, counts in histogram.counts.items()},
        )
        for histogram in info.histograms
    ]
    for table in coverage_tables(info):
        rows = {row[0]: [int(cell) for cell in row[1:]] for row in table.rows}
        counted = {label: counts for label, counts in rows.items() if label in (*BEHAVIOURS, "rows")}
        charts.append(bar_chart(table.title, table.header[1:], counted))
    if info.joint_limits is not None and info.num_configurations:
        lower, upper = info.joint_limits[:, :1], info.joint_limits[:, 1:]
        shares = np.clip((info.joint_angles - lower) / (upper - lower), 0.0, 1.0)
        ranges = [(float(low), float(middle), float(high)) for low, middle, high in shares]
        charts.append(range_chart("joint angles within their limits", info.manifest.joint_names, ranges))
    return charts


def _table(table: Table) -> str:
    header = "".join(f"<th>{escape(cell)}</th>" for cell in (table.title, *table.header[1:]))
    rows = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>\n" for row in table.rows)
    return f'<div class="scroll"><table><thead><tr>{header}</tr></thead>\n<tbody>\n{rows}</tbody></table></div>'


def _data_url(picture: UInt8[np.ndarray, "height width 3"]) -> str:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, format="PNG", optimize=False)
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode("ascii")
