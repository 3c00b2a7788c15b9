"""Who is let in to a page: the address with its token, from this machine's own name, and nobody else."""

from __future__ import annotations

import asyncio
import errno
import http.client
import re
import socket
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from bokeh.document import Document
from bokeh.models import Div, Widget
from bokeh.util.token import generate_jwt_token, generate_session_id
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from ddic.errors import InputError
from ddic.page import server
from ddic.page.draw import make_draw_page
from ddic.page.drawn_case import DrawnCase
from ddic.page.server import start_in_thread, start_server

LIMIT = 20.0
"""Seconds after which an answer counts as missing; one takes milliseconds."""


@dataclass
class Served:
    """A page that is served, and the documents that were made of it."""

    address: str
    documents: list[Document] = field(default_factory=list)

    @property
    def port(self) -> int:
        port = urlsplit(self.address).port
        assert port is not None
        return port

    @property
    def token(self) -> str:
        return urlsplit(self.address).query

    def ask(self, path: str, method: str = "GET", headers: Mapping[str, str] | None = None) -> tuple[int, str]:
        """Status and body of an answer to a request as it stands, which no client has put right."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=LIMIT)
        try:
            connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            usual = {"Host": f"localhost:{self.port}", "Content-Length": "0"}
            for name, value in (usual | dict(headers or {})).items():
                connection.putheader(name, value)
            connection.endheaders()
            answer = connection.getresponse()
            return answer.status, answer.read().decode(errors="replace")
        finally:
            connection.close()

    def connect(self, query: str, session: str, headers: Mapping[str, str]) -> str | None:
        """The first message of the page's connection; None where it is closed without a word, or refused."""
        request = HTTPRequest(f"ws://127.0.0.1:{self.port}/ws?{query}", request_timeout=LIMIT, connect_timeout=LIMIT,
                              headers={"Host": f"localhost:{self.port}"} | dict(headers))

        async def talk() -> str | None:
            try:
                connection = await websocket_connect(request, subprotocols=["bokeh", session])
            except HTTPClientError:
                return None
            message = await asyncio.wait_for(connection.read_message(), LIMIT)
            connection.close()
            return None if message is None else str(message)

        return asyncio.run(talk())

    def find_session(self) -> str:
        """What the page's own connection names beside the token of the address."""
        status, body = self.ask(f"/?{self.token}")
        found = re.search(r'"token":"([^"]+)"', body)
        assert status == 200
        assert found
        return found[1]


@pytest.fixture(scope="module")
def served() -> Served:
    documents: list[Document] = []

    def make(document: Document) -> None:
        documents.append(document)
        document.add_root(Div(text="the page"))

    return Served(start_in_thread(make), documents)


def test_the_address_opens_the_page(served: Served) -> None:
    n_before = len(served.documents)
    status, body = served.ask(f"/?{served.token}")
    assert status == 200
    assert "bokeh" in body
    assert len(served.documents) == n_before + 1
    # Of 256 bits.
    assert len(served.token) >= len("token=") + 43


@pytest.mark.parametrize("query", [
    "", "?", "?token=", "?token=x", "?Token={token}", "?token={token}x", "?token={start}", "?token={token}&token=x",
    "?other={token}", "?token=%E2%82%AC"])
def test_without_the_token_nobody_is_let_in(served: Served, query: str) -> None:
    token = served.token.removeprefix("token=")
    n_before = len(served.documents)
    for path in ("/", "/autoload.js", "/metadata", "/ws"):
        answer = served.ask(path + query.format(token=token, start=token[:-1]))
        assert answer[0] in (400, 403)
        assert token not in answer[1]
    assert len(served.documents) == n_before


def test_bytes_that_are_no_text_are_no_token(served: Served) -> None:
    assert served.ask("/?token=%ff")[0] == 400


@pytest.mark.parametrize("host", [
    "127.0.0.1", "127.0.0.1:{port}", "[::1]:{port}", "0.0.0.0:{port}", "evil.example", "evil.example:{port}",
    "localhost.evil.example:{port}", "xlocalhost:{port}", ""])
def test_other_names_of_the_machine_are_refused(served: Served, host: str) -> None:
    """A site may give its own name this machine's address: the browser then asks here, under that name."""
    n_before = len(served.documents)
    for path in ("/", "/autoload.js", "/metadata"):
        status, _ = served.ask(f"{path}?{served.token}", headers={"Host": host.format(port=served.port)})
        assert status in (400, 403)
    assert len(served.documents) == n_before


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
def test_nothing_is_sent_here(served: Served, method: str) -> None:
    """With the token or without, of this page's or of another one's origin."""
    n_before = len(served.documents)
    for headers in ({}, {"Origin": "http://evil.example"}, {"Origin": f"http://localhost:{served.port}"}):
        for query in ("", f"?{served.token}"):
            assert served.ask(f"/{query}", method, headers)[0] in (403, 405)
    assert len(served.documents) == n_before


@pytest.mark.parametrize("path", [
    "/absent", "/etc/passwd", "/../etc/passwd", "/..%2f..%2fetc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "//etc/passwd",
    "/static/../../../../../../../etc/passwd", "/static/..%2f..%2f..%2f..%2f..%2f..%2fetc%2fpasswd",
    "/static//etc/passwd", "/static/%2fetc%2fpasswd", "/static/extensions/..%2f..%2fetc%2fpasswd", "/static/",
    "/static/js/", "/static/extensions/", "/static/js/../../server.py", "/case.toml", "/f.tif"])
def test_no_file_is_served(served: Served, path: str) -> None:
    for query in ("", f"?{served.token}"):
        status, body = served.ask(path + query)
        assert status in (400, 403, 404)
        assert "root:" not in body


def test_files_of_bokeh_are(served: Served) -> None:
    """The page's own scripts; nothing comes from the net."""
    assert served.ask("/static/js/bokeh.min.js")[0] == 200
    _, body = served.ask(f"/?{served.token}")
    sources = re.findall(r'(?:src|href)="([^"]*)"', body)
    assert sources
    assert all(urlsplit(source).netloc in ("", f"localhost:{served.port}") for source in sources)


def test_the_pages_own_connection_is_accepted(served: Served) -> None:
    said = served.connect(served.token, served.find_session(), {"Origin": f"http://localhost:{served.port}"})
    assert said is not None
    assert '"msgtype": "ACK"' in said


@pytest.mark.parametrize(("query", "headers"), [
    ("{token}", {"Origin": "http://evil.example"}),
    ("{token}", {"Origin": "null"}),
    ("{token}", {"Origin": "http://localhost:1"}),
    ("{token}", {"Origin": "http://localhost.evil.example:{port}"}),
    ("", {"Origin": "http://localhost:{port}"}),
    ("token=x", {"Origin": "http://localhost:{port}"}),
    ("{token}", {"Origin": "http://localhost:{port}", "Host": "evil.example:{port}"}),
    ("{token}", {"Origin": "http://evil.example:{port}", "Host": "evil.example:{port}"}),
])
def test_connections_of_others_are_refused(served: Served, query: str, headers: dict[str, str]) -> None:
    """By the origin, by the token, by the name: also where they know a session, or make one of their own."""
    values = {"token": served.token, "port": served.port}
    known = served.find_session()
    own = generate_jwt_token(generate_session_id(signed=False), signed=False)
    n_before = len(served.documents)
    for session in (known, own):
        filled = {name: value.format(**values) for name, value in headers.items()}
        assert served.connect(query.format(**values), session, filled) is None
    assert len(served.documents) == n_before


def test_it_listens_to_this_machine_alone(served: Served) -> None:
    """Another address of the same network, which all addresses would be heard under, is refused."""
    socket.create_connection(("127.0.0.1", served.port), timeout=LIMIT).close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", served.port), timeout=LIMIT)


def test_a_port_that_is_taken_is_told(served: Served) -> None:
    async def start() -> None:
        start_server(lambda document: None, served.port)

    with pytest.raises(InputError, match=rf"--port {served.port}: is taken, or not allowed"):
        asyncio.run(start())


def test_who_waits_for_an_address_hears_that_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a notebook does, which would wait for ever."""
    def refuse(*args: object, **options: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(server, "Server", refuse)
    with pytest.raises(InputError, match=r"^no port of 127\.0\.0\.1 can be opened .*Operation not permitted"):
        start_in_thread(lambda document: None)


def test_pages_have_tokens_of_their_own(served: Served) -> None:
    other = Served(start_in_thread(lambda document: document.add_root(Div())))
    assert other.token != served.token
    assert other.ask(f"/?{served.token}")[0] == 403
    assert other.ask(f"/?{other.token}")[0] == 200


def test_tabs_have_documents_of_their_own(drawn: DrawnCase, folder: Path) -> None:
    """Through the server: what is drawn in one document is not in the other, and nothing is written."""
    documents: list[Document] = []

    def make(document: Document) -> None:
        make_draw_page(drawn, document)
        documents.append(document)

    served = Served(start_in_thread(make))
    for _ in range(2):
        assert served.ask(f"/?{served.token}")[0] == 200
    one, other = ({model.title: model for model in document.models if isinstance(model, Widget)
                   and hasattr(model, "title")} for document in documents)
    case, size = str(folder / "case.toml"), "Element size (px)"
    before = other[case].value
    done: Future[None] = Future()

    def change() -> None:
        one[case].value = before.replace("element_size = 16", "element_size = 8")
        done.set_result(None)

    documents[0].add_next_tick_callback(change)
    done.result(LIMIT)
    assert (one[size].value, other[size].value) == (8, 16)
    assert other[case].value == before
    assert not (folder / "case.toml").exists()
