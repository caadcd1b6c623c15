"""The server of the page: this machine alone, nothing from a network."""

from __future__ import annotations

import errno
import logging
import socket
import webbrowser
from collections.abc import Callable

from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.settings import settings
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPMessageDelegate, HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.routing import Router
from tornado.web import ErrorHandler

from bayes_aero.errors import InputError

ADDRESS = "127.0.0.1"
FORBIDDEN = 403


class LocalOnly(Router):
    """Requests whose Host header names this machine go to the page, all others are refused. A foreign name that
    resolves to 127.0.0.1 could otherwise read the page through the user's browser."""

    def __init__(self, app: BokehTornado, hosts: frozenset[str]) -> None:
        """`hosts`: names with port."""
        self.app, self.hosts = app, hosts

    def find_handler(self, request: HTTPServerRequest, **kwargs: object) -> HTTPMessageDelegate | None:  # noqa: ARG002
        """The page's, or that of a refusal."""
        if request.host.lower() in self.hosts:
            return self.app.find_handler(request)
        return self.app.get_handler_delegate(request, ErrorHandler, {"status_code": FORBIDDEN})


class PageServer:
    """A running server; `url` is its address."""

    def __init__(self, fill: Callable[[Document], None], port: int = 0) -> None:
        """Listen at once.

        Args:
            fill: makes the page of one visitor.
            port: of this machine; 0: any free one.

        Raises:
            InputError: the port is taken or may not be used.
        """
        for name in ("bokeh", "tornado"):
            logging.getLogger(name).setLevel(logging.ERROR)
        settings.resources = "server"  # whatever the environment says: no content delivery network,
        settings.allowed_ws_origin = []  # and no other origin
        try:
            listening = socket.create_server((ADDRESS, port))
        except OSError as reason:
            taken = "it is taken" if reason.errno == errno.EADDRINUSE else reason.strerror or reason
            raise InputError(f"port {port} cannot be used ({taken}); give another --port, or none") from None
        listening.setblocking(False)
        self.port = int(listening.getsockname()[1])
        hosts = frozenset(f"{name}:{self.port}" for name in (ADDRESS, "localhost"))
        self.url = f"http://{ADDRESS}:{self.port}/"
        app = BokehTornado({"/": fill}, extra_websocket_origins=sorted(hosts), absolute_url=self.url)
        http = HTTPServer(LocalOnly(app, hosts))
        http.add_socket(listening)
        self.loop = IOLoop.current()
        self._server = BaseServer(self.loop, app, http)

    def serve(self, *, browser: bool = False) -> None:
        """Until Ctrl-C; `browser`: open the page in the user's."""
        self._server.start()
        if browser:
            self.loop.add_callback(webbrowser.open, self.url)
        try:
            self.loop.start()
        except KeyboardInterrupt:
            pass
        finally:
            self.stop()

    def stop(self) -> None:
        """Take no more requests."""
        self._server.stop(wait=False)
