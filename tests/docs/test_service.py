"""The service that the page on machines shows answers requests; Ray Serve itself is stood in for."""

import asyncio
import json
import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import dexnudge as dn

PAGE = Path(__file__).parents[2] / "docs" / "concepts" / "machines.md"


@pytest.fixture(scope="module")
def ask():
    """Ask the service on the page; returns its answer's status and content."""

    def deployment(**options):
        assert options == {"num_replicas": 2}
        return lambda kind: SimpleNamespace(bind=kind)

    def respond(content, status_code=200):
        return status_code, json.loads(json.dumps(content, allow_nan=False))

    shown = {
        "ray": {"serve": SimpleNamespace(deployment=deployment)},
        "starlette": {},
        "starlette.requests": {"Request": object},
        "starlette.responses": {"JSONResponse": respond},
    }
    (code,) = re.findall(
        r'^```py title="service.py"\n(.*?)^```$', PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    namespace = {"__name__": "service"}
    with pytest.MonkeyPatch.context() as patch:
        for name, content in shown.items():
            module = ModuleType(name)
            vars(module).update(content)
            patch.setitem(sys.modules, name, module)
        exec(compile(code, PAGE.name, "exec"), namespace)  # noqa: S102 - our own page
    service = namespace["app"]

    def ask(body="", **asked):
        async def content():  # as Starlette's Request.json
            return json.loads(body or json.dumps(asked))

        return asyncio.run(service(SimpleNamespace(json=content)))

    return ask


@pytest.mark.slow
def test_the_service_answers_by_verified_configurations(ask):
    status, answer = ask(scene="table", object="phone", num=4, seed=3)
    assert status == 200
    samples = dn.Sampler(dn.load_hand("shadow_lite")).sample(dn.build_scene("table", "phone", seed=3), num=4)
    assert samples.num_verified > 0
    np.testing.assert_array_equal(np.float32(answer["q"]), samples.verified.q)
    assert answer["force_margin"] == samples.verified.verdicts.force_margin.tolist()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"scene": "attic"}, "unknown scene 'attic'"),
        ({"scene": None}, "`family` is a NoneType"),
        ({"object": "no-such"}, "no-such"),
        ({"object": None}, "None"),
        ({"num": 0}, "`num` is"),
        ({"num": 10_001}, "at most 10000"),
        ({"seed": -1}, "`seed` is"),
        ({"scene": [], "seed": {}}, "`family` is"),
    ],
)
def test_a_request_that_makes_no_sense_is_refused_by_the_message(ask, wrong, said):
    status, answer = ask(**{"scene": "table", "object": "phone", **wrong})
    assert status == 400
    assert said in answer["error"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "body", ["{", "no", '"text"', "[1, 2]", "null", b"\xff", "[" * 100_000], ids=lambda body: str(body[:9])
)
def test_a_body_that_is_no_json_object_is_refused(ask, body):
    assert ask(body) == (400, {"error": "expected a JSON object"})


@pytest.mark.slow
def test_the_service_opens_no_file_that_a_client_names(ask, tmp_path):
    mesh = tmp_path / "mine.stl"
    dn.builtin_object("phone").export(mesh)
    assert dn.build_scene("table", mesh).object_mesh.is_watertight
    assert ask(scene="table", object=str(mesh), num=4)[0] == 400
