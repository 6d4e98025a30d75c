"""The server over its socket: who is served, who is told what, who holds the finger, and readers that do not read."""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
import struct
import time
import zipfile
from io import BytesIO
from pathlib import Path

import pytest
from cases import for_each
from view.serving import Served, Still, until
from websockets.exceptions import ConnectionClosed, InvalidStatus

from finger_sim.view.connection import CROWDED
from finger_sim.view.files import Recordings
from finger_sim.view.guard import Guard
from finger_sim.view.hub import AHEAD, MOST_CLIENTS

POSE = (0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 1.0)
UPGRADE = (
    b"GET /ws HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)
"""The request of a page's WebSocket."""


@pytest.fixture
def served():
    with Served(Still()) as server:
        yield server


def get(port, path, method="GET", **headers):
    """Status, headers and body."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, {name.lower(): value for name, value in answer.getheaders()}, body


def test_every_answer_says_what_a_page_may_do(served) -> None:
    """The page's files, a refusal and what is missing: all have the strict headers."""
    for path, status, kind in (
        ("/", 200, "text/html"), ("/page.js", 200, "text/javascript"), ("/page.css", 200, "text/css"),
        ("/licences.txt", 200, "text/plain"), ("/secret", 404, "text/plain"),
    ):  # fmt: skip
        got, headers, body = get(served.port, path)
        assert (path, got, headers["content-type"].startswith(kind)) == (path, status, True)
        assert "default-src 'none'; script-src 'self'" in headers["content-security-policy"]
        assert (headers["x-content-type-options"], headers["referrer-policy"]) == ("nosniff", "no-referrer")
        assert headers["cache-control"] == "no-store"
        assert int(headers["content-length"]) == len(body)


@for_each(
    "path",
    [
        "/page.js/..", "/../pyproject.toml", "/..%2f..%2fpyproject.toml", "/page.jsx", "/bundle/page.js", "//",
        "/recordings/", "/recordings/x", "/recordings/../../pyproject.toml", "/recordings/..%2f..%2fpyproject.toml",
        "/__init__.py", "/page.js%00",
    ],
)  # fmt: skip
def test_nothing_else_is_served(path, served) -> None:
    """Whatever is asked for, only known names are there."""
    assert get(served.port, path)[0] == 404


@for_each("path", ["/", "/page.js", "/ws", "/recordings/x", "/nothing"])
@for_each(
    "headers",
    [
        {"Host": "evil.example"}, {"Host": "evil.example:8470"}, {"Host": "127.0.0.1.evil.example"}, {"Host": ""},
        {"Host": "localhost@evil.example"}, {"Host": "127.0.0.2"}, {"Host": "[::2]:80"},
        {"Origin": "http://evil.example"}, {"Origin": "null"}, {"Origin": "http://localhost:1"}, {"Origin": ""},
        {"Host": "localhost:5", "Origin": "http://127.0.0.1:5"},
    ],
)  # fmt: skip
def test_a_foreign_host_or_origin_is_refused(path, headers, served) -> None:
    """403, in words, for every path."""
    status, _, body = get(served.port, path, **headers)
    assert status == 403
    assert b"Host" in body or b"Origin" in body


def test_the_own_page_is_served_by_each_of_its_names(served) -> None:
    """localhost and both addresses, with the Origin of that name; without one, as no browser asks."""
    for host in ("localhost", "127.0.0.1", "[::1]"):
        name = f"{host}:{served.port}"
        assert get(served.port, "/", Host=name, Origin=f"http://{name}")[0] == 200
    with pytest.raises(InvalidStatus) as refused:
        served.page(origin="http://evil.example")
    assert refused.value.response.status_code == 403
    with served.page(origin=f"http://127.0.0.1:{served.port}") as page:
        assert page.next("hello")["client"] >= 1


def test_only_get(served) -> None:
    """Another method is refused, or the connection closed."""
    with contextlib.suppress(http.client.HTTPException, OSError):
        assert get(served.port, "/", method="POST")[0] in (400, 405)
    assert get(served.port, "/")[0] == 200


def test_any_other_address_needs_the_token() -> None:
    """For the page and what it says; without it 403; its files hold no secret."""
    guard = Guard("0.0.0.0")
    assert guard.token is not None
    with Served(Still(), guard) as served:
        for path in ("/", "/?token=", "/?token=wrong", f"/?token={guard.token}x", "/ws", "/recordings/x"):
            status, _, body = get(served.port, path)
            assert (path, status) == (path, 403)
            assert guard.token.encode() not in body
        assert get(served.port, f"/{guard.query}")[0] == 200
        assert get(served.port, "/page.js")[0] == 200
        assert get(served.port, f"/{guard.query}", Host="evil.example")[0] == 403
        with served.page(query=guard.query) as page:
            page.next("hello")


def test_a_page_is_told_all_in_order(served) -> None:
    """hello, topology, parameters, status, handle; then frames, their first with what was before."""
    with served.page() as page:
        page.until(lambda: len(page.frames) > 3)
        assert page.order[:5] == ["hello", "topology", "parameters", "status", "handle"]
        hello = page.said[0]
        assert (hello["version"], hello["source"], hello["drive"], hello["scenes"]) == (2, "node", True, ["a", "b"])
        assert page.said[2]["rate"] is None
        assert page.frames[0].flags & 16
        assert not page.frames[1].flags & 16
        assert page.frames[0].generation == page.topologies[0].generation


def test_nobody_is_listened_for_without_a_page(served) -> None:
    """The source hears that the first page came and the last one went."""
    with served.page() as one, served.page() as two:
        one.next("status")
        two.next("status")
    until(lambda: served.source.listened == [True, False])


def test_one_page_holds_the_finger(served) -> None:
    """Only its poses are sent; another one's are refused; it is free once the holder lets go or has gone."""
    with served.page() as one:
        assert "only the page that holds" in one.refusal(POSE)
        one.say("take")
        me = one.next("handle")["holder"]
        with served.page() as two:
            assert two.until(lambda: [each for each in two.said if each["type"] == "handle"])[0]["holder"] == me
            assert f"held by page {me}" in two.notice("take")
            assert "only the page that holds" in two.refusal(POSE)
            one.hold(POSE)
            until(lambda: served.source.poses == [POSE])
            one.say("release")
            assert two.next("handle")["holder"] is None
            two.say("take")
            assert two.next("handle")["holder"] not in (None, me)
            two.socket.socket.shutdown(socket.SHUT_RDWR)  # without a word
        one.until(lambda: one.said[-1]["type"] == "handle" and one.said[-1]["holder"] is None)
        count = len(served.source.poses)
        assert "only the page that holds" in one.refusal(POSE)
        assert len(served.source.poses) == count


def test_a_page_that_only_looks_holds_nothing() -> None:
    """Where the source is not to be driven."""
    with Served(Still(drive=False)) as served, served.page() as page:
        assert "cannot be held" in page.notice("take")


def test_bad_messages_end_nothing(served) -> None:
    """Each is answered by a notice; frames go on coming."""
    with served.page() as page:
        page.next("hello")
        for text in ("", "{", "[]", '{"type": "fly"}', '{"type": "frames", "hz": 1e9}', "\0", '{"type": "pose"}'):
            page.socket.send(text)
            assert page.next("notice")["level"] == "warn"
        page.socket.send(b"\x01\x02")
        assert "got 2 bytes" in page.next("notice")["text"]
        served.source.refuse = "not now"
        assert page.notice("reset") == "not now"
        count = len(page.frames)
        page.until(lambda: len(page.frames) > count + 2)


def test_a_message_in_parts_is_one(served) -> None:
    """A text that comes in several frames, and bytes."""
    with served.page() as page:
        page.socket.send(iter(['{"type": ', '"yaml"', "}"]))
        assert page.next("yaml")["name"] == "a.yaml"
        page.say("take")
        page.next("handle")
        data = struct.pack("<2I7d", 2, 0, *POSE)
        page.socket.send(iter([data[:9], data[9:40], data[40:]]))
        until(lambda: served.source.poses == [POSE])


@for_each("size, code", [(65 * 1024, 1009), (2**21, 1009), (2**24, 1009)])
def test_a_message_that_is_too_long_ends_the_connection(size, code, served) -> None:
    """With the code for it; others are not disturbed."""
    with served.page() as other, served.page() as page:
        page.next("hello")
        with contextlib.suppress(ConnectionClosed):
            page.socket.send(" " * size)
        page.until_closed()
        assert page.socket.protocol.close_code == code
        count = len(other.frames)
        other.until(lambda: len(other.frames) > count + 2)


def test_who_sends_on_after_a_farewell_is_let_go(served, monkeypatch) -> None:
    """One that is told why, and neither closes nor stops, is not listened to for ever."""
    monkeypatch.setattr("finger_sim.view.connection.FAREWELL", 0.2)
    with served.page(), socket.create_connection(("127.0.0.1", served.port)) as raw:
        raw.sendall(UPGRADE)
        hub = until(lambda: served.source.hub if len(served.source.hub._clients) == 2 else None)
        raw.sendall(struct.pack("!BBQI", 0x81, 0xFF, 2**40, 0))  # the head of a text that is far too long

        def send_on() -> None:
            while True:
                raw.sendall(b"x" * 1000)

        with pytest.raises((ConnectionResetError, BrokenPipeError)):
            send_on()
        until(lambda: len(hub._clients) == 1)


def test_no_utf8_ends_the_connection(served) -> None:
    """As the standard says: 1007."""
    with served.page() as page:
        page.next("hello")
        page.socket.send(b"\xff\xfe", text=True)
        page.until_closed()
        assert page.socket.protocol.close_code == 1007


def test_ten_pages_get_all_frames(served) -> None:
    """Each at its rate, with its own numbers."""
    pages = [served.page() for _ in range(10)]
    try:
        assert len({page.next("hello")["client"] for page in pages}) == 10
        for page in pages:
            page.until(lambda page=page: len(page.frames) >= 10)
            assert [frame.seq for frame in page.frames] == sorted({frame.seq for frame in page.frames})
    finally:
        for page in pages:
            page.close()


def test_too_many_pages_are_refused_in_words(served) -> None:
    """1013, and the others go on."""
    pages = [served.page() for _ in range(MOST_CLIENTS)]
    try:
        with served.page() as late:
            late.until_closed()
        assert late.socket.protocol.close_code == 1013
        pages[0].until(lambda: pages[0].frames)
    finally:
        for page in pages:
            page.close()


def test_who_has_not_drawn_gets_no_more_and_then_the_newest(served) -> None:
    """At most AHEAD frames are on their way; the next one after that is the newest, not the next."""
    with served.page() as quick, served.page(draws=False) as slow:
        slow.until(lambda: len(slow.frames) == AHEAD)
        count = len(quick.frames)
        quick.until(lambda: len(quick.frames) > count + 15)
        slow.take(0.1)
        assert len(slow.frames) == AHEAD
        slow.socket.send(struct.pack("<2I", 1, slow.frames[-1].seq))
        slow.until(lambda: len(slow.frames) > AHEAD)
        assert slow.frames[AHEAD].seq > slow.frames[AHEAD - 1].seq + 10
        assert len(slow.frames[AHEAD].samples) > 10  # none of those between is missing


def test_the_rate_that_a_page_wants(served) -> None:
    """A page that wants few frames gets few beside one that wants many."""
    with served.page() as quick, served.page() as slow:
        quick.say("frames", hz=60)
        slow.say("frames", hz=5)
        slow.until(lambda: len(slow.frames) > 3)
        first, count, begin = len(slow.frames), len(quick.frames), time.monotonic()

        def both() -> bool:
            quick.take()
            return len(slow.frames) >= first + 5

        slow.until(both)
        quick.until(lambda: len(quick.frames) > count + 20)
        assert time.monotonic() - begin > 0.6


def test_a_reader_that_has_stopped_costs_nothing() -> None:
    """It gets two frames and a few words; the others are as fast as before; what waits for it has a bound."""
    with Served(Still(nodes=20_000)) as served, served.page() as quick:
        stuck = served.page(max_queue=1)  # its thread stops reading when nobody takes
        stuck.draws = False
        raw = stuck.socket.socket
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        begin = time.monotonic()
        count = len(quick.frames)
        quick.until(lambda: len(quick.frames) > count + 45)
        assert time.monotonic() - begin < 5.0
        clients = list(served.source.hub._clients.values())
        assert len(clients) == 2
        waiting = max(client.connection.waiting for client in clients)
        assert waiting < CROWDED + AHEAD * 20_000 * 16
        stuck.socket.socket.close()
        stuck.close()


def test_what_is_told_to_a_reader_that_has_stopped_is_left_out() -> None:
    """Notices without end: the connection is kept small, or let go."""
    with (
        Served(Still()) as served,
        served.page() as quick,
        socket.create_connection(("127.0.0.1", served.port)) as raw,
    ):
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        raw.sendall(UPGRADE)
        hub = until(lambda: served.source.hub if len(served.source.hub._clients) == 2 else None)
        for _ in range(100):
            served.call(lambda: hub.notice("info", "x" * 50_000))
            assert all(client.connection.waiting < 1_100_000 for client in list(hub._clients.values()))
            quick.take()
        count = len(quick.frames)
        quick.until(lambda: len(quick.frames) > count + 5)


def test_another_mesh_is_another_generation(served) -> None:
    """Topology, parameters and frames of it, to all pages; no frame of the old one after it."""
    with served.page() as page:
        page.until(lambda: len(page.frames) > 3)
        served.source.nodes = 9
        served.call(served.source.begin)
        page.until(lambda: page.frames[-1].generation == 2)
        assert [topology.generation for topology in page.topologies] == [1, 2]
        assert len(page.topologies[1].rest) == len(page.frames[-1].positions) == 9
        after = page.order[page.order.index("topology", page.order.index("frame")) :]
        assert after[1] == "parameters"


def test_a_page_that_comes_late_sees_what_stands_still(served) -> None:
    """The last picture is sent to it, though there is no new one."""
    with served.page() as one:
        one.until(lambda: one.frames)
        served.source.still = True
        with served.page() as two:
            two.until(lambda: two.frames)


def test_recordings_are_fetched(tmp_path: Path) -> None:
    """One file as it is; several as an archive of the folder; what is not here is not offered."""
    single, several = tmp_path / "one", tmp_path / "se ve/ral"
    single.mkdir()
    several.mkdir(parents=True)
    content = bytes(range(256)) * 5000
    (single / "one_0.mcap").write_bytes(content)
    (single / "metadata.yaml").write_text("a: 1")
    for k in range(2):
        (several / f"part_{k}.mcap").write_bytes(content[:100])
    recordings = Recordings()
    assert recordings.add(tmp_path / "none") is None
    assert recordings.add(single) == ("one.mcap", len(content))
    assert recordings.add(several) == ("ral.zip", 200)
    with Served(Still(), recordings=recordings) as served:
        status, headers, body = get(served.port, "/recordings/one.mcap")
        assert (status, body) == (200, content)
        assert headers["content-disposition"] == 'attachment; filename="one.mcap"'
        assert "content-security-policy" in headers
        status, _, body = get(served.port, "/recordings/ral.zip")
        with zipfile.ZipFile(BytesIO(body)) as archive:
            assert sorted(archive.namelist()) == ["ral/part_0.mcap", "ral/part_1.mcap"]
        assert get(served.port, "/recordings/one")[0] == 404
        assert get(served.port, "/recordings/one.mcap", Host="evil.example")[0] == 403


def test_a_port_that_is_taken_is_said(capsys) -> None:
    """By the verb: exit code 2, and what to do."""
    from finger_sim.cli import main

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["view", "--no-browser", "--join", "--port", str(port)]) == 2
    assert f"--port: {port} of 127.0.0.1 is in use" in capsys.readouterr().err


def test_json_is_all_that_texts_hold(served) -> None:
    """Numbers that JSON does not have are null."""
    with served.page() as page:
        page.next("status")
        assert all(json.dumps(each, allow_nan=False) for each in page.said)
