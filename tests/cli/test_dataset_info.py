"""`dataset generate` writes a card, `dataset info --out` a page, both with the numbers of the rows."""

import pyarrow.parquet as pq
import pytest

from dexnudge.objects.builtin import builtin_object


@pytest.mark.slow
def test_card_and_page_of_a_generated_dataset(dexnudge, tmp_path):
    objects, data, out = (tmp_path / name for name in ("objects", "data", "out"))
    objects.mkdir()
    builtin_object("remote-203").export(objects / "control.obj")
    attempts = ["--non-prehensile", "64", "--grasps", "32", "--workers", "1"]
    generated = dexnudge("dataset", "generate", "--objects", objects, "--out", data, *attempts)
    assert generated.code == 0
    page = f"dexnudge dataset info {data} --objects {objects} --out NAME"
    assert generated.out.endswith(f"{data / 'README.md'}; as a page: {page}\n")
    rows = pq.read_table(data / "shard-control.parquet").to_pylist()
    assert len(rows) > 10

    card = (data / "README.md").read_text(encoding="utf-8")
    assert f"- {len(rows)} configurations: " in card
    assert "--non-prehensile 64 --grasps 32 --upright 0.0 --seed 0" in card

    outcome = dexnudge("dataset", "info", data, "--objects", objects, "--out", out)
    assert outcome.out.startswith(f"hand shadow_lite: {len(rows)} configurations of 1 objects")
    assert len(outcome.out.split("\nwrote ")[0].splitlines()) <= 10
    shown = {line.split()[1]: line.split("│") for line in outcome.out.splitlines() if line.startswith("│")}
    for name in ("push", "press", "hook", "grasp"):
        assert int(shown[name][3]) == sum(row["behaviour"] == name for row in rows)
    assert f"{data / 'README.md'}\n\nwrote {out / 'dataset.html'}\n" in outcome.out
    behaviours = {row["behaviour"] for row in rows}
    assert {path.name for path in out.iterdir()} == {"dataset.html", *(f"samples-{name}.png" for name in behaviours)}
    page = (out / "dataset.html").read_text(encoding="utf-8")
    shown = {name: min(5, sum(row["behaviour"] == name for row in rows)) for name in behaviours}
    assert page.count('src="data:image/png') == sum(shown.values())

    asked = dexnudge("dataset", "info", data).out
    assert asked.endswith(f"; as a page: dexnudge dataset info {data} --objects SET --out NAME\n")

    refused = dexnudge("dataset", "info", data, "--out", out)
    assert refused.code == 2
    assert "the mesh of 'control' is not in the built-in objects" in refused.err
