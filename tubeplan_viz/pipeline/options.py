"""What a caller decides about a run beside its case: which files are written, who watches."""

from __future__ import annotations

from dataclasses import dataclass

from tubeplan_viz.pipeline.progress import Notify, silent


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of a run that change no number of its plan.

    Attributes
    ----------
    force : bool
        Replace an earlier run folder of that name.
    recording, report : bool
        Whether recording.rrd and report.html are made.
    light : bool
        Leave the CT out of the recording and thin its mesh, for recorded examples.
    connect : str or None
        Address of a running rerun viewer that is fed while planning.
    notify : Notify
        Told of the stages and their progress.
    """

    force: bool = False
    recording: bool = True
    report: bool = True
    light: bool = False
    connect: str | None = None
    notify: Notify = silent
