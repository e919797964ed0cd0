"""Which anatomy a CT shows, as far as it can be told from what the presets find in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from segmentation.anatomy.airway import find_trachea
from segmentation.anatomy.urinary import find_collecting_system
from segmentation.errors import RegionError
from segmentation.volume import Volume

# In the order in which they are asked: a chest with contrast medium in the kidneys is planned as a chest.
FINDERS: tuple[tuple[str, str, Callable[[Volume], tuple[int, int, int]]], ...] = (
    ("airway", "a trachea", find_trachea),
    ("urinary", "a contrast-filled collecting system", find_collecting_system),
)


@dataclass(frozen=True)
class AnatomyGuess:
    """An anatomy by the name of its preset, and in words why it is the one."""

    name: str
    reason: str


def guess_anatomy(volume: Volume) -> AnatomyGuess:
    """The first anatomy whose lumen is found without help.

    Parameters
    ----------
    volume : Volume

    Returns
    -------
    AnatomyGuess

    Raises
    ------
    RegionError
        If none is found; vessels never are, since the image does not tell which one is meant.
    """
    found, missing = [], []
    for name, words, find in FINDERS:
        try:
            place = volume.to_lps(find(volume))
        except RegionError as fault:
            missing.append((words, str(fault)))
        else:
            found.append((name, "{} was found at {:.0f}, {:.0f}, {:.0f} mm".format(words, *place)))
    if not found:
        told = "; ".join(f"no {words.removeprefix('a ')} ({fault.partition(';')[0]})" for words, fault in missing)
        raise RegionError(
            f"the anatomy cannot be told from the image: {told}; name it with --anatomy and a point with --seed-point"
        )
    also = "".join(f"; {reason} too" for _, reason in found[1:])
    no = "".join(f"; no {words.removeprefix('a ')}" for words, _ in missing)
    return AnatomyGuess(found[0][0], f"{found[0][1]}{also}{no}")
