"""The door of a server of windows: its page and its websocket open only for requests with its own host, its own
origin and its token.

A browser lets any page connect to any address, this machine's included, and send what its user may send. Three checks
stand against that:

- **Host** has to name this server. A page whose name an attacker resolves to 127.0.0.1 (DNS rebinding) sends its own.
- **Origin** has to be this server. A page of another origin that opens a websocket sends its own.
- **The token**, random for each server, has to be the first part of the path. Only who was given the address has it.

The token is in the path because viser's page opens its websocket at the page's own address without the search
parameters. A cookie would go to every port of this machine and would be dropped in an iframe of a notebook.
"""

import contextlib
import dataclasses
import hmac
import http
import ipaddress
import logging
import secrets
import socket
import threading
from collections.abc import Awaitable, Callable, Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response
else:
    # what only a type checker sees
    ServerConnection = Request = Response = Any

#: names that a browser of this machine uses for it
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
#: hosts that listen at every address of this machine
EVERYWHERE = ("0.0.0.0", "::", "")
REFUSED = (
    "jaxcap: this is not the address of the window. Open the address that the program printed, all of it.\n"
)
#: of every page that is served
HEADERS = {
    # the address holds the token, which no other site may learn
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
}

_patching = threading.Lock()

Handler = Callable[[ServerConnection], Awaitable[None]]
Answer = Callable[[ServerConnection, Request], Response | None]


class Door:
    """The checks of one server.

    **Arguments:** `host` and `port` that it listens at. The `token` is new for each door.
    """

    def __init__(self, host: str, port: int):
        self.host, self.port = host, port
        self.token = secrets.token_urlsafe(24)
        #: ports of the servers that this door guards
        self.guarded: list[int] = []

    @property
    def address(self) -> str:
        """The address to open on this machine, with the token."""
        # no name: what `localhost` resolves to may be another program's
        host = {"0.0.0.0": "127.0.0.1", "": "127.0.0.1", "::": "::1"}.get(self.host, self.host)
        return f"http://{_bracketed(host)}:{self.port}/{self.token}/"

    @property
    def address_elsewhere(self) -> str | None:
        """The address to open on other machines, with the token; None where this server is for its own machine."""
        if self.host not in EVERYWHERE:
            return None
        return f"http://{_bracketed(own_address(self.host))}:{self.port}/{self.token}/"

    def path(self, request: Request) -> str | None:
        """The path that is asked for below the token's, or None where the request is refused."""
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        if len(hosts) != 1 or not self._is_own(hosts[0].lower()):
            return None
        # every browser sends an origin with a websocket; a page that is opened has none
        needed = "Upgrade" in request.headers
        if len(origins) > 1 or (needed and not origins):
            return None
        if origins and origins[0].lower() != f"http://{hosts[0].lower()}":
            return None
        token, _, rest = request.path.partition("?")[0].removeprefix("/").partition("/")
        if not hmac.compare_digest(token.encode("utf-8", "surrogateescape"), self.token.encode()):
            return None
        return f"/{rest}"

    def guard(self, answer: Answer | None) -> Answer:
        """The `process_request` of a websockets server that asks `answer` where the door opens."""

        def guarded(connection: ServerConnection, request: Request) -> Response | None:
            path = self.path(request)
            if path is None:
                return connection.respond(http.HTTPStatus.FORBIDDEN, REFUSED)
            response = None if answer is None else answer(connection, dataclasses.replace(request, path=path))
            if response is not None:
                response.headers.update(HEADERS)
            return response

        return guarded

    def _is_own(self, host: str) -> bool:
        """Whether a `Host` header names this server."""
        name, colon, port = host.rpartition(":")
        if not colon or host.endswith("]"):
            # a browser leaves out the port of http
            name, port = host, "80"
        if port != str(self.port):
            return False
        if name in LOOPBACK or name == _bracketed(self.host.lower()):
            return True
        # an address is nothing that a foreign name could be resolved to
        return self.host in EVERYWHERE and (_is_address(name) or name == socket.gethostname().lower())


@contextlib.contextmanager
def guarding(door: Door) -> Iterator[None]:
    """While this lasts, a websockets server that is made at the door's host is guarded by it.

    viser makes its server in a thread of its own and takes no `process_request`, so `websockets.asyncio.server.serve`
    is replaced meanwhile. Servers at other ports are made as ever. Whoever opens a server looks into `door.guarded`
    afterwards, as another version of viser may make its own in another way.
    """
    import websockets.asyncio.server as module

    class Guarded(module.serve):
        def __init__(self, handler, host=None, port=None, *, process_request=None, **more):
            # viser goes on to the next port where one is taken
            if host == door.host and port is not None and port >= door.port:
                process_request = door.guard(process_request)
                door.guarded.append(port)
                more["logger"], handler = _logger(), _quiet(handler)
            super().__init__(handler, host, port, process_request=process_request, **more)

    with _patching:
        original, module.serve = module.serve, Guarded
        try:
            yield
        finally:
            module.serve = original


def _quiet(handler: Handler) -> Handler:
    """A handler of connections that logs what viser prints of one that is not of its own page's version."""
    import rich
    import viser

    async def quiet(connection: ServerConnection) -> None:
        if connection.subprotocol == f"viser-v{viser.__version__}":
            await handler(connection)
            return
        with rich.get_console().capture() as printed:
            await handler(connection)
        logging.getLogger("jaxcap.view").info(printed.get().strip())

    return quiet


def _logger() -> logging.Logger:
    """A log without the tracebacks of connections that speak no HTTP, such as those of a scan of ports."""
    logger = logging.getLogger("jaxcap.view")
    logger.addFilter(_is_fault)
    return logger


def _is_fault(record: logging.LogRecord) -> bool:
    return record.getMessage() != "opening handshake failed"


def own_address(host: str) -> str:
    """The address of this machine in its network, as the system would send from it; its name where it is in none.

    `host`, one of `EVERYWHERE`, says of which kind. Nothing is sent.
    """
    family, far = (socket.AF_INET6, "2001:db8::1") if host == "::" else (socket.AF_INET, "192.0.2.1")
    with contextlib.suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
        # these addresses are kept for documents (RFC 5737, RFC 3849)
        probe.connect((far, 9))
        return probe.getsockname()[0]
    return socket.gethostname()


def _bracketed(host: str) -> str:
    """A host as it stands in an address."""
    return f"[{host}]" if ":" in host else host


def _is_address(name: str) -> bool:
    """Whether a host of an address is a number and no name."""
    try:
        ipaddress.ip_address(name.removeprefix("[").removesuffix("]"))
    except ValueError:
        return False
    return True
