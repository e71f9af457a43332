# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The watch as a page in the browser, served on the loopback address alone.

Python's own http.server with server-sent events: one stream a browser, some lines of JSON a
second, and a POST a command; a library would bring more than it saves. Who may ask: pages of this
server only. The Host header keeps out names that somebody else's DNS points here, Origin and the
content type keep out forms of other pages; other users of this machine get in, as they do into the
ROS graph on its loopback.
"""
from __future__ import annotations

import base64
from collections.abc import Iterator
import contextlib
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
import io
import json
import math
import socket
import threading
import time
from typing import Any
from urllib.parse import parse_qs, urlsplit

from PIL import Image
import numpy as np

from carracing_dqn.watch.source import Source
from msgs_bridge.errors import BridgeError

HOST = '127.0.0.1'
PORT = 8787
# from one line of a stream to the next, and from one set of plots to the next; seconds
SEND_SECONDS, PLOT_SECONDS = 0.25, 1.0
# a browser that takes nothing for so long is left; seconds
SOCKET_SECONDS = 10.0
MAX_STREAMS = 8
# at a time; each has a thread
MAX_CONNECTIONS = 64
# of a command
MAX_BODY = 1024
FILES = {
    '/': ('page.html', 'text/html'),
    '/page.css': ('page.css', 'text/css'),
    '/page.js': ('page.js', 'text/javascript'),
}
HEADERS = {
    'Content-Security-Policy':
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    'X-Content-Type-Options': 'nosniff',
    'Referrer-Policy': 'no-referrer',
    'Cache-Control': 'no-store',
}


class Page:
    """
    A server of the page in a thread of its own.

    Attributes:
        url: where it is.
    """

    def __init__(self, source: Source, port: int = PORT) -> None:
        """
        Begin to serve.

        Args:
            source: what is watched.
            port: on the loopback address; 0 takes a free one.

        Raises:
            BridgeError: the port is taken.
        """
        try:
            self._server = _Server((HOST, port), _Handler)
        except OSError as error:
            raise BridgeError(f'port {port} of {HOST}: {error.strerror}; --port chooses '
                              'another') from None
        self._server.source = source
        self.url = f'http://{HOST}:{self._server.server_port}/'
        self._thread = threading.Thread(
            target=self._server.serve_forever, name='page', daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End every stream and the server."""
        self._server.closing.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(timeout=1.0)


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    # a browser opens some connections at once, and a flood of them waits in the kernel
    request_queue_size = 32
    source: Source

    def __init__(self, *arguments: Any) -> None:
        self.closing = threading.Event()
        self.streams = threading.BoundedSemaphore(MAX_STREAMS)
        # when each connection is cut
        self.ends_at: dict[Any, float] = {}
        super().__init__(*arguments)

    def verify_request(self, request: Any, client_address: Any) -> bool:
        """Take a connection, if there is room for it."""
        if len(self.ends_at) >= MAX_CONNECTIONS:
            return False
        self.ends_at[request] = time.monotonic() + SOCKET_SECONDS
        return True

    def close_request(self, request: Any) -> None:
        """Let go of a connection."""
        self.ends_at.pop(request, None)
        super().close_request(request)

    def service_actions(self) -> None:
        """Cut those who take too long over a request, by a byte now and then for one."""
        for request, end in list(self.ends_at.items()):
            if time.monotonic() > end:
                with contextlib.suppress(OSError):
                    request.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: a browser has gone, or sent what is no HTTP."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = SOCKET_SECONDS
    server_version, sys_version = 'carracing', ''

    def do_GET(self) -> None:
        """Answer with a file of the page or with the stream."""
        if not self._is_for_us():
            return
        address = urlsplit(self.path)
        if address.path == '/events':
            self._stream(parse_qs(address.query))
        elif address.path in FILES:
            name, kind = FILES[address.path]
            data = files(__package__).joinpath(name).read_bytes()
            self._answer(HTTPStatus.OK, data, f'{kind}; charset=utf-8')
        else:
            self._answer(HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        """Carry out a command: a JSON object with `name`, `value` and `namespace`."""
        if not self._is_for_us():
            return
        own = f'http://{self.headers["Host"]}'
        kind = self.headers.get_content_type()
        if self.path != '/act':
            self._answer(HTTPStatus.NOT_FOUND)
        elif self.headers.get('Origin', own) != own or kind != 'application/json':
            self._answer(HTTPStatus.FORBIDDEN)
        else:
            self._act()

    def log_message(self, *_: object) -> None:
        """Say nothing."""

    def _is_for_us(self) -> bool:
        port = self.server.server_port
        good = self.headers.get('Host') in (f'{HOST}:{port}', f'localhost:{port}')
        if not good:
            self._answer(HTTPStatus.FORBIDDEN)
        return good

    def _act(self) -> None:
        try:
            length = int(self.headers.get('Content-Length', ''))
            if not 0 < length <= MAX_BODY:
                raise ValueError('too long')
            wish = json.loads(self.rfile.read(length))
            name, value, namespace = wish['name'], wish.get('value'), wish.get('namespace')
            if not isinstance(name, str) or not isinstance(namespace, (str, type(None))):
                raise TypeError('no text')
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            self._answer(HTTPStatus.BAD_REQUEST)
            return
        try:
            self.server.source.act(name, value, namespace)
        except BridgeError as error:
            self._answer(HTTPStatus.BAD_REQUEST, str(error).encode(), 'text/plain; charset=utf-8')
            return
        self._answer(HTTPStatus.NO_CONTENT)

    def _stream(self, query: dict[str, list[str]]) -> None:
        if not self.server.streams.acquire(blocking=False):
            self._answer(HTTPStatus.SERVICE_UNAVAILABLE)
            return
        try:
            self.server.ends_at[self.request] = math.inf
            self._head(HTTPStatus.OK, 'text/event-stream')
            # a browser that has gone shows when something is sent to it
            with contextlib.suppress(OSError):
                for line in self._lines(query):
                    self.wfile.write(line)
                    self.wfile.flush()
        finally:
            self.server.streams.release()

    def _lines(self, query: dict[str, list[str]]) -> Iterator[bytes]:
        source = self.server.source
        car = query['car'][0] if 'car' in query else None
        plots = query.get('plot', [])[:20]
        number, plots_at = None, 0.0
        while not self.server.closing.is_set():
            # the time of a bag stands while it is paused, that of plots does not
            shown = source.state.snapshot(source.now(), car, plots)
            shown['commands'] = list(source.commands)
            picture = shown['picture']
            if picture is not None and (shown['namespace'], picture['number']) != number:
                pixels = source.state.pixels(car)
                # a bag that is wound back has none for a moment
                if pixels is not None:
                    number = shown['namespace'], picture['number']
                    picture['data'] = picture_url(pixels)
            wall = time.monotonic()
            if wall < plots_at:
                del shown['plots'], shown['series']
            else:
                plots_at = wall + PLOT_SECONDS
            # ASCII, so that no sign can end the line
            yield f'data: {json.dumps(shown, allow_nan=False)}\n\n'.encode('ascii')
            self.server.closing.wait(SEND_SECONDS)

    def _answer(
        self, status: HTTPStatus, data: bytes = b'', kind: str = 'text/plain',
    ) -> None:
        self._head(status, kind, len(data))
        self.wfile.write(data)

    def _head(self, status: HTTPStatus, kind: str, length: int | None = None) -> None:
        self.send_response(status)
        self.send_header('Content-Type', kind)
        if length is not None:
            self.send_header('Content-Length', str(length))
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.end_headers()


def picture_url(pixels: np.ndarray) -> str:
    """Return a picture, uint8 (H, W, 3) rgb, as the data URL of a PNG."""
    file = io.BytesIO()
    # 96x96 takes 1 ms
    Image.fromarray(np.ascontiguousarray(pixels)).save(file, 'PNG', compress_level=1)
    return 'data:image/png;base64,' + base64.b64encode(file.getvalue()).decode('ascii')
