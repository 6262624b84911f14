"""A page that follows a night in a browser: what ``tactilux status`` knows, every few seconds.

The server answers this machine alone: it is bound to 127.0.0.1, and asked under another name (a
foreign site whose name leads here) it refuses. Other users of the machine lack the secret in its
address, without which nothing is answered. It reads the run and writes nothing.
"""

from __future__ import annotations

import errno
import json
import secrets
from contextlib import closing
from dataclasses import asdict
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from optimize.objectives import title_of, unit_of
from optimize.overnight.result import NIGHT, TITLES, OvernightResult
from optimize.overnight.run_directory import LOG, REPORT, open_record, writing
from optimize.overnight.status import status_of
from optimize.play import inline_digest
from optimize.report import render_page, template_text
from optimize.ui.process import OutputError
from render.errors import TactiluxError

ADDRESS, PORT = "127.0.0.1", 8736
SCRIPT = "follow.js"
LOG_LINES, LOG_BYTES = 40, 16_384
"""What is shown of the log, and what is read of its end."""
REPORT_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def told(run: Path) -> dict[str, Any]:
    """Return what the page shows; ``error`` alone where the run cannot be read just now."""
    try:
        status = status_of(run)
        finalists = _finalists(run, finished=status.state == "finished")
    except TactiluxError as error:
        return {"error": str(error)}
    found = asdict(status)
    return {
        **found,
        "best_words": status.best_words,
        "error": "",
        "finalists": finalists,
        "log": _end_of_log(run / LOG),
        "report": found["state"] == "finished" and (run / REPORT).is_file(),
    }


def _finalists(run: Path, *, finished: bool) -> list[dict[str, Any]]:
    """Return who is verified, once that is chosen, and what the renders say, once they have."""
    if finished and (run / NIGHT).is_file():
        result = OvernightResult.load(run)
        rows, objective = [], result.objective
        for entry in result.finalists:
            figure = entry.figure(objective)
            half = result.interval_factor * figure.se
            row = {"title": entry.title, "best": entry.key == result.winner, "gain": "–"}
            row["figure"] = f"{title_of(objective)} {figure.value:.2f}{unit_of(objective)}"
            row["interval"] = f"{figure.value - half:.2f} to {figure.value + half:.2f}"
            if figure.gain is not None:
                row["gain"] = f"{figure.gain:+.2f} ± {figure.gain_se:.2f}"
            rows.append(row)
        return rows
    with writing(run), closing(open_record(run)) as db:
        words = "SELECT value FROM decisions WHERE name LIKE '%/finalists' ORDER BY id DESC"
        row = db.execute(words).fetchone()
    return [{"title": TITLES.get(str(key), str(key))} for key in json.loads(row[0])] if row else []


def _end_of_log(path: Path) -> list[str]:
    try:
        with path.open("rb") as stream:
            stream.seek(max(path.stat().st_size - LOG_BYTES, 0))
            lines = stream.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return []
    return lines[-LOG_LINES:]


def follow_page(run: Path) -> str:
    """Return the page, which asks for ``status.json`` by itself."""
    script = template_text(SCRIPT)
    return render_page(
        "follow.html.j2",
        {
            "scene": run.resolve().name,
            "run": str(run),
            "bends": (),
            "script": script,
            "policy": (
                f"default-src 'none'; script-src '{inline_digest(script)}'; style-src "
                "'unsafe-inline'; connect-src 'self'; base-uri 'none'; form-action 'none'"
            ),
        },
    )


class StatusServer(ThreadingHTTPServer):
    """Serves the page of one run; ``serve_forever`` works until it is interrupted.

    Raises:
        RunError: there is no run, or it cannot be read.
        OutputError: the port is in use, or may not be used.
    """

    daemon_threads = True

    def __init__(self, run: Path, port: int) -> None:
        """Open ``port``, 0 for any that is free; `url` says where the page is."""
        status_of(run)
        self.run, self.secret = run, secrets.token_urlsafe()
        try:
            super().__init__((ADDRESS, port), _Answer)
        except OSError as error:
            why = "is in use" if error.errno == errno.EADDRINUSE else f"fails ({error.strerror})"
            raise OutputError(
                f"--port = {port} {why} on {ADDRESS}: give another one, 0 takes any that is free",
                field="port",
            ) from None

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{ADDRESS}:{self.server_port}/{self.secret}/"


class _Answer(BaseHTTPRequestHandler):
    """One question of a browser."""

    server: StatusServer
    server_version, sys_version = "tactilux", ""

    def do_GET(self) -> None:
        """Give the page, what it shows, or the report of the night."""
        names = {f"{name}:{self.server.server_port}" for name in (ADDRESS, "localhost")}
        _, secret, path = (*self.path.partition("?")[0].split("/", 2), "", "")[:3]
        known = secrets.compare_digest(secret.encode(), self.server.secret.encode())
        if self.headers.get("Host") not in names:
            self.send_error(HTTPStatus.MISDIRECTED_REQUEST, "this page is for this machine alone")
        elif not known:
            self.send_error(HTTPStatus.FORBIDDEN, "the address that tactilux status said is needed")
        elif path == "":
            self._send("text/html", follow_page(self.server.run).encode())
        elif path == "status.json":
            self._send("application/json", json.dumps(told(self.server.run)).encode())
        elif path == REPORT and (self.server.run / REPORT).is_file():
            content = (self.server.run / REPORT).read_bytes()
            self._send("text/html", content, REPORT_POLICY)
        else:
            self.send_error(HTTPStatus.NOT_FOUND, "there is / and /status.json")

    def _send(self, kind: str, content: bytes, policy: str = "") -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        if policy:
            self.send_header("Content-Security-Policy", policy)
        self.end_headers()
        self.wfile.write(content)

    def handle(self) -> None:
        """Answer; a browser that has gone away is no mistake."""
        try:
            super().handle()
        except OSError:
            self.close_connection = True

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: the terminal is for what a person must know."""
