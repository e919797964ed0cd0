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


# Signals that came since a handler was set. Python drops an exception that is raised inside a finaliser, a foreign library's
# callback or an import that tries its luck; a signal is the process's own, and so is this.
_came: list[int] = []


def interrupt(number: int, frame: FrameType | None) -> NoReturn:
    """Pass a signal through the program like Ctrl-C.

    Raises
    ------
    KeyboardInterrupt
        With the signal's name.
    """
    _came.append(number)
    raise KeyboardInterrupt(signal.Signals(number).name)


def check_interrupted() -> None:
    """Raise an interruption again that a library has swallowed; called between two steps of long work it ends that all the same.

    Raises
    ------
    KeyboardInterrupt
        If a request to end has come.
    """
    if _came:
        raise KeyboardInterrupt(signal.Signals(_came[0]).name)


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
        if interrupt not in held.values():  # the outermost has seen to what came
            _came.clear()


def no_more_interrupts() -> None:
    """Let the process end as it was going to: what it did is done, and its exit status is known."""
    for number in ENDING_SIGNALS:
        if ours_to_handle(number):
            signal.signal(number, signal.SIG_IGN)
