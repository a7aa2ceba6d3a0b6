"""Run `learn_large.py` in a fresh process."""

import json
import subprocess
import sys
from pathlib import Path


def learn(t, d, n, m):
    """Return the figures of a fit of n windows (t, d) and m components."""
    script = Path(__file__).with_name("learn_large.py")
    sizes = [str(size) for size in (t, d, n, m)]
    done = subprocess.run(
        [sys.executable, script, *sizes], check=True, capture_output=True, text=True
    )
    return json.loads(done.stdout)
