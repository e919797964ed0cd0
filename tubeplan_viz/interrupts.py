"""Requests to end, from a terminal or from another program, as one kind: an interruption that is cleaned up after."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, NoReturn

ENDING_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)  # the last is absent on Windows


def interrupt(number: int, frame: FrameType | None) -> NoReturn:
    """Pass a signal through the program like Ctrl-C.

    Raises
    ------
    KeyboardInterrupt
        With the signal's name.
    """
    raise KeyboardInterrupt(signal.Signals(number).name)


def ours_to_handle(number: int) -> bool:
    """Whether nobody else has asked for a signal, and it is not ignored, as in the background of a shell."""
    return signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler, interrupt)


@contextmanager
def ending_like_ctrl_c() -> Iterator[None]:
    """Let every request to end raise KeyboardInterrupt, where Python would leave at once and clean up nothing."""
    held: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():  # no other may set a handler
        held = {number: signal.signal(number, interrupt) for number in ENDING_SIGNALS if ours_to_handle(number)}
    try:
        yield
    finally:
        for number, handler in held.items():
            signal.signal(number, handler)
