"""The viewer as a reader meets it: in a browser on loopback, and as a child process."""

from __future__ import annotations

import http.client
import io
import json
import os
import re
import stat
import sys
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from tubeplan_viz.recording import ViewerError, WebViewer, native_viewer, show_native
from tubeplan_viz.recording.viewer_program import quiet_home
from tubeplan_viz.recording.web_viewer import content_policy


def ask(url: str, path: str, *, host: str | None = None, method: str = "GET") -> http.client.HTTPResponse:
    """One request to the server behind `url`; the answer is read."""
    place = urlsplit(url)
    connection = http.client.HTTPConnection(str(place.hostname), place.port or 0, timeout=10)
    connection.request(method, path, headers={} if host is None else {"Host": host})
    answer = connection.getresponse()
    answer.body = answer.read()  # type: ignore[attr-defined]
    connection.close()
    return answer


@pytest.fixture(scope="module")
def viewer(light_file: Path):
    with WebViewer(light_file) as served:
        yield served


def test_only_loopback_listens_and_only_below_the_token_is_anything_served(viewer: WebViewer, light_file: Path) -> None:
    place = urlsplit(viewer.url)
    assert place.hostname == "127.0.0.1"
    assert len(place.path.strip("/")) >= 20  # 16 random bytes
    assert ask(viewer.url, place.path + "recording.rrd").body == light_file.read_bytes()
    assert ask(viewer.url, place.path + "re_viewer_bg.wasm", method="HEAD").status == 200
    for path in ("/", "/recording.rrd", "/x/recording.rrd", place.path + "../recording.rrd", place.path + "result.json"):
        assert ask(viewer.url, path).status == 404, path
    # A name that was rebound to this address by somebody else's page.
    assert ask(viewer.url, place.path, host=f"evil.example:{place.port}").status == 404


def test_every_answer_forbids_other_addresses(viewer: WebViewer) -> None:
    place = urlsplit(viewer.url)
    first = ask(viewer.url, place.path)
    assert first.status == 302
    page = ask(viewer.url, str(first.getheader("Location")))
    for answer in (first, page, ask(viewer.url, "/nothing")):
        policy = str(answer.getheader("Content-Security-Policy"))
        assert "default-src 'none'" in policy
        assert "connect-src 'self' data: blob:;" in policy
        assert "http" not in policy
    assert not re.search(rb"<link[^>]*https?:", page.body)


def test_the_policy_admits_the_page_s_own_scripts_and_no_other() -> None:
    policy = content_policy(b"<script>one()</script><p>two()</p><script src='three.js'></script>")
    assert policy.count("'sha256-") == 1
    assert "'unsafe-inline'" not in policy.split("style-src")[0]
    assert content_policy(b"<script>one() </script>") != policy


def test_a_taken_port_is_refused_in_one_sentence(viewer: WebViewer, light_file: Path) -> None:
    port = urlsplit(viewer.url).port
    with pytest.raises(ViewerError, match=rf"port {port} of 127\.0\.0\.1 cannot be used .*--port"):
        WebViewer(light_file, port=int(port or 0))


def test_the_browser_shows_the_recording_and_asks_nobody_else(viewer: WebViewer, browser: Any) -> None:
    from PIL import Image

    page = browser.new_page(viewport={"width": 900, "height": 600})
    asked: list[str] = []
    refused: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda line: refused.append(line.text))
    with page.expect_response("**/recording.rrd", timeout=60_000):
        page.goto(viewer.url)
    # The layout in the file has a dark 3D view at its left; the viewer without a recording is white there.
    dark = 0.0
    for _ in range(60):
        page.wait_for_timeout(500)
        with Image.open(io.BytesIO(page.screenshot())) as picture:
            left = np.asarray(picture.convert("RGB"), float)[60:400, 30:330]
        dark = float((np.abs(left - [18, 20, 24]).max(axis=2) < 4).mean())
        if dark > 0.3 and left.std() > 3.0:
            break
    page.close()
    assert dark > 0.3
    assert left.std() > 3.0  # and something is drawn in it
    assert {urlsplit(url).hostname for url in asked} == {"127.0.0.1"}
    # The viewer did try, and the browser did refuse: the policy is at work.
    assert any("tel.rerun.io" in line and "Content Security Policy" in line for line in refused)


def test_no_usage_statistics_are_kept_by_what_runs_in_the_quiet_home() -> None:
    import subprocess

    from tubeplan_viz.recording.viewer_program import viewer_program

    with quiet_home() as environment:
        home = Path(environment["HOME"])
        done = subprocess.run([viewer_program(), "analytics", "details"], env=environment, capture_output=True, check=True)
        settings = json.loads((home / ".config" / "rerun" / "analytics.json").read_text())
        kept = [file for file in home.rglob("*") if file.is_file()]
    assert b"Welcome to Rerun" not in done.stderr + done.stdout  # shown where the settings are not taken
    assert settings["analytics_enabled"] is False
    assert [file.name for file in kept] == ["analytics.json"]
    assert not home.exists()


def stand_in(folder: Path, *, status: int) -> Path:
    """A viewer that writes down how it was started."""
    program = folder / "viewer"
    program.write_text(
        f"#!{sys.executable}\nimport json, os, sys\n"
        f"json.dump([sys.argv[1:], dict(os.environ)], open({str(folder / 'seen.json')!r}, 'w'))\n"
        f"print('no graphics driver', file=sys.stderr)\nsys.exit({status})\n"
    )
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return program


def test_the_native_viewer_binds_loopback_and_has_a_home_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, light_file: Path
) -> None:
    monkeypatch.setattr(native_viewer, "viewer_program", lambda: stand_in(tmp_path, status=0))
    show_native(light_file)
    arguments, environment = json.loads((tmp_path / "seen.json").read_text())
    assert arguments[arguments.index("--bind") + 1] == "127.0.0.1"
    assert arguments[-1] == str(light_file.resolve())
    assert environment["HOME"] != os.environ.get("HOME")
    assert not Path(environment["HOME"]).exists()


def test_a_native_viewer_that_fails_points_to_the_browser(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, light_file: Path
) -> None:
    monkeypatch.setattr(native_viewer, "viewer_program", lambda: stand_in(tmp_path, status=7))
    with pytest.raises(ViewerError, match=r"ended with status 7 \(no graphics driver\).*--web"):
        show_native(light_file)
