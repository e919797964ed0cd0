"""The web viewer on loopback: its own files and one recording, and nothing that a page could fetch from elsewhere.

# Strategy: the viewer's program holds the web viewer's files. It is started once, on
# loopback, to hand them over and ended again; from then on this process serves them with
# headers under which the browser itself refuses every other address. Everything stands
# under a path that cannot be guessed, so that another user of the machine who finds the
# port still sees nothing.
"""

from __future__ import annotations

import base64
import hashlib
import http.client
import os
import re
import secrets
import socket
import subprocess
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import TracebackType
from typing import Self
from urllib.parse import quote, urlsplit

from tubeplan_viz.recording.viewer_program import ViewerError, quiet_home, viewer_program

LOOPBACK = "127.0.0.1"
PAGE, PARTS = "index.html", {"re_viewer.js": "text/javascript", "re_viewer_bg.wasm": "application/wasm"}
RECORDING = "recording.rrd"
START_TIMEOUT_S = 30.0
CHUNK = 1 << 20


@dataclass(frozen=True)
class WebFile:
    """One file that is served: its bytes, or where they stand on the disk."""

    kind: str
    content: bytes | Path


def viewer_files() -> dict[str, WebFile]:
    """The web viewer's own files, from the installed viewer.

    Raises
    ------
    ViewerError
        If the viewer does not hand them over.
    """
    with quiet_home() as environment:
        port, other = free_ports(2)
        command = [str(viewer_program()), "--serve-web", "--bind", LOOPBACK, "--port", str(other), "--web-viewer-port", str(port)]
        child = subprocess.Popen(
            command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            # Its fonts come from elsewhere and would be refused; the viewer itself brings its own.
            page = re.sub(rb"<link\b[^>]*https?://[^>]*>", b"", _fetch(child, port, "/"))
            files = {PAGE: WebFile("text/html; charset=utf-8", page)}
            return files | {name: WebFile(kind, _fetch(child, port, f"/{name}")) for name, kind in PARTS.items()}
        finally:
            end(child)


def _fetch(child: subprocess.Popen[bytes], port: int, path: str) -> bytes:
    """One file from the child's server, which may still be starting."""
    until = time.monotonic() + START_TIMEOUT_S
    while True:
        connection = http.client.HTTPConnection(LOOPBACK, port, timeout=START_TIMEOUT_S)
        try:
            connection.request("GET", path)
            answer = connection.getresponse()
            content = answer.read()
        except OSError:
            if child.poll() is not None or time.monotonic() > until:
                state = "ended at once" if child.poll() is not None else f"gave no answer in {START_TIMEOUT_S:.0f} s"
                raise ViewerError(
                    f"rerun's web viewer {state}, expected it to hand over its files; install rerun-sdk again"
                ) from None
            time.sleep(0.05)
            continue
        finally:
            connection.close()
        if answer.status != http.client.OK:
            raise ViewerError(f"rerun's web viewer has no {path} (status {answer.status}); install the pinned rerun-sdk again")
        return content


def end(child: subprocess.Popen[bytes]) -> None:
    """Ask a child to end, and make it end."""
    if child.poll() is None:
        child.terminate()
        try:
            child.wait(3.0)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()


def free_ports(count: int) -> list[int]:
    """Ports of the loopback that were free a moment ago."""
    held = [socket.create_server((LOOPBACK, 0)) for _ in range(count)]
    try:
        return [int(one.getsockname()[1]) for one in held]
    finally:
        for one in held:
            one.close()


def content_policy(page: bytes) -> str:
    """What the page may load: its own origin, and of inline scripts exactly those it came with.

    The viewer asks outside hosts for usage statistics, a log-in and example lists; under
    this policy the browser drops these requests before they reach the network.
    """
    scripts = re.findall(rb"<script>(.*?)</script>", page, re.DOTALL)
    hashes = " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(text).digest()).decode()}'" for text in scripts)
    return (
        f"default-src 'none'; script-src 'self' 'wasm-unsafe-eval' {hashes}; style-src 'unsafe-inline'; "
        "img-src 'self' data: blob:; font-src data:; connect-src 'self' data: blob:; worker-src 'self' blob:; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


class WebViewer:
    """The web viewer with one recording, served on loopback until it is closed.

    Parameters
    ----------
    recording : Path
    port : int
        Port of 127.0.0.1; 0 for any that is free.

    Attributes
    ----------
    url : str
        What to open in the browser; it holds a token without which nothing is served.

    Raises
    ------
    ViewerError
        If the port is taken, or the viewer's files cannot be had.
    """

    def __init__(self, recording: Path, *, port: int = 0) -> None:
        token = secrets.token_urlsafe(16)
        files = {RECORDING: WebFile("application/octet-stream", recording)}
        try:
            self._server = _Server((LOOPBACK, port), _Handler)
        except OSError as fault:
            raise ViewerError(
                f"port {port} of {LOOPBACK} cannot be used ({(fault.strerror or 'refused').lower()}); "
                "choose another one with --port, or leave it out for any free one"
            ) from None
        try:
            files |= viewer_files()
        except BaseException:
            self._server.server_close()
            raise
        page = files[PAGE].content
        assert isinstance(page, bytes)
        host = f"{LOOPBACK}:{self._server.server_port}"
        self.url = f"http://{host}/{token}/"
        self._server.prepare(token, host, files, content_policy(page), self._query())
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
        self._thread.start()

    def _query(self) -> str:
        return f"?url={quote(self.url + RECORDING, safe='')}&persist=0&hide_welcome_screen=1"

    def wait(self) -> None:
        """Serve until interrupted."""
        while self._thread.is_alive():
            self._thread.join(0.5)

    def close(self) -> None:
        """End the server; a second call does nothing."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = os.name == "posix"  # elsewhere it would let a second server take the port

    def prepare(self, token: str, host: str, files: Mapping[str, WebFile], policy: str, query: str) -> None:
        """Say what is served, before the first request is."""
        self.token, self.host, self.files, self.policy, self.query = token, host, files, policy, query


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    server_version, sys_version = "tubeplan", ""
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        """One file below the token."""
        self._answer(body=True)

    def do_HEAD(self) -> None:
        """The headers of one file below the token."""
        self._answer(body=False)

    def _answer(self, *, body: bool) -> None:
        parts = urlsplit(self.path)
        _, token, name = [*parts.path.split("/", 2), "", ""][:3]
        # Another name for this address in the browser would be a page from elsewhere that has rebound its name.
        allowed = self.headers.get("Host") == self.server.host and secrets.compare_digest(
            token.encode(), self.server.token.encode()
        )
        if allowed and name == "" and not parts.query:
            self._head(302, "text/plain", 0, {"Location": f"/{self.server.token}/{self.server.query}"})
            return
        file = self.server.files.get(name or PAGE) if allowed else None
        if file is None:
            self._head(404, "text/plain", 0, {})
            return
        size = file.content.stat().st_size if isinstance(file.content, Path) else len(file.content)
        # The page shows its progress from this header of rerun's own server.
        self._head(200, file.kind, size, {"rerun-final-length": str(size)})
        if not body:
            return
        try:
            if isinstance(file.content, Path):
                with file.content.open("rb") as stream:
                    while chunk := stream.read(CHUNK):
                        self.wfile.write(chunk)
            else:
                self.wfile.write(file.content)
        except (BrokenPipeError, ConnectionResetError):
            self.close_connection = True

    def _head(self, status: int, kind: str, size: int, more: Mapping[str, str]) -> None:
        self.send_response(status)
        headers = {
            "Content-Type": kind,
            "Content-Length": str(size),
            "Content-Security-Policy": self.server.policy,
            "Cross-Origin-Resource-Policy": "same-origin",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            "Cache-Control": "no-store",
        }
        for name, value in {**headers, **more}.items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, format: str, *arguments: object) -> None:
        """Nothing: the terminal belongs to the command."""
