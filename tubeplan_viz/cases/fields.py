"""Values of a case file, checked one by one: what is wrong is said with its table and key."""

from __future__ import annotations

import math
import os
import sys
import tomllib
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from segmentation.errors import CaseError
from segmentation.mesh_files import FARTHEST_MM
from tubeplan_viz.tolerance import PRESETS

Place = tuple[float, float, float] | str
# No file system in use takes a longer name of a file or folder, bytes.
LONGEST_NAME = 255


def read_table(path: Path, *, what: str = "case file") -> dict[str, Any]:
    """The tables of a case file, or of another file of that kind, as they stand."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))  # some editors begin a file with a mark of its encoding
    except FileNotFoundError:
        raise CaseError(f"{path.name}: no such {what}") from None
    except (OSError, UnicodeDecodeError) as fault:
        reason = str(getattr(fault, "strerror", None) or "no UTF-8 text").lower()
        raise CaseError(f"{path.name}: cannot be read ({reason}); expected a {what} in TOML") from None
    except tomllib.TOMLDecodeError as fault:
        raise CaseError(f"{path.name}: not valid TOML: {fault}") from None


def check_keys(table: Mapping[str, Any], known: Sequence[str], where: str, what: str) -> None:
    """Refuse a key that nobody reads: a typing error must not pass as a default."""
    if not isinstance(table, Mapping):
        raise CaseError(f"{where}: found {type(table).__name__}, expected a table")
    for key in table:
        if key not in known:
            near = get_close_matches(key, known, n=1)
            meant = f"; did you mean {near[0]}?" if near else ""
            raise CaseError(f"{where}: unknown {what} {brief(key)}; expected one of {', '.join(known)}{meant}")


def subtable(table: Mapping[str, Any], key: str, name: str) -> dict[str, Any]:
    """One table of the case, as a copy; empty when it is not there."""
    found = table.get(key, {})
    if not isinstance(found, Mapping):
        raise CaseError(f"{name}: {key} is {brief(found)}, expected a table [{key}]")
    return dict(found)


def text(value: Any, where: str) -> str:
    """A value that must be text."""
    if not isinstance(value, str | os.PathLike):
        raise CaseError(f"{where}: found {brief(value)}, expected text")
    found = os.fspath(value)
    # Bytes of a command line or file name that are no UTF-8 come as such characters, and no file can hold them.
    if any("\ud800" <= letter <= "\udfff" for letter in found):
        raise CaseError(f"{where}: found {brief(found)}, expected text in UTF-8; write it again in that encoding, or in ASCII")
    return found


def located(value: Any, folder: Path | None, where: str) -> Path:
    """A file's path; a relative one starts from `folder`, the case file's."""
    given = text(value, where)
    if not given or "\0" in given:
        raise CaseError(f"{where}: found {brief(given)}, expected the path of a file or folder")
    if any(len(os.fsencode(name)) > LONGEST_NAME for name in Path(given).parts):
        raise CaseError(f"{where}: found {brief(given)}, expected names of at most {LONGEST_NAME} bytes; shorten it")
    try:
        path = Path(given).expanduser()
    except RuntimeError:  # of ~NAME where nobody has that name
        raise CaseError(
            f"{where}: found {brief(given)}, expected a path; nobody here has that name, give the whole path"
        ) from None
    return path if folder is None or path.is_absolute() else Path(os.path.normpath(folder / path))


def brief(value: Any) -> str:
    """A value as a message shows it: a long one in part."""
    shown = repr(value)
    return shown if len(shown) <= 80 else f"{shown[:60]}... ({len(shown)} characters)"


def number(value: Any, where: str, wanted: str = "a finite number") -> float:
    """A value that must be a finite number."""
    # A whole number of TOML may have more digits than a double takes.
    fits = isinstance(value, float) or (isinstance(value, int) and abs(value) <= sys.float_info.max)
    if isinstance(value, bool) or not fits or not math.isfinite(value):
        raise CaseError(f"{where}: found {brief(value)}, expected {wanted}")
    return float(value)


def coordinate(value: Any, where: str) -> float:
    """A number that can be a place's, mm: distances between larger ones lose their digits."""
    found = number(value, where)
    if abs(found) > FARTHEST_MM:
        raise CaseError(f"{where}: found {found:g}, expected at most {FARTHEST_MM:g} mm from the origin; check the unit")
    return found


def table_rows(table: Mapping[str, Any], key: str, name: str) -> list[Any]:
    """The tables ``[[key]]`` of a case file; empty when there are none."""
    found = table.get(key, [])
    if not isinstance(found, list | tuple):
        raise CaseError(f"{name}: {key} is {brief(found)}, expected one or more tables [[{key}]]")
    return list(found)


def whole(value: Any, where: str) -> int:
    """A value that must be a whole number."""
    found = number(value, where, "a whole number")
    if found != round(found):
        raise CaseError(f"{where}: found {brief(value)}, expected a whole number")
    return int(value)  # and not of `found`, which a whole number of more than 16 digits does not survive


def seconds(value: Any, where: str) -> float | None:
    """A value that must be a time budget: a number above 0, or none."""
    if value is None:
        return None
    found = number(value, where)
    if found <= 0.0:
        raise CaseError(f"{where}: found {found:g} s, expected more than 0")
    return found


def seed(value: Any, where: str) -> int:
    """A value that must be a seed of randomness: a whole number from 0 on."""
    found = whole(value, where)
    if found < 0:
        raise CaseError(f"{where}: found {found}, expected 0 or more")
    return found


def point(value: Any, where: str) -> tuple[float, float, float]:
    """Three finite numbers, from a list or from text ``X,Y,Z``."""
    if isinstance(value, str):
        try:
            value = [float(v) for v in value.split(",")]
        except ValueError:
            raise CaseError(f"{where}: found {brief(value)}, expected X,Y,Z in mm") from None
    if not isinstance(value, Sequence) or len(value) != 3:
        raise CaseError(f"{where}: found {brief(value)}, expected three numbers in mm")
    x, y, z = (coordinate(v, where) for v in value)
    return (x, y, z)


def error_of_pose(value: Any, where: str) -> tuple[float, float] | str:
    """Shift in mm and turn in degrees, from a list or from text ``MM,DEG``; or the word for all presets."""
    wanted = f"a shift in mm and a turn in degrees, e.g. 2,2, or {PRESETS}"
    if isinstance(value, str):
        if value.strip().lower() == PRESETS:
            return PRESETS
        try:
            value = [float(v) for v in value.split(",")]
        except ValueError:
            raise CaseError(f"{where}: found {brief(value)}, expected {wanted}") from None
    if not isinstance(value, Sequence) or len(value) != 2:
        raise CaseError(f"{where}: found {brief(value)}, expected {wanted}")
    return (number(value[0], where), number(value[1], where))


def end_place(value: Any, where: str) -> Place:
    """A start or goal: coordinates, a label like E2 from ``tubeplan endpoints``, or the name of the part with an end point.

    Labels come back in capitals, names without.
    """
    if isinstance(value, str):
        words = " ".join(value.split())
        if is_label(words):
            return words.upper()
        if "," not in value and any(letter.isalpha() for letter in words):
            return words.casefold()
        if "," not in value:
            raise CaseError(
                f"{where}: found {brief(value)}, expected X,Y,Z in mm, or a label like E2 or a name from `tubeplan endpoints`"
            )
    return point(value, where)


def is_label(words: str) -> bool:
    """Whether words are the label of an end point, known or not."""
    return words[:1].upper() == "E" and words[1:].isdecimal()
