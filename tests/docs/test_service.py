"""The service that the page on machines shows answers requests; Ray Serve itself is stood in for."""

import asyncio
import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import dexnudge as dn

PAGE = Path(__file__).parents[2] / "docs" / "concepts" / "machines.md"


@pytest.mark.slow
def test_the_service_answers_by_verified_configurations(monkeypatch):
    def deployment(**options):
        assert options == {"num_replicas": 2}
        return lambda kind: SimpleNamespace(bind=kind)

    ray, requests = ModuleType("ray"), ModuleType("starlette.requests")
    ray.serve, requests.Request = SimpleNamespace(deployment=deployment), object
    for name, module in {"ray": ray, "starlette": ModuleType("starlette"), "starlette.requests": requests}.items():
        monkeypatch.setitem(sys.modules, name, module)
    (code,) = re.findall(
        r'^```py title="service.py"\n(.*?)^```$', PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    namespace = {"__name__": "service"}
    exec(compile(code, PAGE.name, "exec"), namespace)  # noqa: S102 - our own page

    async def asked():
        return {"scene": "table", "object": "phone", "num": 4, "seed": 3}

    answer = asyncio.run(namespace["app"](SimpleNamespace(json=asked)))
    samples = dn.Sampler(dn.load_hand("shadow_lite")).sample(dn.build_scene("table", "phone", seed=3), num=4)
    assert samples.num_verified > 0
    np.testing.assert_array_equal(np.float32(answer["q"]), samples.verified.q)
    assert answer["force_margin"] == samples.verified.verdicts.force_margin.tolist()
