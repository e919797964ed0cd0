"""The only door to MuJoCo, so that the rest of the project works without it."""

from __future__ import annotations

from typing import Any

from segmentation.errors import CaseError


def engine() -> Any:
    """The module `mujoco`.

    Raises
    ------
    CaseError
        If it is not installed, with the command that installs it.
    """
    try:
        import mujoco
    except ImportError:
        raise CaseError(
            'the dynamics of the bronchoscope need MuJoCo, which is not installed; pip install "tubeplan[dynamics]", '
            "or plan with --method kinematic"
        ) from None
    # Motions check their states themselves; MuJoCo's own warnings would go into a file in the working directory.
    mujoco.set_mju_user_warning(_unheard)
    return mujoco


def _unheard(message: str) -> None:
    """Say nothing."""
