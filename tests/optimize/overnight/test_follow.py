"""A night is followed in a browser: from its first stage to the link to its report."""

from __future__ import annotations

import http.client
import json
import re
import shutil
import signal
import socket
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from optimize.overnight.follow import ADDRESS, StatusServer, told
from optimize.overnight.job import overnight
from optimize.overnight.result import OvernightResult
from optimize.overnight.run_directory import LOG, RECORD, RunError
from optimize.overnight.status import status_of
from optimize.overnight.workers import Workers
from tests.optimize.browser import PALE
from tests.optimize.overnight.conftest import TinyNight
from tests.optimize.overnight.tiny import start, write_tiny
from tests.optimize.overnight.warm import WarmProgram

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

Run = Callable[..., Any]
PATIENCE = 240.0  # seconds until a tiny night ends on a busy machine


@contextmanager
def serving(run: Path) -> Iterator[str]:
    """Serve ``run`` in a thread, as the command does, and give the address."""
    with StatusServer(run, 0) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server.url
        server.shutdown()
        thread.join()


def asked(url: str, path: str = "status.json") -> Any:
    with urllib.request.urlopen(url + path, timeout=30) as answer:
        return json.load(answer)


def said(page: Page, name: str) -> str:
    return page.locator(f"#{name}").inner_text()


def until(page: Page, what: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not what():
        assert time.monotonic() < end, page.inner_text("body")
        page.wait_for_timeout(200)


def test_a_night_is_followed_to_its_report(
    warm_program: WarmProgram, chromium: Browser, tmp_path: Path
) -> None:
    scene, run = write_tiny(tmp_path), tmp_path / "night"
    night = warm_program.start("overnight", scene, "--out", run, "--samples", 8)
    end = time.monotonic() + PATIENCE
    while not (run / RECORD).is_file():
        assert time.monotonic() < end
        time.sleep(0.05)
    with serving(run) as url, chromium.new_context() as context:
        page = context.new_page()
        complaints: list[str] = []
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        requests: list[str] = []
        page.on("request", lambda request: requests.append(request.url))
        page.goto(url)
        until(page, lambda: said(page, "state") == "works now")
        assert page.locator("#report").is_hidden()
        assert "process" in said(page, "holder")
        stages = set()

        def finished() -> bool:
            stages.add(said(page, "stage"))
            return said(page, "state") == "is finished"

        until(page, finished)
        assert night.wait()[0] == 0
        assert len(stages) > 2  # it followed by itself
        result = OvernightResult.load(run)
        rows = [row.split("\t") for row in page.locator("#finalists tr").all_inner_texts()]
        assert [row[0] for row in rows] == [entry.title for entry in result.finalists]
        figures = [entry.figure(result.objective).value for entry in result.finalists]
        assert [row[1] for row in rows] == [f"sensor reader {value:.2f}°" for value in figures]
        best = page.locator("tr.best td").first.inner_text()
        assert best == result.best.title
        assert said(page, "percent") == "100 %"
        assert result.verdict[0] in said(page, "log")
        page.click("#report a")
        assert page.title().startswith("tiny: ")
        assert page.locator("#wiring").count() == 1
    assert complaints == []
    assert all(request.startswith((url, "data:")) for request in requests)


def test_the_page_says_what_status_says_in_both_color_schemes(
    tiny_night: TinyNight, chromium: Browser
) -> None:
    with serving(tiny_night.run) as url:
        answer = asked(url)
        known = vars(status_of(tiny_night.run))
        assert {name: answer[name] for name in known} == known
        assert (answer["report"], answer["error"]) == (True, "")
        for scheme in ("light", "dark"):
            for width in (1280, 320):
                with chromium.new_context(
                    color_scheme=scheme, viewport={"width": width, "height": 700}
                ) as context:
                    page = context.new_page()
                    page.goto(url)
                    until(page, lambda page=page: said(page, "state") == "is finished")
                    assert page.evaluate(PALE) == []
                    over = page.evaluate("document.documentElement.scrollWidth - innerWidth")
                    assert over <= 0


def test_what_goes_wrong_is_on_the_page(
    tiny_night: TinyNight, tmp_path: Path, chromium: Browser
) -> None:
    run = shutil.copytree(tiny_night.run, tmp_path / "run")
    with chromium.new_context() as context:
        page = context.new_page()
        with serving(run) as url:
            page.goto(url)
            until(page, lambda: said(page, "state") == "is finished")
            (run / RECORD).write_bytes(b"no record")
            for name in ("-wal", "-shm"):
                (run / f"{RECORD}{name}").unlink(missing_ok=True)
            until(page, lambda: "is damaged" in said(page, "problem"))
        until(page, lambda: "No answer" in said(page, "silent"))


def test_an_error_that_ends_a_night_is_a_state_and_a_line_of_its_log(tmp_path: Path) -> None:
    def no_workers() -> Workers:
        raise RunError("a worker has another Mitsuba", field="dask")

    scene, run = write_tiny(tmp_path), tmp_path / "night"
    with pytest.raises(RunError, match="another Mitsuba"):
        overnight(str(scene), run, samples=8, make_workers=no_workers)
    answer = told(run)
    assert answer["state"] == "failed"
    assert answer["log"][-1].endswith("Ended by an error: a worker has another Mitsuba")
    assert (answer["finalists"], answer["best"], answer["report"]) == ([], None, False)


def test_it_is_for_this_machine_and_for_reading_alone(tiny_night: TinyNight) -> None:
    before = {path: path.read_bytes() for path in tiny_night.run.iterdir() if path.is_file()}
    with serving(tiny_night.run) as url:
        where, secret, _ = url.removeprefix("http://").split("/")
        address, port = where.split(":")
        assert address == ADDRESS == "127.0.0.1"

        def status(method: str, path: str, host: str) -> int:
            line = http.client.HTTPConnection(address, int(port), timeout=30)
            line.request(method, path, headers={"Host": host})
            code = line.getresponse().status
            line.close()
            return code

        own = f"{address}:{port}"
        page = f"/{secret}/"
        assert status("GET", page, own) == status("GET", page, f"localhost:{port}") == 200
        assert status("GET", page, f"evil.example:{port}") == 421
        assert status("POST", page, own) == 501
        for path in ("run.sqlite", "../scene.toml", f"/{LOG}", "renders/"):
            assert status("GET", page + path, own) == 404, path
        for path in ("/", "/status.json", "//", f"/{secret[:-1]}/", "/guessed/status.json"):
            assert status("GET", path, own) == 403, path
    after = {path: path.read_bytes() for path in before}
    assert after == before


def test_ctrl_c_ends_it_with_130_and_the_night_stays(tiny_night: TinyNight) -> None:
    process = start("status", tiny_night.run, "--serve", "--port", 0)
    assert process.stdout is not None
    line = process.stdout.readline()
    found = re.match(r"(http://127\.0\.0\.1:\d+/[\w-]+/) follows .* until Ctrl-C\n", line)
    assert found, process.communicate()
    assert asked(found[1])["state"] == "finished"
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (130, "", "tactilux: interrupted\n")


def test_what_cannot_be_served_raises_one_clear_error(
    tactilux: Run, tiny_night: TinyNight, tmp_path: Path
) -> None:
    with socket.create_server((ADDRESS, 0)) as taken:
        port = taken.getsockname()[1]
        done = tactilux("status", tiny_night.run, "--serve", "--port", port)
    assert (done.code, done.out) == (2, "")
    assert done.err == (
        f"tactilux: --port = {port} is in use on 127.0.0.1: give another one, 0 takes any that is "
        "free\n"
    )
    nothing = tactilux("status", tmp_path, "--serve")
    assert (nothing.code, nothing.out) == (2, "")
    assert "holds no run" in nothing.err
    for words in (("--serve", "--json"), ("--serve", "--scaling"), ("--port", 1)):
        done = tactilux("status", tiny_night.run, *words)
        assert (done.code, done.out) == (2, "")
        assert "--serve" in done.err
