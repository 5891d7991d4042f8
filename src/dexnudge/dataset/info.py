"""What a dataset holds, counted: behaviours, rejections, digits, directions."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dexnudge.dataset.manifest import read_manifest
from dexnudge.dataset.schema import BEHAVIOURS, NUM_DIRECTIONS, BehaviourCounts
from dexnudge.dataset.shards import is_complete, read_shard

FEASIBLE_MARGIN = 1.0  # force margin from which a direction of motion counts as feasible


@dataclass(kw_only=True)
class DatasetInfo:
    """Totals over a dataset folder.

    counts: per behaviour; digits_per_configuration: behaviour -> number of digits in contact -> rows;
    digit_use: digit -> rows; feasible_rows: (16) non-prehensile rows whose margin is >= 1 in direction k;
    objects_covered: (16) objects with at least one such row; missing_objects: neither written nor failed.
    """

    hand: str
    num_objects: int
    missing_objects: int
    failed_objects: dict[str, str]
    counts: dict[str, BehaviourCounts]
    digits_per_configuration: dict[str, dict[int, int]] = field(default_factory=dict)
    digit_use: dict[str, int] = field(default_factory=dict)
    feasible_rows: list[int] = field(default_factory=list)
    objects_covered: list[int] = field(default_factory=list)

    @property
    def num_configurations(self) -> int:
        """Kept rows over all behaviours."""
        return sum(count.kept for count in self.counts.values())

    def table(self) -> str:
        """The totals as a plain text table."""
        reasons = sorted({reason for count in self.counts.values() for reason in count.rejected})
        header = ["behaviour", "attempted", "kept", "kept %", "failed", *reasons]
        body = []
        for behaviour, count in self.counts.items():
            share = f"{100.0 * count.kept / count.attempted:.1f}" if count.attempted else "-"
            rejected = [str(count.rejected.get(reason, 0)) for reason in reasons]
            body.append([behaviour, str(count.attempted), str(count.kept), share, str(count.failed), *rejected])
        summary = (
            f"hand {self.hand}: {self.num_configurations} configurations of {self.num_objects} objects "
            f"({self.missing_objects} not generated yet, {len(self.failed_objects)} failed)"
        )
        lines = [
            summary,
            "",
            *_align([header, *body]),
            "",
            *_align(self._digit_lines()),
            "",
            *_align(self._direction_lines()),
        ]
        lines.extend(f"failed object {name}: {reason}" for name, reason in self.failed_objects.items())
        return "\n".join(lines) + "\n"

    def _digit_lines(self) -> list[list[str]]:
        most = max((n for row in self.digits_per_configuration.values() for n in row), default=0)
        header = ["digits in contact", *[str(n) for n in range(most + 1)]]
        body = [
            [behaviour, *[str(row.get(n, 0)) for n in range(most + 1)]]
            for behaviour, row in self.digits_per_configuration.items()
        ]
        use = ["rows using", *[f"{digit}={rows}" for digit, rows in sorted(self.digit_use.items())]]
        return [header, *body, use]

    def _direction_lines(self) -> list[list[str]]:
        step = 360.0 / NUM_DIRECTIONS
        return [
            ["direction [deg]", *[f"{k * step:g}" for k in range(NUM_DIRECTIONS)]],
            ["feasible rows", *[str(rows) for rows in self.feasible_rows]],
            ["objects covered", *[str(objects) for objects in self.objects_covered]],
        ]


def describe(folder: Path | str) -> DatasetInfo:
    """Count what the shards of `folder` hold; raises DatasetError as `read_shard` does."""
    manifest = read_manifest(folder)
    names = [name for name in sorted(manifest.objects) if is_complete(folder, name)]
    counts = {behaviour: BehaviourCounts() for behaviour in BEHAVIOURS}
    digits: dict[str, Counter[int]] = {behaviour: Counter() for behaviour in BEHAVIOURS}
    digit_use: Counter[str] = Counter()
    feasible_rows = np.zeros(NUM_DIRECTIONS, dtype=np.int64)
    objects_covered = np.zeros(NUM_DIRECTIONS, dtype=np.int64)
    for name in names:
        shard = read_shard(folder, manifest, name)
        for behaviour, count in shard.counts.items():
            counts[behaviour] += count
        used = shard.table.column("digits").to_pylist()
        for behaviour, row_digits in zip(shard.table.column("behaviour").to_pylist(), used, strict=True):
            digits[behaviour][len(row_digits)] += 1
            digit_use.update(row_digits)
        feasible = shard.column_matrix("direction_margin") >= FEASIBLE_MARGIN
        feasible_rows += feasible.sum(axis=0)
        objects_covered += feasible.any(axis=0)
    missing = set(manifest.objects) - set(names) - set(manifest.failed_objects)
    return DatasetInfo(
        hand=manifest.hand,
        num_objects=len(names),
        missing_objects=len(missing),
        failed_objects=manifest.failed_objects,
        counts=counts,
        digits_per_configuration={behaviour: dict(sorted(row.items())) for behaviour, row in digits.items()},
        digit_use=dict(digit_use),
        feasible_rows=feasible_rows.tolist(),
        objects_covered=objects_covered.tolist(),
    )


def _align(rows: list[list[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows if k < len(row)) for k in range(max(map(len, rows)))]
    return [
        "  ".join(cell.rjust(widths[k]) if k else cell.ljust(widths[k]) for k, cell in enumerate(row)) for row in rows
    ]
