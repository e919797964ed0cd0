"""A fault of the program is told with its place."""

from __future__ import annotations

import pytest

from segmentation.arrays import frozen_array
from segmentation.faults import fault_words


class Unreadable:
    """What only fails when numpy asks for its numbers: outside of the project, called by it."""

    def __array__(self, *_: object, **__: object) -> None:
        raise OSError("the disc is gone")


def test_a_fault_outside_of_the_project_names_the_line_of_the_project_that_led_there() -> None:
    with pytest.raises(OSError, match="the disc is gone") as caught:
        frozen_array(Unreadable(), (None,), "points")  # type: ignore[arg-type]
    words = fault_words(caught.value)
    assert words.startswith("a fault of the program, please report it: OSError: the disc is gone (in __array__, line 15 of ")
    assert "test_faults.py, called by frozen_array, line " in words
    assert words.endswith(" of arrays.py)")


def test_a_fault_of_the_project_itself_names_one_place() -> None:
    with pytest.raises(ValueError, match="points") as caught:
        frozen_array([[1.0]], (None,), "points")
    assert " called by " not in fault_words(caught.value)
    assert fault_words(caught.value).endswith(" of arrays.py)")
