"""Where a page tells of voxels outside the scan."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

from reports import render_report


def test_padding_stands_once_and_with_the_provenance(make_review: Any) -> None:
    told = "123 voxels outside the scan (declared value), read as -1024 HU"
    review = make_review()
    review.result["details"]["image"] = {"Padding": told}
    page = render_report(dataclasses.replace(review, facts={**review.facts, "Padding": told}))
    body = page.split("<body", 1)[1].split('<script type="application/json"', 1)[0]
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", body))
    assert text.count(told) == 1
    assert text.index("Provenance") < text.index(told)
    # Nothing of it before the first picture.
    assert "outside the scan" not in text[: text.index("Provenance")]
