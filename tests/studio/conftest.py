"""A result folder with an execution, a studio without a browser, and the driver of one."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser", reason="the studio needs viser: pip install 'dexnudge[studio]'")

import dexnudge as dn
from dexnudge.execution.episode_files import ARRAYS, FIGURES


@pytest.fixture(scope="session")
def drawn(shadow_hand) -> dn.Samples:
    """Eight draws for a phone on a table."""
    return dn.Sampler(shadow_hand).sample(dn.build_scene("table", "phone", seed=0), num=8, seed=1)


@pytest.fixture(scope="session")
def result(drawn: dn.Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Those, saved; an execution inside; the folder's name is markup."""
    folder = tmp_path_factory.mktemp("studio") / "<b>phone<b>"
    samples = drawn.save(folder)
    write_episode(folder / "execution" / "configuration_000", samples)
    return folder


def write_episode(folder: Path, samples: dn.Samples) -> None:
    """Write an episode of three records in which the best hand and the object go 10 mm along the motion each time."""
    best, scene, hand = samples[0], samples.scene, samples.hand
    folder.mkdir(parents=True)
    (folder / FIGURES).write_text('{"sentence": "success"}')
    palms, objects = np.tile(best.T_world_palm, (3, 1, 1)), np.tile(scene.T_world_object, (3, 1, 1))
    for poses in (palms, objects):
        poses[:, :3, 3] += 0.01 * np.arange(3)[:, None] * scene.motion
    force = np.zeros((3, len(hand.link_names)))
    force[1:, hand.link_names.index(best.contact_links[0])] = [1.5, 2.5]
    np.savez(
        folder / ARRAYS,
        time=np.array([0.0, 0.02, 0.04]),
        phase=np.array(["settle", "push", "push"]),
        joint_names=np.array(hand.joint_names),
        joint_angles=np.tile(best.q[9:].astype(np.float64), (3, 1)),
        T_world_palm=palms,
        T_world_object=objects,
        link_names=np.array(hand.link_names),
        link_force=force,
    )


@pytest.fixture
def studio(result: Path, tmp_path: Path) -> Iterator:
    """A studio that shows the result, and saves below the test's folder."""
    from dexnudge.studio.studio import Studio

    opened = Studio(result, port=0, out=tmp_path / "out")
    yield opened
    opened.close()
