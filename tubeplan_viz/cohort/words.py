"""Reasons as they may stand in a file that is handed on: no path of this machine, and like ones known as alike."""

from __future__ import annotations

import re

from segmentation.faults import shortened

QUOTED = re.compile(r"""(?<=['"])(?:~|[A-Za-z]:)?/(?:[^'"/]+/)+""")  # may hold spaces
ABSOLUTE = re.compile(r"(?<![\w.~/])(?:~|[A-Za-z]:)?/(?:[^\s/'\",:;()]+/)+")
NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
LONGEST = 600


def without_paths(text: str) -> str:
    """The text with absolute paths cut down to their last name, and not endlessly long.

    Examples
    --------
    >>> without_paths("/data/x/ct.nii: 3 of 0.5 1/mm and/or less, see '/ward 3/b.nii'")
    "ct.nii: 3 of 0.5 1/mm and/or less, see 'b.nii'"
    """
    return shortened(ABSOLUTE.sub("", QUOTED.sub("", text)), LONGEST)


def kind_of_reason(text: str) -> str:
    """What reasons that differ in their numbers alone have in common.

    Examples
    --------
    >>> kind_of_reason("slices 41 and 42 are 2.50 mm apart") == kind_of_reason("slices 7 and 8 are 5.00 mm apart")
    True
    """
    return " ".join(NUMBER.sub("#", text).split())
