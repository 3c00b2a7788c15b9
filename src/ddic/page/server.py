"""Serves a page to the browser of one user on this machine: who may ask for it, and where it is found."""

from __future__ import annotations

import asyncio
import importlib
import secrets
import signal
import webbrowser
from collections.abc import Callable
from concurrent.futures import Future
from threading import Thread

from bokeh.core.validation import silence
from bokeh.core.validation.warnings import MISSING_RENDERERS
from bokeh.document import Document
from bokeh.server.auth_provider import AuthProvider
from bokeh.server.server import Server
from tornado.web import HTTPError, RequestHandler

from ddic.errors import InputError

HERE = "127.0.0.1"
NAME = "localhost"
"""Of this machine, and of the near end of a tunnel, which has the same port."""

MakePage = Callable[[Document], None]


class _TokenAuth(AuthProvider):  # type: ignore[misc]  # bokeh's, whose types are not read
    """Lets those in who know the token of the address that was printed.

    Other names of the host are refused, by which another site could reach this machine through the browser.

    Parameters
    ----------
    token : str
        Of the address.
    """

    def __init__(self, token: str) -> None:
        self.token = token
        super().__init__()

    @property
    def get_user(self) -> Callable[[RequestHandler], str]:
        """How a request is judged."""
        return self._judge

    def _judge(self, handler: RequestHandler) -> str:
        if handler.request.host_name != NAME:
            raise HTTPError(403, reason="this page answers to localhost alone")
        # The page's own connection repeats the address; no cookie is left behind that another page could use.
        given = handler.get_query_argument("token", "")
        if not secrets.compare_digest(given.encode(), self.token.encode()):
            raise HTTPError(403, reason="open the address with its token, as the command printed it")
        return "user"

    @property
    def login_url(self) -> str:
        """Where bokeh sends those who are not known; nobody, as they are refused before."""
        return "/"

    # Other ways of bokeh to know a user.
    get_user_async = get_login_url = login_handler = logout_url = logout_handler = None


def start_server(make_page: MakePage, port: int = 0) -> tuple[Server, str]:
    """Start to serve a page; return the server and the address, with its token, under which it is found.

    Every tab has a document of its own. ``port`` 0 takes one that is free. Raises InputError where it cannot be opened.
    """
    token = secrets.token_urlsafe()
    # Figures of curves are empty until there are probes.
    silence(MISSING_RENDERERS)
    try:
        # Nothing is compressed: speckle shrinks by a quarter, which takes longer than to send it.
        server = Server({"/": make_page}, port=port, address=HERE, auth_provider=_TokenAuth(token))
    except OSError as error:
        problem = (f"--port {port}: is taken, or not allowed ({error.strerror}); give another one, or leave it out"
                   if port else f"no port of {HERE} can be opened for the page ({error.strerror}); allow one here")
        raise InputError(problem) from error
    server.start()
    return server, f"http://localhost:{server.port}/?token={token}"


def _outlive_closed_tabs() -> None:
    """Have a tab that is closed be an error of its connection alone: PETSc, once begun, would end the process."""
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)


def start_in_thread(make_page: MakePage) -> str:
    """Serve a page beside what else this process does, until it ends; return its address, or raise InputError."""
    address: Future[str] = Future()
    # It takes the signal when it begins, which the next measurement of this process would do later.
    importlib.import_module("petsc4py.PETSc")
    _outlive_closed_tabs()

    def serve() -> None:
        asyncio.set_event_loop(asyncio.new_event_loop())
        try:
            server, found = start_server(make_page)
        except Exception as error:
            # To whoever waits for the address.
            address.set_exception(error)
            return
        address.set_result(found)
        server.io_loop.start()

    Thread(target=serve, daemon=True).start()
    return address.result()


def run_server(make_page: MakePage, port: int, announce: Callable[[str], None], *, opens_browser: bool) -> None:
    """Serve a page until Ctrl-C; its address is announced, and opened in a browser where there is one."""
    _outlive_closed_tabs()
    server, address = start_server(make_page, port)
    announce(address)
    if opens_browser:
        webbrowser.open(address)
    try:
        server.io_loop.start()
    except KeyboardInterrupt:
        pass
    finally:
        server.stop()
