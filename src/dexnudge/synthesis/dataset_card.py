"""The description of a dataset: every figure counted in the data, every criterion read from code.

Sections after Pushkarna et al., Data Cards (FAccT 2022): what it is, how it was made, what a row means, where it ends.
`dataset info` prints it, `README.md` in the dataset's folder is its card, `dataset_page` draws it.
"""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import yaml

from dexnudge.dataset.document import Document, Section, Table
from dexnudge.dataset.info import FEASIBLE_MARGIN, DatasetInfo, describe
from dexnudge.dataset.manifest import Manifest
from dexnudge.dataset.schema import (
    CLOUD_POINTS,
    FORMAT_VERSION,
    NUM_DIRECTIONS,
    RESTING_FRAME,
    cloud_schema,
    configuration_schema,
)
from dexnudge.errors import InputError
from dexnudge.jobs.atomic_files import replace_atomically
from dexnudge.mechanics.balance import MAX_FACTOR
from dexnudge.mechanics.contacts import HAND_CONTACT_DISTANCE
from dexnudge.objects.builtin import is_builtin
from dexnudge.objects.sets import BUILTIN_PREFIX, object_mesh, resolve_object_set
from dexnudge.scenes.scene import FRICTION_ENVIRONMENT, FRICTION_HAND, MASS, MAX_NORMAL_FORCE
from dexnudge.simulation import hold, model
from dexnudge.synthesis.acceptance import PRESSING, TABLE_EDGE
from dexnudge.synthesis.object_data import mesh_hash
from dexnudge.verification.criteria import PENETRATION_LIMIT
from dexnudge.verification.solids import SURFACE_SPACING

CARD_FILE = "README.md"
TAGS = ["robotics", "dexterous-manipulation", "non-prehensile", "grasping", "robot-hand"]
SIZES = (  # as the Hugging Face hub names them: rows below which each holds
    *((1000 * 10**k, name) for k, name in enumerate(("n<1K", "1K<n<10K", "10K<n<100K", "100K<n<1M", "1M<n<10M"))),
    (np.inf, "n>10M"),
)
_LOAD = """import dexnudge as dn

dataset = dn.load_dataset(FOLDER)
print(dataset.q.shape, dataset.direction_margin.shape, dataset.clouds.shape)
print(dataset.object_names[dataset.object_index[0]], dataset.manifest.joint_names)
"""
_READ = """from pathlib import Path
import numpy as np, pyarrow as pa, pyarrow.parquet as pq

rows = pa.concat_tables(pq.read_table(file) for file in sorted(Path(FOLDER).glob("shard-*.parquet")))
q = np.stack(rows["q"].to_numpy())
"""
PURPOSE = """\
Poses and joint angles of a robot hand that push, press or hook a thin object at rest on a plane, or grasp it in free \
space; each one verified against penetration and for its contact forces."""
TURNING = f"""\
Turns: `turn` in place about the vertical through the centre of mass; `tip` over the edge of its own supports that faces \
the heading; `edge` over the straight edge of a table that ends {100 * TABLE_EDGE:g} % of the way from the centre of mass \
to the farthest support. Each shard's header holds their twists, linear at the origin and angular, in the resting frame."""
FILES = """\
`FOLDER` is the folder of this file. `manifest.json` names the hand, the joints in the order of `q` and the SHA-256 of each \
object's mesh."""
LOADING = (
    "With dexnudge, as arrays:",
    f"```python\n{_LOAD}```",
    "With pyarrow alone:",
    f"```python\n{_READ}```",
    FILES,
)


def write_card(folder: Path | str) -> Path:
    """Write the data card into a dataset's folder and return its path; the same data give the same bytes.

    Raises:
        DatasetError: the dataset is missing or damaged.
        OutputError: the folder cannot be written.
    """
    path = Path(folder) / CARD_FILE
    info = describe(folder)
    with replace_atomically(path) as temporary:
        text = front_matter(info) + description(info).markdown()
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")
    return path


def front_matter(info: DatasetInfo) -> str:
    """Return the YAML block at the card's head by which a hub lists, filters and shows the dataset.

    The licence stands there only where all objects are built in: others have their own.
    """
    size = next(name for most, name in SIZES if info.num_configurations < most)
    objects = {"config_name": "objects", "data_files": [{"split": "train", "path": "object-*.parquet"}]}
    rows = {"config_name": "configurations", "data_files": [{"split": "train", "path": "shard-*.parquet"}]}
    content: dict[str, Any] = {"license": "mit"} if builtin_set(info.manifest) else {}
    content |= {
        "pretty_name": f"Hand configurations for {info.manifest.hand}",
        "task_categories": ["robotics"],
        "tags": TAGS,
        "size_categories": [size],
        "configs": [{**rows, "default": True}, objects],
    }
    return f"---\n{yaml.safe_dump(content, sort_keys=False)}---\n"


def description(info: DatasetInfo) -> Document:
    """Return the description of a dataset, for the card and the page."""
    failed = [f"- failed object {name}: {reason}" for name, reason in info.manifest.failed_objects.items()]
    coverage = [table for name, table in info.tables.items() if name != "counts"]
    return Document(
        f"Hand configurations for {info.manifest.hand}",
        f"hand {info.manifest.hand}: {info.num_configurations} configurations of {info.num_objects} objects "
        f"({info.missing_objects} not generated yet, {len(info.manifest.failed_objects)} failed), "
        f"{info.bytes_on_disk / 1e6:.1f} MB on disk, {info.bytes_per_row:.0f} bytes per row of the shards",
        (
            Section("What it is", (PURPOSE, _facts(info))),
            Section("Counts", (info.tables["counts"], "attempted = kept + rejected + failed.")),
            Section("What a row is", _columns(info.manifest)),
            Section("What was verified", (*_criteria(), _holding(info))),
            Section("Coverage", (*coverage, *(["\n".join(failed)] if failed else []))),
            Section("How to load it", LOADING),
            Section("How it was made", _making(info.manifest)),
            Section("Known limitations", (_limitations(info),)),
        ),
    )


def builtin_set(manifest: Manifest) -> str | None:
    """Return the built-in set whose objects these are, all or so many of them; None where they come from elsewhere.

    Names decide, and the mesh of the first object: files may have the names of built-in objects.
    """
    names = {*manifest.objects, *manifest.failed_objects}
    length = manifest.config.get("length")
    name, digest = next(((name, digest) for name, digest in manifest.objects.items() if digest), ("", None))
    if is_builtin(name):
        mesh = object_mesh(name, length=length if isinstance(length, int | float) else None)
        if mesh_hash(mesh) != digest:
            return None
    sets = [f"{BUILTIN_PREFIX}{kind}{some}" for kind in ("train", "test") for some in ("", f":{len(names)}")]
    return next((each for each in sets if names == _names_of(each)), None)


def _names_of(objects: str) -> set[str]:
    try:
        return {entry.name for entry in resolve_object_set(objects)}
    except InputError:  # the set has fewer objects
        return set()


def _facts(info: DatasetInfo) -> str:
    manifest = info.manifest
    kinds = Counter(name.partition("-")[0] for name in manifest.objects)
    if builtin_set(manifest):
        objects = (
            f"the {builtin_set(manifest)} set ({', '.join(f'{count} {kind}' for kind, count in sorted(kinds.items()))}): "
            "made by a program from their names, nothing was scanned or copied"
        )
        licence = "MIT, as dexnudge itself"
    else:
        objects = "mesh files of whoever generated this dataset"
        licence = (
            "of the rows: MIT, as dexnudge itself; of the surface points: that of the mesh files they were taken from"
        )
    behaviours = ", ".join(f"{count.kept} {behaviour}" for behaviour, count in info.counts.items())
    return (
        f"- {info.num_configurations} configurations: {behaviours}\n"
        f"- hand: {manifest.hand}, {len(manifest.joint_names)} joint angles, digits {', '.join(manifest.joint_groups)}\n"
        f"- {info.num_objects} objects, {info.missing_objects} not generated yet, {len(manifest.failed_objects)} failed; "
        f"{objects}\n"
        f"- {info.bytes_on_disk} bytes in all: shards, {info.bytes_per_row:.0f} per configuration; surface points of the "
        "objects; the manifest\n"
        f"- licence: {licence}\n"
        f"- format version {FORMAT_VERSION}"
    )


def _columns(manifest: Manifest) -> tuple[str | Table, ...]:
    schemas = {
        "`shard-OBJECT.parquet`, one row for each configuration": configuration_schema(len(manifest.joint_names)),
        f"`object-OBJECT.parquet`, {CLOUD_POINTS} points of the object's surface": cloud_schema(),
    }
    header = ("column", "type", "unit", "frame", "meaning")
    tables = [
        Table(title, header, tuple((f"`{field.name}`", _type(field.type), *_said(field.metadata)) for field in schema))
        for title, schema in schemas.items()
    ]
    return (
        *tables,
        f"Frame `resting`: {RESTING_FRAME}.",
        TURNING,
        f"Joint angles in `q`, in this order: {', '.join(manifest.joint_names)}.",
    )


def _type(kind: pa.DataType) -> str:
    """Type and shape of one cell, as numpy would write it."""
    if pa.types.is_fixed_size_list(kind):
        return f"{_type(kind.value_type)}[{kind.list_size}]"
    return f"list of {_type(kind.value_type)}" if pa.types.is_list(kind) else str(kind)


def _said(metadata: dict[bytes, bytes]) -> tuple[str, str, str]:
    unit, frame, meaning = (metadata[key].decode() for key in (b"unit", b"frame", b"description"))
    return unit, "resting" if frame == RESTING_FRAME else frame, meaning


def _criteria() -> tuple[str, ...]:
    geometry = (
        "The verification does not share its geometry with what generates: exact mesh distance, points at most "
        f"{1e3 * SURFACE_SPACING:g} mm apart, both ways. Kept is what meets all of these:"
    )
    conditions = f"""\
- penetration of object, plane and the hand itself at most {1e3 * PENETRATION_LIMIT:g} mm each
- contact: a surface of the hand that faces the object within {1e3 * HAND_CONTACT_DISTANCE:g} mm
- push, press, hook: a force margin of {FEASIBLE_MARGIN:g} or more in at least one of {NUM_DIRECTIONS} directions or, \
where they were judged, turns. The \
margin is the largest factor on the friction of the plane with which contact forces within their cones and limits still \
balance the moving object; it ends at {MAX_FACTOR:g}
- for these forces: friction {FRICTION_HAND:g} of the hand and {FRICTION_ENVIRONMENT:g} of the plane, mass {MASS:g} kg, \
at most {MAX_NORMAL_FORCE:g} N normal force for each link"""
    behaviours = (
        f"A row is a press where the contacts' mean normal has a vertical part above {PRESSING:g}; otherwise a hook where "
        "the palm's origin lies ahead of the object in the direction with the greatest margin, else a push."
    )
    return geometry, conditions, behaviours


def _holding(info: DatasetInfo) -> str:
    """How grasps were held in simulation, where the rows say that they were."""
    if not info.num_held:
        return "No row was held in simulation: `hold_translation` and `hold_rotation` are null throughout."
    return (
        f"{info.num_held} of {info.counts['grasp'].kept} grasps were held in MuJoCo against a pull of {hold.PULL:g} N in "
        f"{len(hold.DIRECTIONS)} directions, one after the other, on an object of {model.GRASP_MASS:g} kg with friction "
        f"{model.GRASP_FRICTION:g}; it moved by less than "
        f"{1e3 * hold.FARTHEST:g} mm and {np.degrees(hold.MOST_TURNED):g} degrees."
    )


def _making(manifest: Manifest) -> tuple[str, ...]:
    settings = {"objects": builtin_set(manifest) or "SET", **manifest.config, "seed": manifest.seed}
    options = " ".join(f"--{name.replace('_', '-')} {value}" for name, value in settings.items() if value is not None)
    versions = ", ".join(f"{name} {version}" for name, version in sorted(manifest.versions.items()))
    repeat = (
        "Same machine, same versions, same command: same rows, whatever the number of workers. "
        f"Versions: {versions or 'not recorded'}."
    )
    return f"```\ndexnudge dataset generate {options} --out FOLDER\n```", repeat


def _limitations(info: DatasetInfo) -> str:
    def without_row(table: Table) -> list[str]:
        return [name for k, name in enumerate(table.header) if k and not any(row[k] for row in table.rows)]

    found = {
        "behaviours without a row": [behaviour for behaviour, count in info.counts.items() if not count.kept],
        "faces that no push, press or hook touches": without_row(info.tables["face_objects"]),
        "digits that no row uses": without_row(info.tables["digits"]),
        "objects that failed": sorted(info.manifest.failed_objects),
    }
    feasible = info.tables["directions"].row("rows").values()
    lines = [f"{what}: {', '.join(names)}" for what, names in found.items() if names]
    lines += [
        f"the {NUM_DIRECTIONS} directions are feasible in {min(feasible)} to {max(feasible)} rows each",
        "forces are quasi-static; margins hold for one mass and one pair of frictions, and say nothing of impacts",
        "non-prehensile rows know no surroundings but a plane; grasps know none",
        "the yaw of an object at rest is that of its mesh laid down: turn rows about the vertical to train for any yaw",
        "where directions share the greatest margin, the middle of their widest arc tells push from hook",
    ]
    return "\n".join(f"- {line}" for line in lines)
