"""Browser windows of verbs, open until Ctrl-C."""

import threading
import webbrowser
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any

from ...view.windows.serve import address, close_server, open_server, remote_address
from .console import say
from .heartbeat import pause_status
from .options import arg

if TYPE_CHECKING:
    from viser import ViserServer
else:
    ViserServer = Any

Port = Annotated[int | None, arg(metavar="PORT", help_behavior_hint="")]


def run_window(
    verb: str,
    description: str,
    fill: Callable[[ViserServer], object],
    port: int | None,
    host: str,
    browser: bool,
) -> None:
    """Open a window, print its address, and wait for Ctrl-C, which closes it.

    **Arguments:** `verb`, the name of the window; `description`, a description of its contents; `fill` adds the
    contents; `port` and `host` as of `open_server`; `browser`, whether to open one.

    **Raises:** `InputError` as `open_server` does.
    """
    server = open_server(port, host, f"jaxcap {verb}")
    try:
        fill(server)
        elsewhere = remote_address(server)
        more = "" if elsewhere is None else f", on other machines {elsewhere}"
        say(f"{description}: {address(server)}{more} (Ctrl-C stops)")
        if browser:
            webbrowser.open(address(server))
        with pause_status():
            threading.Event().wait()
    finally:
        close_server(server)
