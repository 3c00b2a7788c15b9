"""The server of a page: whom it answers, and what is left where it, a tab or the browser ends at a bad moment."""

from __future__ import annotations

import asyncio
import http.client
import os
import random
import re
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import psutil
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from accept.drawn_cases import draw_plate
from accept.page_mistakes import CASE, TEXT
from accept.support.browser import NotSeenError, ServedPage, Tab, opened_browser, wait_until
from accept.support.ended_job import list_hidden
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import images
from ddic.io.result_reader import read_result

if TYPE_CHECKING:
    from playwright.sync_api import Browser

EVIL = "http://evil.example"
"""Another site that the browser has open."""

ANSWER_S = 10.0


@dataclass(frozen=True)
class Request:
    """A request to the server of a page, by default one that it answers.

    Attributes
    ----------
    name : str
        What is tried.
    path : str
        With its query, in which TOKEN stands for the token.
    host, origin : str or None
        Headers; None for those of the page itself.
    method : str
        Of HTTP; WS for a websocket.
    session : str or None
        Of a websocket; None for one that the server began for a page.
    """

    name: str
    path: str = "/?token=TOKEN"
    host: str | None = None
    origin: str | None = None
    method: str = "GET"
    session: str | None = None


REFUSED = (
    Request("no token", "/"),
    Request("an empty token", "/?token="),
    Request("a wrong token", "/?token=abc"),
    Request("a token cut short", "/?token=TOKE"),
    Request("two tokens, the wrong one last", "/?token=TOKEN&token=abc"),
    Request("the token of another server", "/?token=OTHER"),
    Request("a session of another page, no token", "/?bokeh-session-id=SESSION"),
    Request("what the server holds, no token", "/metadata"),
    Request("the page as a script, no token", "/autoload.js?bokeh-autoload-element=1"),
    Request("another host", host="evil.example"),
    Request("another host with the port", host="evil.example:PORT"),
    Request("a host that begins with localhost", host="localhost.evil.example:PORT"),
    Request("the number of this machine", host="127.0.0.1:PORT"),
    Request("no host", host=""),
    Request("another path", "/other?token=TOKEN"),
    Request("the case file", f"/{CASE}?token=TOKEN"),
    Request("the folder above", "/../../etc/passwd?token=TOKEN"),
    Request("the folder above, encoded", "/%2e%2e/%2e%2e/etc/passwd?token=TOKEN"),
    Request("above the scripts", "/static/../../../../../../etc/passwd?token=TOKEN"),
    Request("above the scripts, encoded", "/static/%2e%2e/%2e%2e/%2e%2e/%2e%2e/etc/passwd?token=TOKEN"),
    Request("above the scripts, slashes too", "/static/..%2f..%2f..%2f..%2fetc/passwd?token=TOKEN"),
    Request("a form of another site", origin=EVIL, method="POST"),
    Request("a form of another site, no token", "/", origin=EVIL, method="POST"),
    Request("a form at the websocket", "/ws?token=TOKEN", origin=EVIL, method="POST"),
    Request("a websocket of another site", "/ws?token=TOKEN", origin=EVIL, method="WS"),
    Request("a websocket of another port", "/ws?token=TOKEN", origin="http://localhost:1", method="WS"),
    Request("a websocket of a sandbox", "/ws?token=TOKEN", origin="null", method="WS"),
    Request("a websocket, no token", "/ws", method="WS"),
    Request("a websocket, a wrong token", "/ws?token=abc", method="WS"),
    Request("a websocket, the token of another server", "/ws?token=OTHER", method="WS"),
    Request("a websocket, a session of another server, no token", "/ws", method="WS", session="FOREIGN"),
    Request("a websocket, no session", "/ws?token=TOKEN", method="WS", session="abcd"),
)

ANSWERED = (Request("the page"), Request("its websocket", "/ws?token=TOKEN", method="WS"))


@dataclass(frozen=True)
class Asked:
    """A server that is asked, and what requests to it name.

    Attributes
    ----------
    port : int
        Where it listens.
    words : dict of str
        What stands for token, session, port and what belongs to another server.
    """

    port: int
    words: dict[str, str]

    def fill(self, text: str) -> str:
        """Put what is meant in the place of the words."""
        for word, meant in self.words.items():
            text = text.replace(word, meant)
        return text

    def is_answered(self, request: Request) -> bool:
        """Tell whether a request is answered, with 200 or by a websocket that says something."""
        own = f"localhost:{self.port}"
        path = self.fill(request.path)
        if request.method == "WS":
            session = self.fill("SESSION" if request.session is None else request.session)
            origin = f"http://{own}" if request.origin is None else request.origin
            return asyncio.run(_open_websocket(f"ws://{own}{path}", origin, session))
        headers = {"Host": own if request.host is None else self.fill(request.host)}
        headers |= {} if request.origin is None else {"Origin": request.origin}
        return _ask(self.port, request.method, path, headers)[0] < 400


def _ask(port: int, method: str, path: str, headers: dict[str, str]) -> tuple[int, str]:
    """Status and text of an answer; the path is sent as it is."""
    form = b"a=b" if method == "POST" else None
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=ANSWER_S)
    connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
    more = {} if form is None else {"Content-Type": "application/x-www-form-urlencoded", "Content-Length": "3"}
    for name, value in (headers | more).items():
        connection.putheader(name, value)
    connection.endheaders(form)
    answer = connection.getresponse()
    text = answer.read().decode(errors="replace")
    connection.close()
    return answer.status, text


async def _open_websocket(address: str, origin: str, session: str) -> bool:
    """Whether a websocket is opened on which the server says something before it closes it."""
    request = HTTPRequest(address, headers={"Origin": origin}, request_timeout=ANSWER_S)
    try:
        socket = await websocket_connect(request, subprotocols=["bokeh", session])
    except HTTPClientError:
        return False
    said = await asyncio.wait_for(socket.read_message(), ANSWER_S)
    socket.close()
    return said is not None


def measure_requests(scale: Scale) -> list[Row]:
    """Ask the server of a page what it must refuse, beside what it answers."""
    folder = scale.folder("page_requests")
    folder.mkdir(parents=True, exist_ok=True)
    draw_plate(folder)
    (folder / CASE).write_text(TEXT, encoding="utf-8")
    with (ServedPage("draw", "images/reference.tif", CASE, folder=folder) as served,
          ServedPage("draw", "images/reference.tif", CASE, folder=folder) as other):
        words = {"TOKEN": served.token, "TOKE": served.token[:-1], "OTHER": other.token, "PORT": str(served.port),
                 "SESSION": _begin_session(served), "FOREIGN": _begin_session(other)}
        asked = Asked(served.port, words)
        wrong = [request.name for request in REFUSED if asked.is_answered(request)]
        unanswered = [request.name for request in ANSWERED if not asked.is_answered(request)]
    return [Row(f"{len(REFUSED)} requests to the server of a page: without its token or with another, of other hosts, "
                "paths, folders above, forms and websockets of other sites, sessions of others",
                f"all refused; the {len(ANSWERED)} of the page itself answered",
                f"{len(REFUSED) - len(wrong)} of {len(REFUSED)} refused ({'; '.join(wrong) or 'none answered'}); "
                f"{len(ANSWERED) - len(unanswered)} of {len(ANSWERED)} answered", not wrong and not unanswered)]


def _begin_session(served: ServedPage) -> str:
    """A session as a page that is opened gets it."""
    host = f"localhost:{served.port}"
    _, text = _ask(served.port, "GET", f"/?token={served.token}", {"Host": host})
    return str(re.findall(r'"token":"([^"]+)"', text)[0])


N_KILLS, N_CLOSED = 20, 30

LONG = 4_000_000
"""Characters of a comment that makes a case long to write."""

LATEST_S = 0.005
"""After a write has begun, in which the server is killed."""

GONE_S = 10.0
"""Seconds in which a server ends that is told to."""

_SEED = 5


def measure_ends(scale: Scale) -> list[Row]:
    """End servers, tabs and the browser at bad moments."""
    if scale.smoke:
        return []
    folder = scale.folder("page_ends")
    folder.mkdir(parents=True, exist_ok=True)
    draw_plate(folder)
    draw = random.Random(_SEED)
    with opened_browser() as browser:
        rows = [_kill_while_writing(browser, folder, draw), _close_tabs(browser, folder, draw),
                _interrupt(browser, folder)]
    return [*rows, _close_browser(folder)]


@dataclass
class _Kills:
    """What was found after kills."""

    faults: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)


def _kill_while_writing(browser: Browser, folder: Path, draw: random.Random) -> Row:
    """Kill servers that write a long case; each begins with a write that nothing disturbs."""
    case, found = folder / CASE, _Kills()
    case.write_text(_lengthen("begun"), encoding="utf-8")
    for number in range(N_KILLS):
        with ServedPage("draw", "images/reference.tif", CASE, folder=folder) as served:
            tab = Tab(browser, served.address)
            old, new = _lengthen(f"{number} old"), _lengthen(f"{number} new")
            _write(tab, old)
            wait_until(lambda: case.read_text(encoding="utf-8") == old, "the old text")  # noqa: B023  waited for here
            if list_hidden(folder):
                found.faults.append(f"{number}: {list_hidden(folder)} left after the next write")
            killer = threading.Thread(target=_kill_writer, args=(served, folder, draw.uniform(0.0, LATEST_S)))
            killer.start()
            _write(tab, new)
            killer.join()
            served.process.wait()
            tab.close()
        text = case.read_text(encoding="utf-8")
        found.counts["old" if text == old else "new" if text == new else "partial"] += 1
        found.counts["temporary"] += bool(list_hidden(folder))
    _remove_temporary(browser, folder, found)
    counts, faults = found.counts, found.faults
    return Row(f"{N_KILLS} kills of ddic draw within {LATEST_S:g} s after it has begun to write a case of "
               f"{LONG / 1e6:g} MB", "the file whole, as it was or is to be; the next write removes what is left",
               f"old {counts['old']}, new {counts['new']}, partial {counts['partial']}; {counts['temporary']} left a "
               f"temporary file; faults: {'; '.join(faults) or 'none'}", not counts["partial"] and not faults)


def _lengthen(word: str) -> str:
    return f"{TEXT}# {word} {'x' * LONG}\n"


def _write(tab: Tab, text: str) -> None:
    tab.fill(CASE, text)
    tab.press("Write the case")


def _kill_writer(served: ServedPage, folder: Path, delay: float) -> None:
    """Kill a server a while after its temporary file has come; looked for without a pause, as it is there shortly."""
    end = time.monotonic() + 6 * GONE_S
    own = f".{served.process.pid}.tmp"
    while not any(name.endswith(own) for name in os.listdir(folder)) and time.monotonic() < end:
        pass
    time.sleep(delay)
    served.process.kill()


def _remove_temporary(browser: Browser, folder: Path, found: _Kills) -> None:
    """Write once more, after the last kill."""
    case = folder / CASE
    with ServedPage("draw", "images/reference.tif", CASE, folder=folder) as served:
        tab = Tab(browser, served.address)
        _write(tab, TEXT)
        wait_until(lambda: case.read_text(encoding="utf-8") == TEXT, "the last text")
        tab.close()
    if list_hidden(folder):
        found.faults.append(f"{list_hidden(folder)} left after the last write")


def _close_tabs(browser: Browser, folder: Path, draw: random.Random) -> Row:
    """Close tabs while images are sent to them, and open one more."""
    (folder / CASE).write_text(TEXT, encoding="utf-8")
    with ServedPage("draw", "images/reference.tif", CASE, folder=folder) as served:
        for _ in range(N_CLOSED):
            tab = Tab(browser, served.address)
            tab.page.mouse.move(*tab.place((128, 128)))
            tab.page.mouse.wheel(0, -300)
            time.sleep(draw.uniform(0.0, 0.3))
            tab.close()
        is_served = served.process.poll() is None
        if is_served:
            Tab(browser, served.address).close()
        errors = served.read_errors().count("Traceback")
    return Row(f"{N_CLOSED} tabs closed within 0.3 s after a zoom, while the case is checked and images are sent",
               "the next one is served; no error of the server",
               f"{'served' if is_served else f'the server ended with {served.process.returncode}'}; {errors} errors",
               is_served and errors == 0)


LONG_CASE = """\
[images]
reference = "long/reference.tif"
deformed = "long/deformed.tif"

[mesh.structured]
region = [20, 20, 780, 780]
element_size = 6
circles = [{ center = [400, 400], radius = 90 }]

[output]
file = "long.vtkhdf"
uncertainty = true
"""

RUN_S = 1.0
"""After a run has begun, before the browser or the server ends."""


def _start_run(tab: Tab, served: ServedPage) -> psutil.Process:
    """Start a run of a few seconds, and find its process."""
    tab.press("Run")

    def find() -> list[psutil.Process]:
        with suppress(psutil.NoSuchProcess):
            return [child for child in served.process.children() if "run" in child.cmdline()]
        return []

    wait_until(lambda: bool(find()), "the run has begun")
    run: psutil.Process = find()[0]
    time.sleep(RUN_S)
    return run


def _prepare_run(folder: Path) -> None:
    images("kirsch", "--size", "800x800", "--strain", "0.005", "--radius", "80", "--noise", "2", "--seed", "1",
           folder=folder / "long")
    (folder / CASE).write_text(LONG_CASE, encoding="utf-8")
    for path in folder.glob("long.*"):
        path.unlink()


def _judge_run(what: str, was_running: bool, folder: Path, more: Sequence[tuple[str, bool]]) -> Row:
    """Whether a run that was running then has left its result."""
    path = folder / "long.vtkhdf"
    is_there = path.is_file() and (folder / "long.json").is_file()
    verdict = read_result(path).verdict if is_there else None
    said = [f"{name}: {'yes' if holds else 'no'}" for name, holds in more]
    return Row(f"{what} {RUN_S:g} s into a run of 6-px Q4 on 800 x 800 px, output.uncertainty = true",
               "the run goes on, and its result is there",
               f"running then: {'yes' if was_running else 'no'}; {'; '.join([*said, ''])}result: "
               f"{'none' if verdict is None else verdict.word}",
               was_running and verdict is not None and all(holds for _, holds in more))


def _wait_for(run: psutil.Process) -> None:
    """Wait until a run is gone; one of a living server stays as a zombie until that looks."""
    def is_gone() -> bool:
        return not run.is_running() or run.status() == psutil.STATUS_ZOMBIE

    wait_until(is_gone, "the end of the run", longest=300.0)


def _close_browser(folder: Path) -> Row:
    """Close the browser during a run; the next one shows the result."""
    _prepare_run(folder)
    with ServedPage("draw", "long/reference.tif", CASE, folder=folder) as served:
        with opened_browser() as browser:
            run = _start_run(Tab(browser, served.address), served)
        was_running = run.is_running() and run.status() != psutil.STATUS_ZOMBIE
        _wait_for(run)
        with opened_browser() as browser:
            Tab(browser, served.address).close()
        return _judge_run("the browser closed", was_running, folder, [])


def _interrupt(browser: Browser, folder: Path) -> Row:
    """Have a server end by Ctrl-C during a run."""
    _prepare_run(folder)
    with ServedPage("draw", "long/reference.tif", CASE, folder=folder) as served:
        tab = Tab(browser, served.address)
        run = _start_run(tab, served)
        # As the terminal does, to all processes of the command's group.
        os.killpg(os.getpgid(served.process.pid), signal.SIGINT)
        has_ended = _has_come(lambda: served.process.poll() is not None)
        was_running = run.is_running()
        _wait_for(run)
        is_clean = served.process.returncode == 0 and "Traceback" not in served.read_errors()
        tab.close()
    return _judge_run("Ctrl-C", was_running, folder,
                      [(f"server gone within {GONE_S:g} s", has_ended), ("with exit code 0, no traceback", is_clean)])


def _has_come(what: Callable[[], bool]) -> bool:
    try:
        wait_until(what, "the end", GONE_S)
    except NotSeenError:
        return False
    return True
