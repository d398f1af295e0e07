"""The door of the windows: pages of other origins, foreign hosts and wrong tokens get nothing, of the page or of the
websocket, and what a file says is no markup."""

import base64
import os
import re
import socket
import urllib.request
from urllib.parse import urlsplit

import numpy as np
import pytest
from browser import chromium, wait_for_node
from helpers import chain_body

import jaxcap as jc
from jaxcap.cli.console import window
from jaxcap.edit.ik import session as ik
from jaxcap.errors import InputError
from jaxcap.view.app import serve_contents
from jaxcap.view.contents import Contents, make_take
from jaxcap.view.ik.window import serve_ik
from jaxcap.view.windows import serve
from jaxcap.view.windows.access_guard import AccessGuard
from jaxcap.view.windows.serve import address, close_server, open_server, remote_address

__all__ = ["chromium"]

EVIL = "evil.example"
#: of a scene that every browser is sent at once
CORNERS = np.array([[0.125, 0.25, 0.375], [1.5, 0.0, 0.0], [0.0, 1.75, 0.0]], np.float32)


def view_window(server) -> None:
    body = chain_body()
    serve_contents(server, Contents(takes=[make_take("take", body.skeleton, body)]))


def ik_window(server) -> None:
    serve_ik(server, ik.begin_session(jc.human(resolution="low", joints="tracking")))


@pytest.fixture(scope="module", params=[view_window, ik_window])
def server(request):
    server = open_server(0)
    request.param(server)
    server.scene.add_mesh_simple("/known", CORNERS, np.array([[0, 1, 2]], np.uint32))
    yield server
    close_server(server)


def ask(server, path: str, headers: dict[str, str], more: bytes = b"", seconds: float = 1.0) -> bytes:
    """All that the server answers to a request, byte for byte, until it is silent; `more` is sent at once."""
    lines = [f"GET {path} HTTP/1.1", *(f"{name}: {value}" for name, value in headers.items()), "", ""]
    found = b""
    with socket.create_connection(("127.0.0.1", server.get_port()), timeout=20) as line:
        line.sendall("\r\n".join(lines).encode() + more)
        try:
            while part := line.recv(65536):
                found += part
                line.settimeout(seconds)
        except TimeoutError:
            pass
    return found


def upgrade(server) -> dict[str, str]:
    """What viser's own page sends to open its websocket, without host and origin."""
    import viser

    return {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": base64.b64encode(os.urandom(16)).decode(),
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
    }


def status(answer: bytes) -> int:
    return int(answer.split(b" ", 2)[1])


def test_its_own_page_is_let_in(server):
    url = urlsplit(address(server))
    own = {"Host": url.netloc}
    page = ask(server, url.path, own)
    assert status(page) == 200 and b"Referrer-Policy: no-referrer" in page
    opened = ask(server, url.path, own | upgrade(server) | {"Origin": f"http://{url.netloc}"})
    assert status(opened) == 101
    # a control of what the others must not get: the scene is on the wire
    assert CORNERS.tobytes() in opened


REFUSED = {
    "a foreign origin": ({"Origin": f"http://{EVIL}"}, "{token}"),
    "no origin": ({}, "{token}"),
    "an opaque origin": ({"Origin": "null"}, "{token}"),
    "another port of this machine": ({"Origin": "http://127.0.0.1:1"}, "{token}"),
    "an origin that begins alike": ({"Origin": "http://{own}.evil.example"}, "{token}"),
    "a foreign host of its own origin": (
        {"Host": "evil.example:{port}", "Origin": "http://evil.example:{port}"}, "{token}",
    ),
    "a host without the port": ({"Host": "127.0.0.1", "Origin": "http://127.0.0.1"}, "{token}"),
    "no token": ({"Origin": "http://{own}"}, ""),
    "a wrong token": ({"Origin": "http://{own}"}, "x" * 32),
    "a shortened token": ({"Origin": "http://{own}"}, "{short}"),
    "a token as a parameter": ({"Origin": "http://{own}"}, "?token={token}"),
    "a token that is no ASCII": ({"Origin": "http://{own}"}, "\u00e9"),
    "the parent of the token": ({"Origin": "http://{own}"}, "{token}/../"),
}  # fmt: skip


@pytest.mark.parametrize("socketed", [False, True], ids=["page", "websocket"])
@pytest.mark.parametrize("name", REFUSED)
def test_others_are_refused(server, name, socketed):
    headers, path = REFUSED[name]
    if name == "no origin" and not socketed:
        pytest.skip("a page that is opened has no origin")
    url = urlsplit(address(server))
    token = url.path.strip("/")
    words = {"own": url.netloc, "port": url.port, "token": token, "short": token[:-1]}
    headers = {"Host": url.netloc} | {key: value.format(**words) for key, value in headers.items()}
    # frames of an upload behind the request must not reach anybody either
    more = b"\x82\x85aaaahello" * 50 if socketed else b""
    answer = ask(
        server, "/" + path.format(**words), headers | (upgrade(server) if socketed else {}), more, 0.3
    )
    if name == "the parent of the token" and not socketed:
        # viser answers that there is no such file
        assert status(answer) == 404
        return
    assert status(answer) == (101 if name == "the parent of the token" else 403), answer
    if status(answer) == 403:
        assert CORNERS.tobytes() not in answer and token.encode() not in answer


def test_two_hosts_or_none_are_refused(server):
    url = urlsplit(address(server))
    assert status(ask(server, url.path, {"Host": EVIL, "host": url.netloc})) == 403
    assert status(ask(server, url.path, {"host": url.netloc, "Host": EVIL})) == 403
    assert status(ask(server, url.path, {})) == 403


@pytest.mark.parametrize(
    ("host", "named", "opened"),
    [
        ("127.0.0.1", "localhost:80", True),
        ("127.0.0.1", "LOCALHOST", True),
        ("127.0.0.1", "[::1]:80", True),
        ("127.0.0.1", "[::1]", True),
        ("127.0.0.1", "192.168.0.7", False),
        ("127.0.0.1", "localhost.evil.example", False),
        ("127.0.0.1", "localhost:080", False),
        ("192.168.0.7", "192.168.0.7", True),
        ("fe80::1", "[fe80::1]:80", True),
        # a name resolves to what its owner wants, a number to nothing else
        ("0.0.0.0", "192.168.0.7:80", True),
        ("::", "[fe80::1]", True),
        ("0.0.0.0", socket.gethostname(), True),
        ("0.0.0.0", EVIL, False),
        ("0.0.0.0", "192.168.0.7.evil.example", False),
        ("0.0.0.0", "", False),
    ],
)
def test_hosts_that_name_this_server(host, named, opened):
    from websockets import Headers
    from websockets.http11 import Request

    door = AccessGuard(host, 80)
    assert (door.path(Request(f"/{door.token}/a?b", Headers(Host=named))) == "/a") == opened


def test_every_server_has_a_token_of_its_own():
    assert len({AccessGuard("127.0.0.1", 80).token for _ in range(20)}) == 20
    assert AccessGuard("0.0.0.0", 1).address.startswith("http://127.0.0.1:1/")
    assert AccessGuard("::", 1).address.startswith("http://[::1]:1/")


def test_a_viser_that_cannot_be_guarded_is_not_opened(monkeypatch):
    class Other:
        """A door that another version of viser does not go through."""

        def __init__(self, door):
            pass

        def __enter__(self):
            pass

        def __exit__(self, *_):
            pass

    monkeypatch.setattr(serve, "guard_servers", Other)
    free = socket.create_server(("127.0.0.1", 0))
    port = free.getsockname()[1]
    free.close()
    with pytest.raises(InputError, match="cannot be guarded"):
        open_server(port)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port)).close()


def test_other_servers_of_the_program_are_as_ever():
    import viser

    server = open_server(0)
    other = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    assert urllib.request.urlopen(f"http://127.0.0.1:{other.get_port()}", timeout=20).status == 200
    other.stop()
    close_server(server)


def test_nothing_that_speaks_no_http_is_told(capfd):
    server = open_server(0)
    with socket.create_connection(("127.0.0.1", server.get_port()), timeout=20) as line:
        line.sendall(b"garbage\r\n\r\n")
        assert line.recv(10) == b""
    assert urllib.request.urlopen(address(server), timeout=20).status == 200
    close_server(server)
    assert capfd.readouterr() == ("", "")


def test_a_page_elsewhere_gets_nothing_in_a_browser(chromium, server):
    """What an attacker's page can do in the user's own browser, with the port that it has guessed."""
    page = chromium("data:text/html,<script>window.__viserMutable = 1</script>")
    port = server.get_port()
    tried = page.evaluate(
        """port => Promise.all(['127.0.0.1', 'localhost'].map(host => new Promise(done => {
            const line = new WebSocket(`ws://${host}:${port}`, ['viser-v1.1.1']);
            line.onopen = () => done('open');
            line.onmessage = () => done('message');
            line.onerror = () => done('refused');
        })))""",
        port,
    )
    assert tried == ["refused", "refused"]
    page.close()


def test_names_from_files_are_no_markup(chromium):
    body = chain_body()
    bad = (
        '<img src="http://evil.example/x.png"> *b* _c_ [d](http://evil.example) `e` {1+1} http://evil.example'
    )
    server = open_server(0)
    serve_contents(server, Contents(takes=[make_take("take", body.skeleton, body)], notes=[bad]))
    page = chromium(address(server))
    wait_for_node(page, "/0/body/surface")
    page.get_by_text(re.compile(r"<img src=.* \*b\* _c_ \[d\].* `e` \{1\+1\}")).wait_for()
    assert page.locator("img[src*=evil]").count() == 0
    page.close()
    close_server(server)


def test_other_machines_are_given_an_address_that_opens(server):
    assert remote_address(server) is None
    everywhere = open_server(0, "0.0.0.0")
    url = remote_address(everywhere) or ""
    assert urlsplit(url).hostname not in ("0.0.0.0", "127.0.0.1", "localhost")
    assert urlsplit(url).path == urlsplit(address(everywhere)).path
    assert urllib.request.urlopen(url, timeout=20).status == 200
    close_server(everywhere)


def test_the_command_tells_both_addresses(capsys, monkeypatch):
    def end() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(window, "pause_status", end)
    for host in ("0.0.0.0", "127.0.0.1"):
        with pytest.raises(KeyboardInterrupt):
            window.run_window("view", "a", lambda server: None, 0, host, False)
        told = capsys.readouterr().out
        assert told.startswith("a: http://127.0.0.1:")
        assert (", on other machines http://" in told) == (host == "0.0.0.0")


def test_a_page_of_another_version_is_refused_in_silence(server, capfd):
    """It has the token; viser would print a line of its own."""
    url = urlsplit(address(server))
    headers = {**upgrade(server), "Host": url.netloc, "Origin": f"http://{url.netloc}"}
    for protocol in ("viser-v0.0.1", "chat"):
        answer = ask(server, url.path, {**headers, "Sec-WebSocket-Protocol": protocol})
        assert status(answer) == 101
        assert b"Version mismatch" in answer
    assert capfd.readouterr() == ("", "")
