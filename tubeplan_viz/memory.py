"""How much memory this process has taken."""

from __future__ import annotations

import sys
from pathlib import Path


def peak_memory() -> float:
    """Most memory that this process has held, MB."""
    status = Path("/proc/self/status")
    if status.exists():
        # What `getrusage` tells on Linux counts the parent's memory at the fork too.
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return float(line.split()[1]) / 1024.0
    import resource  # absent on Windows

    return megabytes(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def megabytes(maxrss: float) -> float:
    """The largest resident set that `getrusage` or `wait4` tell, MB."""
    return maxrss / (1024.0**2 if sys.platform == "darwin" else 1024.0)
