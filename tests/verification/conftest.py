"""What every depth of is known by hand: the hand of five boxes and a block on a floor."""

from known_depths import block_scene, tip_height, upright  # noqa: F401 - fixtures
