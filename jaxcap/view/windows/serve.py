"""The window server: opened on a free port with access control, and with a separate window for every browser.

viser is imported when a window is opened and not before, as it is an optional dependency.
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

from ...errors import InputError, user_message
from ..figures.scenery import add_background, add_light
from .access_guard import AccessGuard, guard_servers

if TYPE_CHECKING:
    from viser import ClientHandle, ViserServer
else:
    # for the type checker alone
    ClientHandle = ViserServer = Any

#: the preferred port
PORT = 8080
#: this machine only
HOST = "127.0.0.1"

_guards: "weakref.WeakKeyDictionary[ViserServer, AccessGuard]" = weakref.WeakKeyDictionary()


def open_server(port: int | None = None, host: str = HOST, title: str | None = None) -> ViserServer:
    """Open a server with y up, light, a background and an empty scene. It prints nothing.

    It answers only at `address(server)`, which holds a random token; a request from another page, for another
    host or without the token is refused (`AccessGuard`).

    **Arguments:** `port`; None for 8080 if that is free and otherwise any free one; `host`, the address of
    this machine that it listens at: `0.0.0.0` for every one, for browsers on other machines; `title`, shown
    above the controls.

    **Raises:** `InputError` if viser is not installed or of a version that cannot be guarded, the port is
    taken or the host is not of this machine.
    """
    try:
        import rich
        import viser
    except ImportError:
        raise InputError(
            'viser is not installed, and windows need it; run pip install -e ".[view]" in a checkout of jaxcap.'
        ) from None
    # viser silently tries the next port, so it gets one that we have just bound
    free = _free_port(host, port)
    # a browser that closes while a frame is sent is no error; a repeated filter is not added again
    warnings.filterwarnings("ignore", message="Queued an? .* on a closed connection")
    # viser's table shows ports and not contents; only the output of this thread is suppressed
    door = AccessGuard(host, free)
    with rich.get_console().capture(), guard_servers(door):
        server = viser.ViserServer(host=host, port=free, label=title, verbose=False)
    _guards[server] = door
    if server.get_port() not in door.guarded_ports:
        close_server(server)
        raise InputError(
            f"viser {viser.__version__}: the server of this version cannot be guarded against other pages; "
            'run pip install -e ".[view]" in a checkout of jaxcap for a supported version.'
        )
    if server.get_port() != free:
        close_server(server)
        raise _port_in_use(host, free)
    # viser's tunnel would publish the window
    server.request_share_url = lambda verbose=True: None
    server.gui.configure_theme(show_share_button=False)
    # next to the scene, not over it
    server.gui.main_panel.dock_right()
    # registered after viser's own, so it runs before it
    atexit.register(_bound_close(server))
    server.scene.set_up_direction("+y")
    add_light(server.scene)
    add_background(server.scene)
    return server


def close_server(server: ViserServer) -> None:
    """Close a server, its port and its windows. A second call does nothing."""
    import rich

    atexit.unregister(_bound_close(server))
    # the event loop of a stopped server is closed
    with contextlib.suppress(RuntimeError):
        # suppress the message of viser's thread
        server.get_event_loop().call_soon_threadsafe(rich.get_console().begin_capture)
        server.stop()


def _bound_close(server: ViserServer) -> Callable[[], None]:
    """Bind `close_server` to one server; two of the same server are equal, as `atexit` compares."""
    return types.MethodType(close_server, server)


def address(server: ViserServer) -> str:
    """Return the address for a browser, with the token; no other address opens the window."""
    return _guards[server].address


def remote_address(server: ViserServer) -> str | None:
    """Return the address for a browser of another machine; None if the server listens for this machine
    only."""
    return _guards[server].remote_address


def serve_clients(server: ViserServer, run: Callable[[ClientHandle, threading.Event], None]) -> None:
    """Call `run(client, gone)` for every browser that opens the window, in a thread of its own.

    Additions to `client.scene` and `client.gui` are visible in that browser only. `gone` is set when this
    browser closes: a loop of `run` ends with `while not gone.wait(...)`. Later messages are dropped without
    a traceback, so a solve need not be stopped. A `ValueError` is shown in the browser.
    """
    leaving: dict[int, threading.Event] = {}

    # both in the server's loop and in its order, so that no browser leaves before it connects
    @server.on_client_connect
    async def _(client: ClientHandle) -> None:
        gone = leaving[client.client_id] = threading.Event()
        threading.Thread(target=_run_client, args=(run, client, gone), daemon=True).start()

    @server.on_client_disconnect
    async def _(client: ClientHandle) -> None:
        if (gone := leaving.pop(client.client_id, None)) is not None:
            gone.set()


def notify(client: ClientHandle, title: str, text: str) -> None:
    """Show a notification in a corner of one browser, until the user closes it."""
    client.add_notification(title, text, color="orange", auto_close_seconds=None)


def _run_client(
    run: Callable[[ClientHandle, threading.Event], None], client: ClientHandle, gone: threading.Event
) -> None:
    try:
        run(client, gone)
    except ValueError as error:
        notify(client, "This cannot be shown", user_message(error))
    except Exception:
        # an error is expected after the browser has closed
        if not gone.is_set():
            raise


def _free_port(host: str, port: int | None) -> int:
    if port is not None:
        return _bind_port(host, port)
    try:
        return _bind_port(host, PORT)
    except InputError:
        return _bind_port(host, 0)


def _bind_port(host: str, port: int) -> int:
    """Find a free port by binding and releasing it; for 0 the system chooses."""
    try:
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as door:
            # a port that was just released is free, as for viser
            door.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            door.bind((host, port))
            # bind alone is not enough: two sockets may bind, and one may listen
            door.listen(1)
            return door.getsockname()[1]
    except OverflowError:
        raise InputError(f"port {port}: expected 0 to 65535; give such a port with --port.") from None
    except PermissionError:
        raise InputError(f"port {port}: reserved for the system; give one above 1023 with --port.") from None
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise _port_in_use(host, port) from None
        raise InputError(
            f"host {host}: not an address of this machine; give {HOST} or 0.0.0.0 with --host."
        ) from None


def _port_in_use(host: str, port: int) -> InputError:
    return InputError(f"port {port}: another program uses this port at {host}; give another one with --port.")
