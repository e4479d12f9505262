"""By which code, and on what, a result was made."""

import os
import platform
import subprocess
from pathlib import Path
from typing import Any

import psutil

ROOT = Path(__file__).resolve().parent.parent


def hardware() -> dict[str, Any]:
    """What it ran on."""
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": psutil.cpu_count(),
        "memory_gb": round(psutil.virtual_memory().total / 1e9),
        "load": [round(one, 1) for one in os.getloadavg()],
    }


def commit() -> str:
    """The version of the code, with a mark if it has been changed since."""
    git = ["git", "-C", str(ROOT), "describe", "--always", "--dirty"]
    return subprocess.run(
        git, capture_output=True, text=True, check=False
    ).stdout.strip()
