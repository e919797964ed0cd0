"""`tubeplan bench --json` prints figures whatever number type they came in."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tubeplan_viz.bench import BENCHMARKS, Row
from tubeplan_viz.cli.app import status_of


def test_rows_of_numpy_numbers_are_printed_as_json(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    row = Row(
        case="case", figure="rounds", ours=np.int64(3), reference=2.0, source="paper", target="at most 4", holds=bool(np.True_)
    )
    monkeypatch.setitem(BENCHMARKS, "paper", lambda **_: [row])
    assert status_of(["bench", "paper", "--json"]) == 0
    [printed] = json.loads(capsys.readouterr().out)
    assert set(printed) == {"case", "figure", "ours", "reference", "source", "ratio", "target", "holds"}
    assert printed["ours"] == 3
    assert printed["ratio"] == 1.5
    assert printed["holds"] is True
