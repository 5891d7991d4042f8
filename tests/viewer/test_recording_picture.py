from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from dexnudge.errors import InputError, OutputError
from dexnudge.viewer.picture import BAD, GOOD, HEAD_HEIGHT
from dexnudge.viewer.recording import _one_number, glass_at, write_recording_pictures

TILE = (120, 90)


@pytest.fixture(scope="module")
def written(recording, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    write_recording_pictures(recording, folder / "film.png", folder / "film.gif", pictures=21, tile=TILE)
    return folder


def frames_of(path):
    with Image.open(path) as animation:
        for index in range(animation.n_frames):
            animation.seek(index)
            yield np.asarray(animation.convert("RGB")).astype(int), animation.info["duration"]


def orange(picture):
    """Where the object is seen."""
    return (picture[..., 0] > 150) & (picture[..., 2] < 90)


def test_the_animation_has_as_many_pictures_as_asked_for_and_runs_at_the_pace_of_the_recording(written):
    pictures, shown = zip(*frames_of(written / "film.gif"), strict=True)
    assert len(pictures) == 21
    assert pictures[0].shape == (90, 120, 3)
    assert set(shown[:-1]) == {100}  # ms: 2 s in 20 steps
    assert shown[-1] == 1500


def test_the_object_moves_in_the_animation_when_it_moves_in_the_recording(written):
    places = [np.argwhere(orange(picture)).mean(axis=0) for picture, _ in frames_of(written / "film.gif")]
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert steps[:10].max() < 0.2  # pixels, until 1 s
    assert steps[10:].min() > 0.5


def test_the_strip_shows_six_moments_side_by_side(written):
    with Image.open(written / "film.png") as picture:
        strip = np.asarray(picture).astype(int)
    width, gap = TILE[0] // 2, 6
    strip = strip[HEAD_HEIGHT:]  # below what it is of
    assert strip.shape == (45, 5 * (width + gap) + width, 3)
    tiles = [strip[:, index * (width + gap) :][:, :width] for index in range(6)]
    places = [np.argwhere(orange(tile)).mean(axis=0) for tile in tiles]
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).min() > 0.5


@pytest.mark.parametrize(("success", "colour"), [(True, GOOD), (False, BAD)])
def test_a_verdict_stands_above_rows_of_three_in_its_colour(recording, tmp_path, success, colour):
    judged = replace(recording, subtitle="the object moved less than 80% of the length; 40 of 100 mm", success=success)
    shown = {"pictures": 2, "moments": judged.eventful(6), "tile": TILE}
    write_recording_pictures(judged, tmp_path / "film.png", tmp_path / "film.gif", **shown)
    with Image.open(tmp_path / "film.png") as picture:
        strip = np.asarray(picture).astype(int)
    assert strip.shape == (HEAD_HEIGHT + 2 * 45 + 6, 3 * 60 + 2 * 6, 3)
    head = strip[:HEAD_HEIGHT]
    ink = head.min(axis=2) < 220
    assert head[ink].mean(axis=0).argmax() == np.argmax(colour)
    assert 100 < np.flatnonzero(ink.any(axis=0))[-1] < strip.shape[1] - 4  # all of it


def test_a_wall_is_glass_from_the_first_to_the_last_time_that_it_hides_something():
    """Of three faces the first never hides, the second at moment 20, the third at 10 and 30."""
    hides = [[False, False, False], [False, False, True], [False, True, False], [False, False, True]]
    hiding = [[np.array(moment)] for moment in hides]
    expected = {0: (0, 0, 1), 5: (0, 0, 1), 10: (0, 1, 1), 20: (0, 1, 1), 25: (0, 1, 1), 30: (0, 0, 1), 35: (0, 0, 1)}
    for index, glass in expected.items():
        (found,) = glass_at(index, np.array([0, 10, 20, 30]), hiding)
        assert tuple(found.astype(int)) == glass, index


def test_what_cannot_be_shown_or_written_is_refused(recording, tmp_path):
    with pytest.raises(InputError, match="an animation of 1 pictures"):
        write_recording_pictures(recording, tmp_path / "film.png", tmp_path / "film.gif", pictures=1)
    short = recording.part(np.array([0, 40]))
    with pytest.raises(OutputError, match=r"cannot write the animation"):
        write_recording_pictures(short, tmp_path / "film.png", tmp_path / "missing" / "film.gif", tile=(64, 48))


def test_an_animation_is_960_pixels_wide_and_gets_fewer_colours_rather_than_too_large(
    recording, size_of_films, tmp_path, monkeypatch
):
    monkeypatch.setattr("dexnudge.viewer.recording.TILE", size_of_films)
    sizes: list[int] = []
    for _ in range(2):
        write_recording_pictures(recording, tmp_path / "film.png", tmp_path / "film.gif", pictures=2)
        sizes.append((tmp_path / "film.gif").stat().st_size)
        monkeypatch.setattr("dexnudge.viewer.recording.LARGEST_FILE", 2 * sizes[0] // 3)
        assert [picture.shape for picture, _ in frames_of(tmp_path / "film.gif")] == [(640, 960, 3)] * 2
    assert sizes[1] <= 2 * sizes[0] // 3


def test_colours_are_sorted_as_rows_are():
    colours = np.random.default_rng(0).integers(0, 256, (5000, 3)).astype(np.uint8) // 32
    rows, first = np.unique(colours, axis=0, return_index=True)
    numbers, first_number = np.unique(_one_number(colours), return_index=True)
    np.testing.assert_array_equal(first_number, first)
    assert numbers.tolist() == [int(red) << 16 | int(green) << 8 | int(blue) for red, green, blue in rows]
