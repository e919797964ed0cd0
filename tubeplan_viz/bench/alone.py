"""One way of a benchmark in a process of its own, so that its time and memory are its own."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a process ended: its exit status, None where it was stopped for time, and the last line of its complaint."""

    status: int | None
    reason: str = ""


def run_alone(command: Sequence[str], *, limit: float) -> Ended:
    """Run a command, its output kept from the terminal, and stop it after `limit` seconds."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired:
        return Ended(status=None)
    return Ended(status=done.returncode, reason=(done.stderr.strip().splitlines() or ["no message"])[-1][:200])
