"""What Warp's start leaves in memory."""

import subprocess
import sys
import textwrap

import pytest


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux says what of a library is mapped")
def test_code_that_only_started_warp_is_not_held():
    program = """
        import re
        from pathlib import Path
        from dexnudge.geometry.exact_distance import ExactDistance
        import trimesh

        def code_of_warp():
            text = Path("/proc/self/smaps").read_text()
            return sum(map(int, re.findall(r" r-xp .*/warp/bin/.*\\n(?:.*\\n)*?Rss: +(\\d+) kB", text))) / 1e3

        print(code_of_warp())
        print(ExactDistance(trimesh.creation.box((2, 2, 2)))([[0, 0, 4]]).distance[0])
        print(code_of_warp())
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=True)
    started, distance, ran = map(float, done.stdout.split())
    assert started < 5
    assert distance == 3
    assert 0 < ran < 40
