"""Reading a recording back, number for number."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from segmentation.arrays import BoolArray, FloatArray, IntArray, frozen_array
from tubeplan_viz.geometry import SplineCurve
from tubeplan_viz.plan import Feature, FeatureKind, FlaggedInterval, FlagKind
from tubeplan_viz.recording import entities as at


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordedPath:
    """A path as a recording holds it.

    Attributes
    ----------
    curve_points : (k, 3) float array, mm
        The line drawn in 3D, in single precision.
    features : tuple of Feature
        Exact.
    arc_length, curvature, clearance : (n,) float array, mm, 1/mm, mm
        Exact; in a light recording the samples that were kept, in single precision.
    flagged : tuple of FlaggedInterval
        Exact; those of the curvature first.
    flagged_samples : mapping of FlagKind to (n,) bool array
        Which samples are drawn as flagged.
    """

    curve_points: FloatArray
    features: tuple[Feature, ...]
    arc_length: FloatArray
    curvature: FloatArray
    clearance: FloatArray
    flagged: tuple[FlaggedInterval, ...]
    flagged_samples: Mapping[FlagKind, BoolArray]


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordedIteration(RecordedPath):
    """One state of the path while planning.

    Attributes
    ----------
    index : int
    curve : SplineCurve
        Exact: every point of the path can be computed again from it.
    facts : mapping of str to float
        ``curvature_max_per_mm``, ``clearance_min_mm`` and ``length_mm``, exact, and the counts ``features``, ``moved``
        and ``added``.
    convergence : mapping of str to float
        The points of the convergence curves: ``curvature``, ``clearance`` (over their limits) and ``limit``.
    """

    index: int
    curve: SplineCurve
    facts: Mapping[str, float]
    convergence: Mapping[str, float]


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordedRun:
    """A recording as read back.

    Attributes
    ----------
    case : mapping of str to value
        ``case_id``, ``planner``, ``method``, ``frame``, ``units``, the limits, the notice.
    entities : tuple of str
        Entity paths in order.
    timelines : tuple of str
    iterations : tuple of RecordedIteration
        In order of their index.
    planned : RecordedPath or None
        The planned path of result.json; None when there is none.
    decisions : tuple of (int, str, str)
        Iteration, level and text in the order logged.
    summary : str
        The last summary on the iteration timeline, markdown.
    walk_ticks : (k,) int array
        Places of the walk along the path, in tenths of a millimetre.
    walk_points : (k, 3) float array, mm
        The marker's places, in single precision.
    """

    case: Mapping[str, Any]
    entities: tuple[str, ...]
    timelines: tuple[str, ...]
    iterations: tuple[RecordedIteration, ...]
    planned: RecordedPath | None
    decisions: tuple[tuple[int, str, str], ...]
    summary: str
    walk_ticks: IntArray
    walk_points: FloatArray


def read_recording(path: Path) -> RecordedRun:
    """Read a finished recording.

    Raises
    ------
    RecordingError
        If the file is none, is cut short, or was not written by this program.
    """
    from rerun.chunk import RrdReader
    from rerun.error_utils import RerunWarning

    from tubeplan_viz.recording.sink import APPLICATION, RecordingError

    if not path.is_file():
        raise RecordingError(f"{path.name}: no such recording; expected the recording.rrd of a run folder")
    try:
        with warnings.catch_warnings():
            # A file that was cut short has lost its footer, of which rerun only warns.
            warnings.simplefilter("error", RerunWarning)
            reader = RrdReader(path)
        stores = reader.recordings()
        chunks = list(reader.stream()) if stores else []
        timelines = tuple(sorted({name for chunk in chunks for name in chunk.timeline_names}))
    except (ValueError, OSError, RuntimeError, RerunWarning) as error:
        raise RecordingError(
            f"{path.name}: no readable recording, the file is cut short or of another kind; plan again"
        ) from error
    if len(stores) != 1 or stores[0].application_id != APPLICATION:
        raise RecordingError(f"{path.name}: not a recording of {APPLICATION}; expected the recording.rrd of a run folder")
    table = _Table(chunks)
    indices = sorted(table.rows(at.FACTS, at.ITERATION))
    walk = table.rows(at.WALK, at.ARC_LENGTH)
    ticks = np.array(sorted(walk), dtype=np.int64)
    summaries = table.rows(at.SUMMARY, at.ITERATION)
    return RecordedRun(
        case={name: value[0] for name, value in table.static(PROPERTIES).items() if value},
        entities=tuple(sorted({chunk.entity_path for chunk in chunks})),
        timelines=timelines,
        iterations=tuple(_iteration(table, index) for index in indices),
        planned=RecordedPath(**_path(table, at.ARC_LENGTH, 0)) if table.rows(at.CURVE, at.ARC_LENGTH) else None,
        decisions=tuple(table.decisions()),
        summary=str(summaries[max(summaries)]["TextDocument:text"][0]) if summaries else "",
        walk_ticks=frozen_array(ticks, (None,), "walk_ticks", dtype=np.int64),
        walk_points=_points([walk[tick]["Transform3D:translation"][0] for tick in ticks.tolist()]),
    )


PROPERTIES = "/__properties/case"


class _Table:
    """The chunks of a file as rows: entity, timeline, tick -> columns; later rows replace earlier ones."""

    def __init__(self, chunks: list[Any]) -> None:
        self._rows: dict[str, list[tuple[bytes, dict[str, int], dict[str, Any]]]] = {}
        self._joined: dict[tuple[str, str], dict[int, dict[str, Any]]] = {}
        for chunk in chunks:
            batch = chunk.to_record_batch()
            names = [name for name in batch.schema.names if name not in chunk.timeline_names]
            indices = {name: batch.column(name).cast("int64").to_pylist() for name in chunk.timeline_names}
            columns = {name.removeprefix("property:"): batch.column(name) for name in names}
            ids = columns.pop("rerun.controls.RowId")
            for row in range(batch.num_rows):
                values = {name: column[row] for name, column in columns.items() if column[row].is_valid}
                ticks = {name: ticks[row] for name, ticks in indices.items()}
                self._rows.setdefault(chunk.entity_path, []).append((ids[row].as_py(), ticks, values))
        for rows in self._rows.values():
            rows.sort(key=lambda row: row[0])

    def rows(self, entity: str, timeline: str) -> dict[int, dict[str, Any]]:
        """Columns by tick; the columns of rows at the same tick are joined."""
        if (entity, timeline) not in self._joined:
            found = self._joined[entity, timeline] = {}
            for _, ticks, values in self._rows.get(entity, ()):
                if timeline in ticks:
                    found.setdefault(ticks[timeline], {}).update({name: value.as_py() for name, value in values.items()})
        return self._joined[entity, timeline]

    def static(self, entity: str) -> dict[str, Any]:
        """Columns that hold for all times."""
        found: dict[str, Any] = {}
        for _, ticks, values in self._rows.get(entity, ()):
            if not ticks:
                found.update({name: value.as_py() for name, value in values.items()})
        return found

    def decisions(self) -> Iterator[tuple[int, str, str]]:
        """The log, line by line."""
        for _, ticks, values in self._rows.get(at.DECISIONS, ()):
            yield ticks[at.ITERATION], str(values["TextLog:level"].as_py()[0]), str(values["TextLog:text"].as_py()[0])


def _iteration(table: _Table, index: int) -> RecordedIteration:
    def row(entity: str) -> dict[str, Any]:
        return table.rows(entity, at.ITERATION).get(index, {})

    facts = {name: float(value[0]) for name, value in row(at.FACTS).items()}
    for name in ("features", "moved", "added"):
        facts[name] = float(row(f"{at.COUNTS}/{name}")["Scalars:scalars"][0])
    spline = row(at.SPLINE)
    control_points = np.array(spline["control_points_mm"]).reshape(-1, 3)
    convergence = {name: row(f"{at.CONVERGENCE}/{name}") for name in ("curvature", "clearance", "limit")}
    return RecordedIteration(
        **_path(table, at.ITERATION, index),
        index=index,
        curve=SplineCurve(int(spline["degree"][0]), np.array(spline["knots"]), control_points),
        facts=facts,
        convergence={name: float(value["Scalars:scalars"][0]) for name, value in convergence.items() if value},
    )


def _path(table: _Table, timeline: str, tick: int) -> dict[str, Any]:
    """The fields of `RecordedPath` at one tick."""

    def row(entity: str) -> dict[str, Any]:
        return table.rows(entity, timeline).get(tick, {})

    profiles = {kind: _profile(row, kind) for kind in FlagKind}
    arc_length, curvature, bent = profiles[FlagKind.CURVATURE]
    _, clearance, close = profiles[FlagKind.CLEARANCE]
    return {
        "curve_points": _points([point for strip in row(at.CURVE)["LineStrips3D:strips"] for point in strip]),
        "features": _features(row(at.FEATURES)),
        "arc_length": arc_length,
        "curvature": curvature,
        "clearance": clearance,
        "flagged": tuple(flag for kind in FlagKind for flag in _flags(row(at.flagged_path(kind)), kind)),
        "flagged_samples": {FlagKind.CURVATURE: bent, FlagKind.CLEARANCE: close},
    }


def _profile(row: Callable[[str], dict[str, Any]], kind: FlagKind) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Arc lengths, values and flags of one plot, its two bar series merged in order of arc length."""
    parts = [row(at.profile_path(kind, part)) for part in ("ok", "flagged")]
    s = [_tensor(part.get("BarChart:abscissa")) for part in parts]
    values = [_tensor(part.get("BarChart:values")) for part in parts]
    flags = np.concatenate([np.zeros(len(s[0]), dtype=bool), np.ones(len(s[1]), dtype=bool)])
    order = np.argsort(np.concatenate(s), kind="stable")
    return np.concatenate(s)[order], np.concatenate(values)[order], flags[order]


def _tensor(cell: Any) -> FloatArray:
    if cell is None:
        return np.empty(0)
    buffer = cell[0]["buffer"]
    data = next(iter(buffer.values())) if isinstance(buffer, dict) else buffer
    return np.asarray(data if data is not None else [], dtype=float)


def _features(row: Mapping[str, Any]) -> tuple[Feature, ...]:
    points = np.array(row.get("point_mm", []), dtype=float).reshape(-1, 3)
    return tuple(
        Feature(kind=FeatureKind(kind), point=point, u=float(u), moved=int(moved))
        for kind, point, u, moved in zip(row.get("kind", []), points, row.get("u", []), row.get("moved", []), strict=True)
    )


def _flags(row: Mapping[str, Any], kind: FlagKind) -> Iterator[FlaggedInterval]:
    columns = [row.get(name, []) for name in ("start_mm", "end_mm", "worst", "worst_at_mm")]
    for start, end, worst, worst_at in zip(*columns, strict=True):
        yield FlaggedInterval(kind=kind, start=start, end=end, worst=worst, worst_at=worst_at)


def _points(points: list[Any]) -> FloatArray:
    return frozen_array(np.array(points, dtype=float).reshape(-1, 3), (None, 3), "points")
