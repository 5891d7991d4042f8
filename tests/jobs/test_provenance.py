"""What a run says of the machine and itself."""

import subprocess
import sys

import pytest


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux counts the starting process")
def test_peak_memory_is_of_this_process_and_not_of_the_one_that_started_it():
    held = b"1" * 400_000_000
    program = """
import resource
from dexnudge.jobs.provenance import peak_memory_mb
before = peak_memory_mb()
held = b"1" * 50_000_000
print(before, peak_memory_mb(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    before, after, of_both = map(float, done.stdout.split())
    assert len(held) / 1e6 <= of_both
    assert before < 200
    assert 50 <= after - before < 60
