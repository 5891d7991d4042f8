"""An evaluation on a cluster of two nodes, one of which dies: the records are those of a run in processes."""

import json
from dataclasses import replace

import pytest

from dexnudge.experiments.config import ExperimentConfig
from dexnudge.experiments.records import FILE
from dexnudge.experiments.run import TrialRunner
from dexnudge.experiments.sampling_trial import SamplingTrial

pytest.importorskip("ray")
from ray.cluster_utils import Cluster

pytestmark = [
    pytest.mark.slow,
    # Ray leaves sockets and files of its own processes to the garbage collector.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
CONFIG = ExperimentConfig(objects="builtin:test", max_objects=2, scenes=("table", "layers"), num=2)
TRIALS = 4


@pytest.fixture
def cluster(monkeypatch):
    """Two nodes of one core each, on this machine; the head takes no tasks."""
    monkeypatch.setenv("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    for _ in range(2):
        made.add_node(num_cpus=1)
    yield made
    made.shutdown()


def untimed(records):
    return [replace(record, seconds={}) for record in records]


def test_a_node_that_dies_costs_no_trial_and_doubles_none(cluster, tmp_path, monkeypatch):
    ((_, here),) = TrialRunner([SamplingTrial()], CONFIG, tmp_path / "here").run(workers=2)
    dead = []

    def kill_a_node(_kind, records, total):
        assert total == TRIALS
        if len(records) == 1:
            dead.append(next(iter(cluster.worker_nodes)))
            cluster.remove_node(dead[0], allow_graceful=False)

    runner = TrialRunner([SamplingTrial()], CONFIG, tmp_path / "there")
    ((_, there),) = runner.run(engine="ray", ray_address=cluster.address, on_record=kill_a_node)
    assert len(dead) == 1
    assert untimed(there) == untimed(here)
    lines = (tmp_path / "there" / FILE).read_text().splitlines()
    keys = [tuple(json.loads(line)[name] for name in ("object", "scene", "method")) for line in lines]
    assert len(keys) == len(set(keys)) == TRIALS


def test_an_evaluation_goes_on_with_another_engine(cluster, tmp_path):
    ((_, whole),) = TrialRunner([SamplingTrial()], CONFIG, tmp_path).run(workers=1)
    file = tmp_path / FILE
    kept = file.read_text().splitlines(keepends=True)[:3]
    file.write_text("".join(kept))
    ((_, again),) = TrialRunner([SamplingTrial()], CONFIG, tmp_path).run(engine="ray", ray_address=cluster.address)
    assert untimed(again) == untimed(whole)
    assert file.read_text().startswith("".join(kept))
