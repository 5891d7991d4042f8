"""The totals of a dataset as tables: the same ones in the terminal, on the page and in the data card."""

from dataclasses import dataclass

import numpy as np

from dexnudge.dataset.info import DatasetInfo, Histogram
from dexnudge.dataset.schema import direction_angles


@dataclass(frozen=True)
class Table:
    """Rows of cells under a header; the first column is text, so are the others unless `numeric`. A row may be short."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: bool = True

    def text(self) -> str:
        """Columns aligned by spaces; the title stands over the first column."""
        lines = [(self.title, *self.header[1:]), *self.rows]
        widths = [max(len(line[k]) for line in lines if k < len(line)) for k in range(max(map(len, lines)))]
        aligned = (
            "  ".join(cell.rjust(widths[k]) if k else cell.ljust(widths[k]) for k, cell in enumerate(line))
            for line in lines
        )
        return "\n".join(line.rstrip() for line in aligned) + "\n"

    def markdown(self) -> str:
        """A table in GitHub's Markdown."""
        width = len(self.header)
        lines = [self.header, ("---", *["---:" if self.numeric else "---"] * (width - 1))]
        lines += [(*row, *[""] * (width - len(row))) for row in self.rows]
        return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines) + "\n"


QUANTILE_NAMES = ("least", "5 %", "median", "95 %", "greatest")


def summary(info: DatasetInfo) -> str:
    """One line: how much of what."""
    return (
        f"hand {info.manifest.hand}: {info.num_configurations} configurations of {info.num_objects} objects "
        f"({info.missing_objects} not generated yet, {len(info.manifest.failed_objects)} failed), "
        f"{info.bytes_on_disk / 1e6:.1f} MB on disk, {info.bytes_per_row:.0f} bytes per row"
    )


def report(info: DatasetInfo) -> str:
    """The summary and all tables as plain text."""
    failed = [f"failed object {name}: {reason}\n" for name, reason in info.manifest.failed_objects.items()]
    return summary(info) + "\n\n" + "\n".join([*(table.text() for table in tables(info)), *failed])


def tables(info: DatasetInfo) -> tuple[Table, ...]:
    """All tables, in the order in which they are shown."""
    histograms = [table for histogram in info.histograms for table in histogram_tables(histogram)]
    return (counts_table(info), *coverage_tables(info), *histograms, joints_table(info))


def counts_table(info: DatasetInfo) -> Table:
    """What became of every attempt."""
    reasons = sorted({reason for count in info.counts.values() for reason in count.rejected})
    rows = []
    for behaviour, count in info.counts.items():
        share = f"{100.0 * count.kept / count.attempted:.1f}" if count.attempted else "-"
        rejected = [str(count.rejected.get(reason, 0)) for reason in reasons]
        rows.append((behaviour, str(count.attempted), str(count.kept), share, str(count.failed), *rejected))
    header = ("behaviour", "attempted", "kept", "kept %", "failed", *(f"rejected: {reason}" for reason in reasons))
    return Table("behaviour", header, tuple(rows))


def coverage_tables(info: DatasetInfo) -> tuple[Table, ...]:
    """Digits, directions, sides and the palm's place: rows, and objects where it matters."""
    angles = tuple(f"{angle:g}" for angle in np.degrees(direction_angles()).round(6))
    directions = Table(
        "feasible direction [deg]",
        ("non-prehensile", *angles),
        (
            ("rows", *map(str, info.feasible_rows)),
            ("objects", *map(str, info.objects_covered)),
        ),
    )
    sides = _by_behaviour("rows that touch the side", info.side_rows)
    touched = ("objects, non-prehensile", *(str(info.side_objects[side]) for side in sides.header[1:]))
    return (
        _by_behaviour("rows by digits in contact", info.digits_per_configuration),
        _by_behaviour("rows that use the digit", info.digit_use),
        directions,
        Table(sides.title, sides.header, (*sides.rows, touched)),
        _by_behaviour("rows by where the palm stands", info.octant_rows),
    )


def histogram_tables(histogram: Histogram) -> tuple[Table, Table]:
    """Rows by bin, each bin headed by its lower edge, and the quantiles."""
    groups = histogram.counts.items()
    bins = Table(
        f"{histogram.title} from",
        ("rows", *(f"{edge:.4g}" for edge in histogram.edges[:-1])),
        tuple((label, *map(str, counts.tolist())) for label, counts in groups),
    )
    quantiles = Table(
        histogram.title,
        ("behaviour", *QUANTILE_NAMES),
        tuple((label, *(f"{value:.3g}" for value in values)) for label, values in histogram.quantiles.items()),
    )
    return bins, quantiles


def joints_table(info: DatasetInfo) -> Table:
    """Which part of its range each joint uses: in percent of the range where the limits are known, and in degrees."""
    header = ["joint", "least [deg]", "median [deg]", "greatest [deg]"]
    cells = [[f"{angle:.1f}" for angle in row] for row in np.degrees(info.joint_angles)]
    if info.joint_limits is not None:
        lower, span = info.joint_limits[:, :1], np.ptp(info.joint_limits, axis=1, keepdims=True)
        header += ["least [% of range]", "median [% of range]", "greatest [% of range]"]
        for row, shares in zip(cells, 100.0 * (info.joint_angles - lower) / span, strict=True):
            row += [f"{share:.0f}" for share in shares.round() + 0.0]  # no "-0"
    rows = tuple((name, *row) for name, row in zip(info.manifest.joint_names, cells, strict=True))
    return Table("joint", tuple(header), rows)


def _by_behaviour(title: str, counts: dict[str, dict[str, int]]) -> Table:
    kinds = tuple(next(iter(counts.values()), {}))
    rows = tuple((behaviour, *(str(row[kind]) for kind in kinds)) for behaviour, row in counts.items())
    return Table(title, ("behaviour", *kinds), rows)
