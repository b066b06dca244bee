"""Nothing that is read runs code, leaves the map's folder, or takes memory or time out of proportion."""

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.skipif(not Path("/proc/self/statm").is_file(), reason="limits of memory are tested on Linux")
def test_hostile_inputs_are_refused_in_little_memory(tmp_path):
    script = Path(__file__).with_name("hostile.py")
    found = subprocess.run(
        [sys.executable, str(script), str(tmp_path)], capture_output=True, text=True, timeout=600, check=False
    )
    *wrong, last = found.stdout.splitlines() or [""]
    assert wrong == [], found.stderr[-2000:]
    assert last.endswith("cases"), found.stderr[-2000:]
    assert int(last.split()[0]) > 80
