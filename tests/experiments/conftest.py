"""What every depth of is known by hand: the hand of five boxes and a block on a floor; and made-up records."""

from collections.abc import Callable

import pytest

from dexnudge.experiments.execution_trial import ExecutedDraw
from dexnudge.experiments.sampling_records import SamplingRecord
from known_depths import block_scene, tip_height, upright  # noqa: F401 - fixtures


@pytest.fixture
def sampled() -> Callable[..., SamplingRecord]:
    """Makes the record of a sampling trial from what differs."""

    def make(name: str, success: list[bool], margin: list[float], **given: object) -> SamplingRecord:
        rejected = {"force": success.count(False)} if False in success else {}
        options = {"scene": "table", "method": "steered_noise", "seed": 0, "num": len(success), "rejected": rejected}
        options |= {"own_rank": list(range(len(success))), "penetration_mm": [0.0] * len(success)}
        return SamplingRecord(
            object=name, success=success, force_margin=margin, verified=sum(success), **{**options, **given}
        )

    return make


@pytest.fixture
def four_records(sampled) -> list[SamplingRecord]:
    """Four objects of four draws each, one of which failed; every figure of theirs is easily found by hand."""
    spent = {"seconds": {"load": 9.0, "prepare": 0.5, "draw": 1.0, "verify": 0.5}}
    margins = [3.0, 1.6, 1.2, 2.9], [1.2, 0.5, 0.5, 0.5], [0.5] * 4
    a = sampled(
        "a", [True, True, True, False], margins[0], own_rank=[1, 0, 2, 3], penetration_mm=[0.0, 0.0, 0.5, 2.0], **spent
    )
    b = sampled(
        "b",
        [True, False, False, False],
        margins[1],
        own_rank=[3, 2, 1, 0],
        penetration_mm=[0.2, 0.3, 0.4, 0.6],
        **spent,
    )
    c = sampled("c", [False] * 4, margins[2], penetration_mm=[1.5, 4.0, 0.1, None], **spent)
    failed = SamplingRecord(
        object="d", scene="table", method="steered_noise", status="failed", reason="MeshError: no", num=4, seed=0
    )
    return [a, b, c, failed]


@pytest.fixture(scope="session")
def executed() -> Callable[..., ExecutedDraw]:
    """Makes an executed draw: a success unless it is given another outcome."""

    def make(
        rank=0, margin=2.0, outcome="success", *, links=2, behaviour="push", reached=0.09, disturbed=None
    ) -> ExecutedDraw:
        return ExecutedDraw(
            rank=rank,
            force_margin=margin,
            links=links,
            behaviour=behaviour,
            outcome=outcome,
            length_asked=0.1,
            length_reached=reached,
            turned_deg=1.0,
            sunk=0.0,
            hand_environment=0.0,
            link_force=3.0,
            cone_share=0.5,
            approach="straight",
            disturbed=disturbed or {},
        )

    return make
