"""The YAML that the documentation shows is one that is read."""

import re
from dataclasses import fields
from pathlib import Path

from dexnudge.hands.config import HandConfig, read_hand_config

PAGE = Path(__file__).parents[2] / "docs" / "hands.md"


def test_the_pages_yaml_is_read_and_shows_every_key(tmp_path):
    block = re.search(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert block is not None
    file = tmp_path / "hand.yaml"
    file.write_text(block[1])
    config = read_hand_config(file)
    assert config.couplings == (("if_j1", "if_j2"),)
    assert set(re.findall(r"^(\w+):", block[1], re.MULTILINE)) == {field.name for field in fields(HandConfig)}
