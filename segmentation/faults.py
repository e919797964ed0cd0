"""Faults in one sentence of bearable length, for a terminal or a row of a table."""

from __future__ import annotations

import traceback
from pathlib import PurePath
from types import FrameType

OURS = ("segmentation", "tubeplan_viz", "reports")


def fault_words(fault: BaseException) -> str:
    """Kind, message and place of a fault; where it struck outside of the project, also the place that led there.

    The message is taken as it is, and may hold paths: who writes the sentence into a file takes them out.
    """
    way = list(traceback.walk_tb(fault.__traceback__))
    places = [place(*way[-1])]
    ours = [step for step in way if str(step[0].f_globals.get("__name__")).split(".")[0] in OURS]
    if ours and ours[-1] is not way[-1]:
        places.append(f"called by {place(*ours[-1])}")
    return f"a fault of the program, please report it: {type(fault).__name__}: {fault} (in {', '.join(places)})"


def shortened(text: str, longest: int = 200) -> str:
    """A text with its middle left out where it is too long: what it is about and what to do stand at its ends.

    Examples
    --------
    >>> shortened("found 0123456789, expected less", 23)
    'found 012 ... cted less'
    """
    half = (longest - 5) // 2
    return text if len(text) <= longest else f"{text[:half]} ... {text[-half:]}"


def place(frame: FrameType, line: int) -> str:
    """Function, line and file name of a step of a traceback."""
    return f"{frame.f_code.co_name}, line {line} of {PurePath(frame.f_code.co_filename).name}"
