"""A block of a phone's size on a plane, and contacts on it."""

from collections.abc import Callable

import numpy as np
import pytest

from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.sliding_task import SlidingTask
from dexnudge.scenes.motion import Twist
from dexnudge.scenes.support_contacts import SupportContacts

LENGTH, WIDTH, HEIGHT = 0.16, 0.08, 0.02
FACES = np.array([[-1.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]])


def slide(*motion: float) -> Twist:
    return Twist(np.array(motion), np.zeros(3))


@pytest.fixture
def task() -> SlidingTask:
    """The block's centre is the origin; it is to move along x, with the default physics."""
    return SlidingTask(
        centre=np.zeros(3),
        half_length=LENGTH / 2,
        mass=0.15,
        twist=slide(1.0, 0.0, 0.0),
        friction_hand=0.8,
        friction_environment=0.4,
        max_normal_force=5.0,
    )


@pytest.fixture
def floor() -> SupportContacts:
    """The four lower corners."""
    corners = [[x, y, -HEIGHT / 2] for x in (-LENGTH / 2, LENGTH / 2) for y in (-WIDTH / 2, WIDTH / 2)]
    return SupportContacts(points=np.array(corners), normals=np.tile([0.0, 0.0, 1.0], (4, 1)))


@pytest.fixture
def contact() -> Callable[..., HandContacts]:
    """Makes contacts of one link each from (point, outward normal) pairs."""

    def make(*pairs: tuple[list[float], list[float]]) -> HandContacts:
        points, normals = zip(*pairs, strict=True)
        return HandContacts(
            points=np.array(points, dtype=float), normals=np.array(normals, dtype=float), link=np.arange(len(pairs))
        )

    return make


@pytest.fixture
def random_contacts() -> Callable[..., HandContacts]:
    """Draws contacts of 1 to 6 links, each with 1 to 4 points on one face; normals exact or tilted."""

    def draw(rng: np.random.Generator) -> HandContacts:
        half = np.array([LENGTH, WIDTH, HEIGHT]) / 2
        tilt = rng.choice([0.0, 0.2])
        points, normals, links = [], [], []
        for link in range(rng.integers(1, 7)):
            face = FACES[rng.integers(len(FACES))]
            axis = int(np.argmax(np.abs(face)))
            middle = rng.uniform(-half, half)
            for _ in range(rng.integers(1, 5)):
                point = np.clip(middle + rng.normal(0, 0.004, 3), -half, half)
                point[axis] = face[axis] * half[axis]
                normal = face + rng.normal(0, tilt, 3)
                points.append(point)
                normals.append(normal / np.linalg.norm(normal))
                links.append(2 * link + 1)
        return HandContacts(points=np.array(points), normals=np.array(normals), link=np.array(links))

    return draw
