"""The viewer's program that comes with rerun, started with a home of its own."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from segmentation.errors import TubeplanError


class ViewerError(TubeplanError):
    """A recording that cannot be shown here."""


def viewer_program() -> Path:
    """The viewer's binary itself: the ``rerun`` script passes no signal on and so leaves a viewer running.

    Raises
    ------
    ViewerError
        If the installed package holds none.
    """
    found = find_spec("rerun_cli")
    for folder in found.submodule_search_locations or () if found is not None else ():
        for name in ("rerun", "rerun.exe"):
            program = Path(folder) / name
            if os.access(program, os.X_OK):
                return program
    raise ViewerError("the installed rerun-sdk holds no viewer, expected the program rerun_cli/rerun; install rerun-sdk again")


@contextmanager
def quiet_home() -> Iterator[dict[str, str]]:
    """An environment whose home is an empty folder in which usage statistics are switched off; removed at the end.

    The viewer takes its settings only from a file with every one of these fields; from
    any other it falls back to its defaults, which switch the statistics on.
    """
    with tempfile.TemporaryDirectory(prefix="tubeplan-", ignore_cleanup_errors=True) as home:
        settings, data = Path(home) / ".config" / "rerun", Path(home) / ".local" / "share" / "rerun" / "analytics"
        settings.mkdir(parents=True)
        data.mkdir(parents=True)
        chosen = {
            "analytics_enabled": False,
            "analytics_id": "",
            "metadata": {},
            "config_file_path": str(settings / "analytics.json"),
            "data_dir_path": str(data),
        }
        (settings / "analytics.json").write_text(json.dumps(chosen), encoding="utf-8")
        own = {
            "HOME": home,
            "XDG_CONFIG_HOME": str(settings.parent),
            "XDG_DATA_HOME": str(data.parents[1]),
            "XDG_CACHE_HOME": str(Path(home) / ".cache"),
            "NO_COLOR": "1",
        }
        # A program under X11 finds its right to draw in the user's own home unless it is told where.
        cookie = Path.home() / ".Xauthority"
        if "XAUTHORITY" not in os.environ and cookie.is_file():
            own["XAUTHORITY"] = str(cookie)
        yield {**os.environ, **own}
