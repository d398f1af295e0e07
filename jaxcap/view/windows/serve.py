"""A server of windows: opened on a port that is free, behind a door, and a window of its own for every browser.

viser is imported when a window is opened and not before, as it comes with an extra.
"""

import atexit
import contextlib
import errno
import socket
import threading
import types
import warnings
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ...errors import InputError, sentence_of
from ..figures.scenery import add_background, add_light
from .door import Door, guarding

if TYPE_CHECKING:
    from viser import ClientHandle, ViserServer
else:
    # what only a type checker sees
    ClientHandle = ViserServer = Any

#: where a window is looked for first
PORT = 8080
#: nobody but this machine
HOST = "127.0.0.1"

_doors: "weakref.WeakKeyDictionary[ViserServer, Door]" = weakref.WeakKeyDictionary()


def open_server(port: int | None = None, host: str = HOST, title: str | None = None) -> ViserServer:
    """Open a server with y up, light, a background and nothing to see. It prints nothing.

    It answers at `address(server)` alone, which holds a random token; a request from another page, for another
    host or without the token is refused (`Door`).

    **Arguments:** `port`, where None is 8080 if that is free and any free one else; `host`, the
    address of this machine that it listens at: `0.0.0.0` is every one, for browsers elsewhere;
    `title`, which stands above the controls.

    **Raises:** `InputError` where viser is not installed or of a version that cannot be guarded, the port is
    taken or the host is not of this machine.
    """
    try:
        import rich
        import viser
    except ImportError:
        raise InputError(
            'viser: the windows need it and it is not installed; run pip install "jaxcap[view]".'
        ) from None
    # viser goes on to the next port without a word, so it is given one that we have held
    free = _free_port(host, port)
    # a browser that closes while a frame is on its way is no fault; a filter that is there already is not added again
    warnings.filterwarnings("ignore", message="Queued an? .* on a closed connection")
    # its own table tells ports and not what is shown; only what this thread says is held back
    door = Door(host, free)
    with rich.get_console().capture(), guarding(door):
        server = viser.ViserServer(host=host, port=free, label=title, verbose=False)
    _doors[server] = door
    if server.get_port() not in door.guarded:
        close_server(server)
        raise InputError(
            f"viser {viser.__version__}: its server opens in a way that cannot be guarded against other pages; "
            'run pip install "jaxcap[view]" for a version that can.'
        )
    if server.get_port() != free:
        close_server(server)
        raise _taken(host, free)
    # viser's tunnel would show the window to the world
    server.request_share_url = lambda verbose=True: None
    server.gui.configure_theme(show_share_button=False)
    # beside the picture, not over it
    server.gui.main_panel.dock_right()
    # before viser's own, which tells of its end
    atexit.register(_ending(server))
    server.scene.set_up_direction("+y")
    add_light(server.scene)
    add_background(server.scene)
    return server


def close_server(server: ViserServer) -> None:
    """End a server, its port and its windows. Once more does nothing."""
    import rich

    atexit.unregister(_ending(server))
    # the loop of one that has ended is closed
    with contextlib.suppress(RuntimeError):
        # viser's thread tells of its end, to nobody
        server.get_event_loop().call_soon_threadsafe(rich.get_console().begin_capture)
        server.stop()


def _ending(server: ViserServer) -> Callable[[], None]:
    """`close_server` of one server; two of the same server are equal, as `atexit` compares."""
    return types.MethodType(close_server, server)


def address(server: ViserServer) -> str:
    """The address to give a browser, with the token; nothing else opens the window."""
    return _doors[server].address


def address_elsewhere(server: ViserServer) -> str | None:
    """The address to give a browser of another machine; None where the server listens for this machine alone."""
    return _doors[server].address_elsewhere


def each_client(server: ViserServer, build: Callable[[ClientHandle, threading.Event], None]) -> None:
    """Call `build(client, gone)` for every browser that opens the window, in a thread of its own.

    What `build` puts into `client.scene` and `client.gui` no other browser sees. `gone` is set
    when this browser closes: a loop of `build` ends with `while not gone.wait(...)`. What is sent
    afterwards goes nowhere, without a traceback, so a solve need not be stopped. A `ValueError` is
    told in the browser.
    """
    leaving: dict[int, threading.Event] = {}

    # both in the server's loop and in its order, so that no browser leaves before it came
    @server.on_client_connect
    async def _(client: ClientHandle) -> None:
        gone = leaving[client.client_id] = threading.Event()
        threading.Thread(target=_visit, args=(build, client, gone), daemon=True).start()

    @server.on_client_disconnect
    async def _(client: ClientHandle) -> None:
        if (gone := leaving.pop(client.client_id, None)) is not None:
            gone.set()


def tell(client: ClientHandle, title: str, text: str) -> None:
    """A sentence in a corner of one browser, until it is closed there."""
    client.add_notification(title, text, color="orange", auto_close_seconds=None)


def _visit(
    build: Callable[[ClientHandle, threading.Event], None], client: ClientHandle, gone: threading.Event
) -> None:
    try:
        build(client, gone)
    except ValueError as error:
        tell(client, "This cannot be shown", sentence_of(error))
    except Exception:
        # half of a window is gone with its browser
        if not gone.is_set():
            raise


def _free_port(host: str, port: int | None) -> int:
    if port is not None:
        return _hold(host, port)
    try:
        return _hold(host, PORT)
    except InputError:
        return _hold(host, 0)


def _hold(host: str, port: int) -> int:
    """The number of a port that nobody listens at, let go again; for 0 the system chooses."""
    try:
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as door:
            # one that was just left is free, as it is for viser
            door.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            door.bind((host, port))
            # bound is not enough: two may be, and one may listen
            door.listen(1)
            return door.getsockname()[1]
    except OverflowError:
        raise InputError(f"port {port}: ports go from 0 to 65535; give one of these with --port.") from None
    except PermissionError:
        raise InputError(f"port {port}: this is the system's own; give one above 1023 with --port.") from None
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise _taken(host, port) from None
        raise InputError(
            f"host {host}: this is no address of this machine; give {HOST} or 0.0.0.0 with --host."
        ) from None


def _taken(host: str, port: int) -> InputError:
    return InputError(f"port {port}: another program listens there at {host}; give another one with --port.")
