"""`convert` and `benchmark` tell what is wrong in one message, and write nothing then."""

import pytest


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("convert", "here", "--to", "lerobto", "--out", "out"), "unknown format 'lerobto' (did you mean 'lerobot'?)"),
        (("convert", "none", "--to", "usd", "--out", "out"), "none is not a folder"),
        (("convert", "a.npy", "--to", "dexnudge", "--out", "out"), "no --scene is given"),
        (("convert", "here", "--to", "usd", "--scene", "here", "--out", "out"), "--scene is given with the format usd"),
        (("convert", "here", "--to", "usd", "--scale", "nan", "--out", "out"), "--scale is given with the format usd"),
        (
            ("convert", "here", "--to", "usd", "--hand", "allegro", "--out", "out"),
            "--hand is given with the format usd",
        ),
        (("convert", "a.npy", "--to", "dexnudge", "--scene", "here", "--out", "out"), "scene.json"),
        (("benchmark", "make", "smal", "--out", "out"), "unknown suite 'smal' (did you mean 'small'?)"),
        (("benchmark", "make", "bad.yaml", "--out", "out"), "bad.yaml: expected 'key: value' lines, got list"),
        (("benchmark", "make", "broken.yaml", "--out", "out"), "broken.yaml: not a YAML file"),
        (("benchmark", "score", "here", "--suite", "here", "--out", "out"), "benchmark make"),
        (("benchmark", "score", "here", "--suite", "here", "--out", "out", "--workers", "0"), "--workers"),
        (("benchmark",), "expected one of benchmark make, benchmark score"),
    ],
)
def test_bad_input_is_told_in_one_message(arguments, message, dexnudge, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "here").mkdir()
    (tmp_path / "bad.yaml").write_text("[1, 2]")
    (tmp_path / "broken.yaml").write_text("{a: [")
    outcome = dexnudge(*arguments)
    assert outcome.code == 2
    assert message in outcome.err
    assert "Traceback" not in outcome.err
    assert not (tmp_path / "out").exists()
