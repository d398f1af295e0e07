"""Access control of a window server: its page and its websocket accept only requests with its own host, its
own origin and its token.

A browser lets any page connect to any address, this machine's included, and send requests as its user. Three
checks prevent that:

- **Host** has to name this server. A page whose name an attacker resolves to 127.0.0.1 (DNS rebinding) sends
  its own.
- **Origin** has to be this server. A page of another origin that opens a websocket sends its own.
- **The token**, random for each server, has to be the first part of the path. Only a recipient of the address
  has it.

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
    # for the type checker alone
    ServerConnection = Request = Response = Any

#: names of this machine in its own browsers
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
#: hosts that listen at every address of this machine
ANY_HOST = ("0.0.0.0", "::", "")
REFUSED_TEXT = (
    "jaxcap: this is not the address of the window. Open the complete address that the program printed.\n"
)
#: headers of every served page
HEADERS = {
    # the address holds the token, which no other site may learn
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
}

_patching = threading.Lock()

Handler = Callable[[ServerConnection], Awaitable[None]]
Answer = Callable[[ServerConnection, Request], Response | None]


class AccessGuard:
    """The access checks of one server.

    **Arguments:** `host` and `port` that it listens at. Each instance has a new `token`.
    """

    def __init__(self, host: str, port: int):
        self.host, self.port = host, port
        self.token = secrets.token_urlsafe(24)
        #: ports of the guarded servers
        self.guarded_ports: list[int] = []

    @property
    def address(self) -> str:
        """The address to open on this machine, with the token."""
        # a number, as `localhost` may resolve to another program's address
        host = {"0.0.0.0": "127.0.0.1", "": "127.0.0.1", "::": "::1"}.get(self.host, self.host)
        return f"http://{_bracketed(host)}:{self.port}/{self.token}/"

    @property
    def remote_address(self) -> str | None:
        """The address to open on other machines, with the token; None if the server listens for its own
        machine only."""
        if self.host not in ANY_HOST:
            return None
        return f"http://{_bracketed(local_address(self.host))}:{self.port}/{self.token}/"

    def path(self, request: Request) -> str | None:
        """Return the requested path after the token, or None if the request is refused."""
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        if len(hosts) != 1 or not self._is_own(hosts[0].lower()):
            return None
        # every browser sends an origin with a websocket; the request of a page has none
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
        """Wrap `answer` into the `process_request` of a websockets server, called only for accepted
        requests."""

        def guarded(connection: ServerConnection, request: Request) -> Response | None:
            path = self.path(request)
            if path is None:
                return connection.respond(http.HTTPStatus.FORBIDDEN, REFUSED_TEXT)
            response = None if answer is None else answer(connection, dataclasses.replace(request, path=path))
            if response is not None:
                response.headers.update(HEADERS)
            return response

        return guarded

    def _is_own(self, host: str) -> bool:
        """Check if a `Host` header names this server."""
        name, colon, port = host.rpartition(":")
        if not colon or host.endswith("]"):
            # a browser omits the default port of http
            name, port = host, "80"
        if port != str(self.port):
            return False
        if name in LOOPBACK or name == _bracketed(self.host.lower()):
            return True
        # a numeric address cannot be the target of DNS rebinding
        return self.host in ANY_HOST and (_is_address(name) or name == socket.gethostname().lower())


@contextlib.contextmanager
def guard_servers(door: AccessGuard) -> Iterator[None]:
    """Guard every websockets server that is created at the door's host within this context.

    viser creates its server in a thread of its own and takes no `process_request`, so
    `websockets.asyncio.server.serve` is replaced meanwhile. Servers at other ports are not changed. The
    caller checks `door.guarded_ports` afterwards, as another version of viser may create its server in
    another way.
    """
    import websockets.asyncio.server as module

    class Guarded(module.serve):
        def __init__(self, handler, host=None, port=None, *, process_request=None, **more):
            # viser tries the next port if one is taken
            if host == door.host and port is not None and port >= door.port:
                process_request = door.guard(process_request)
                door.guarded_ports.append(port)
                more["logger"], handler = _logger(), _capture_output(handler)
            super().__init__(handler, host, port, process_request=process_request, **more)

    with _patching:
        original, module.serve = module.serve, Guarded
        try:
            yield
        finally:
            module.serve = original


def _capture_output(handler: Handler) -> Handler:
    """Wrap a connection handler to log viser's output about clients of another version."""
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
    """Return a logger without the tracebacks of connections that speak no HTTP, such as port scans."""
    logger = logging.getLogger("jaxcap.view")
    logger.addFilter(_is_fault)
    return logger


def _is_fault(record: logging.LogRecord) -> bool:
    return record.getMessage() != "opening handshake failed"


def local_address(host: str) -> str:
    """Return the network address of this machine, as the system would send from it, or its name without a
    network.

    `host`, an element of `ANY_HOST`, selects IPv4 or IPv6. Nothing is sent.
    """
    family, far = (socket.AF_INET6, "2001:db8::1") if host == "::" else (socket.AF_INET, "192.0.2.1")
    with contextlib.suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
        # these addresses are reserved for documentation (RFC 5737, RFC 3849)
        probe.connect((far, 9))
        return probe.getsockname()[0]
    return socket.gethostname()


def _bracketed(host: str) -> str:
    """Format a host for a URL."""
    return f"[{host}]" if ":" in host else host


def _is_address(name: str) -> bool:
    """Check if the host of a URL is a numeric address."""
    try:
        ipaddress.ip_address(name.removeprefix("[").removesuffix("]"))
    except ValueError:
        return False
    return True
