"""Who may connect, for how long, and with which headers they are answered."""

import asyncio
import hmac
import logging
import time
from collections.abc import Awaitable, Callable, Collection
from urllib.parse import urlsplit

from aiohttp import web

_LOCAL = ("localhost", "127.0.0.1", "::1")
# A connection that is no open page ends after so long, so a slow one does not keep its place.
_REQUEST_S = 10.0
# Most connections that are no open page; a further one takes the place of the oldest.
_MOST_WAITING = 32
# Least time between two lines of the log about faults of requests.
_LOG_PERIOD_S = 60.0
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


def access_check(token: str) -> Callable[..., Awaitable[web.StreamResponse]]:
    """Middleware that refuses requests without the token, and those of pages of other sites.

    Parameters
    ----------
    token : str
        `?token=` of each address; empty: only requests to this machine by its name are answered.
    """

    @web.middleware
    async def check(
        request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        try:
            _refuse_strangers(request, token)
            response = await handler(request)
        except web.HTTPException as error:
            error.force_close()
            raise
        if not isinstance(response, web.WebSocketResponse):
            response.force_close()  # one request for each connection
        return response

    return check


def _refuse_strangers(request: web.Request, token: str) -> None:
    """Raise `HTTPForbidden` for what `access_check` refuses."""
    if token:
        given = request.query.get("token", "")
        if not hmac.compare_digest(given.encode(errors="replace"), token.encode()):
            raise web.HTTPForbidden(text="Token missing or wrong: use the printed address.")
    elif _host_name(f"//{request.host}") not in _LOCAL:
        raise web.HTTPForbidden(text="Only for this machine: use localhost, or --host.")
    origin = request.headers.get("Origin")
    if origin is not None and _place(origin) != request.host:
        raise web.HTTPForbidden(text="Request of another site refused.")


def _host_name(address: str) -> str | None:
    try:
        return urlsplit(address).hostname
    except ValueError:  # such as [ without ]
        return None


def _place(origin: str) -> str | None:
    try:
        return urlsplit(origin).netloc
    except ValueError:
        return None


async def add_headers(_: web.Request, response: web.StreamResponse) -> None:
    """Add the headers that protect pages to a response that does not have them."""
    for name, value in _HEADERS.items():
        response.headers.setdefault(name, value)


class Gate:
    """Factory of the server's connections, which bounds their number and time.

    Parameters
    ----------
    server : Server
        Of aiohttp.
    pages : callable
        Returns the connections of open pages, which are not bounded here.
    """

    def __init__(
        self, server: web.Server, pages: Callable[[], Collection[asyncio.BaseProtocol]]
    ) -> None:
        self._server = server
        self._pages = pages

    def __call__(self) -> asyncio.Protocol:
        """Protocol of a new connection."""
        pages = self._pages()
        waiting = [each for each in self._server.connections if each not in pages]
        for oldest in waiting[: len(waiting) - _MOST_WAITING + 1]:
            _abort(oldest)
        connection = self._server()
        asyncio.get_running_loop().call_later(_REQUEST_S, self._end, connection)
        return connection

    def _end(self, connection: web.RequestHandler) -> None:
        if connection not in self._pages():
            _abort(connection)


def _abort(connection: web.RequestHandler) -> None:
    if connection.transport is not None:
        connection.transport.abort()


def request_logger() -> logging.Logger:
    """Logger for faults of requests: one line, and no more than one a minute."""
    logger = logging.getLogger("coded_aperture_viewer.requests")
    logger.filters = [_Seldom()]
    return logger


class _Seldom(logging.Filter):
    def __init__(self) -> None:
        super().__init__()
        self._next_s = 0.0

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether enough time has passed; the traceback is left out."""
        now = time.monotonic()
        is_due = now >= self._next_s
        if is_due:
            self._next_s = now + _LOG_PERIOD_S
            if record.exc_info and record.exc_info[1] is not None:
                record.msg = f"{record.getMessage()}: {record.exc_info[1]!r}"
                record.args = ()
            record.exc_info = None
        return is_due
