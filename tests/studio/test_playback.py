"""What is played, against the records that were written."""

import numpy as np
import pytest

from dexnudge.errors import InputError
from dexnudge.execution.episode_files import ARRAYS
from dexnudge.studio.content import read_content
from dexnudge.studio.playback import Player, carried, forces_at, frame_at


@pytest.fixture(scope="module")
def content(result):
    return read_content(result)


def test_episodes_inside_a_result_are_found_by_their_folders(content):
    assert list(content.recordings) == ["execution/configuration_000"]


def test_bodies_are_where_the_records_say(content):
    recording = content.recordings["execution/configuration_000"]()
    palms = np.stack([frame.with_role("link")[0].T_world_part for frame in recording.frames])
    assert palms[0] == pytest.approx(content.samples[0].T_world_palm, abs=1e-6)
    assert palms[2, :3, 3] - palms[0, :3, 3] == pytest.approx(0.02 * content.scene.motion, abs=1e-9)
    objects = np.stack([frame.with_role("object")[0].T_world_part for frame in recording.frames])
    assert objects[1, :3, 3] - content.scene.T_world_object[:3, 3] == pytest.approx(0.01 * content.scene.motion)


def test_forces_are_those_of_the_moment(content):
    recording, link = content.recordings["execution/configuration_000"](), content.samples[0].contact_links[0]
    assert [forces_at(recording, frame)[link] for frame in range(3)] == [0.0, 1.5, 2.5]


def test_an_execution_inside_a_result_opens_with_it(result, content):
    inside = read_content(result / "execution")
    assert inside.name == content.name
    assert list(inside.recordings) == ["configuration_000"]


@pytest.mark.parametrize(
    ("seconds", "frame"), [(-1.0, 0), (0.0, 0), (0.019, 0), (0.02, 1), (0.039, 1), (0.04, 2), (9.0, 2)]
)
def test_the_moment_that_is_shown_is_the_last_one_not_later(content, seconds, frame):
    assert frame_at(content.recordings["execution/configuration_000"](), seconds) == frame


def test_a_hand_that_is_carried_goes_along_with_the_object(drawn):
    recording = carried(drawn[0])
    first, last = recording.frames[0], recording.frames[-1]
    for before, after in zip(first.parts, last.parts, strict=True):
        shift = after.T_world_part[:3, 3] - before.T_world_part[:3, 3]
        moves = before.role in ("object", "link", "fingertip", "base")
        assert shift == pytest.approx(
            drawn.scene.motion_length * drawn.scene.motion if moves else np.zeros(3), abs=1e-12
        )


def test_a_player_goes_on_by_the_clock_and_holds_at_the_end(content):
    player = Player()
    player.load("episode", content.recordings["execution/configuration_000"]())
    assert not player.advance(1.0)
    player.speed = 0.5
    player.toggle()
    assert player.advance(0.05)
    assert (player.time, player.frame, player.running) == (pytest.approx(0.025), 1, True)
    assert player.advance(1.0)
    assert (player.time, player.running) == (0.04, False)
    player.toggle()
    assert (player.time, player.running) == (0.0, True)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"T_world_object": np.full((3, 4, 4), np.nan)}, "T_world_object"),
        ({"joint_angles": np.zeros((3, 2))}, "joint_angles"),
        ({"time": np.array([0.0, 0.02, 0.02])}, "time does not ascend"),
        ({"link_names": np.array([1.0, 2.0])}, "link_names"),
        ({"joint_names": np.array([f"j{i}" for i in range(16)])}, "joints"),
        ({"phase": np.array([{}, {}, {}], dtype=object)}, "pickled"),
    ],
)
def test_a_damaged_episode_is_refused_by_name(content, result, tmp_path, change, says):
    with np.load(result / "execution" / "configuration_000" / ARRAYS) as arrays:
        np.savez(tmp_path / ARRAYS, **{**arrays, **change}, allow_pickle=True)
    from dexnudge.studio.playback import episode_recording

    with pytest.raises(InputError, match=says):
        episode_recording(tmp_path, content.scene, content.hand)


def test_a_folder_without_anything_to_show_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds neither"):
        read_content(tmp_path)
