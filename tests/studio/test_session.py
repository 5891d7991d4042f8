"""A studio without a browser: what is shown, sampled and saved, and how it ends."""

import gc
import math
import re
import socket
import threading
import weakref
from contextlib import closing, contextmanager
from functools import partial
from types import SimpleNamespace
from unittest.mock import Mock

import msgspec
import numpy as np
import pytest
import viser
from websockets.sync.client import connect

import dexnudge as dn
from dexnudge.errors import InputError
from dexnudge.studio.controls import legend, table, without_folders
from dexnudge.studio.panels import COLOURS
from dexnudge.studio.sample_panel import in_fields
from dexnudge.studio.server import LARGEST_PORT, admitted, open_server
from dexnudge.studio.session import MADE_HERE, MOTION
from dexnudge.studio.stage import OPACITY, fitted
from dexnudge.studio.studio import Studio
from dexnudge.viewer.visual_scene import PALETTE


@pytest.fixture
def session(studio):
    return studio.session


@pytest.fixture
def told(session):
    said = []
    session.tell = lambda title, message, failed: said.append((title, message, failed))
    return said


def test_a_draw_is_sent_once_and_then_only_moved(studio, session):
    bodies = [body.node.name for body in session.stage._bodies]
    nodes = [id(body.node) for body in session.stage._bodies]
    session.select(place=1)
    assert [id(body.node) for body in session.stage._bodies] == nodes
    palm = next(body for body in session.stage._bodies if body.node.name.endswith("palm"))
    assert palm.node.position == pytest.approx(session.samples[1].T_world_palm[:3, 3], abs=1e-6)
    assert any(name.startswith("/goal/") for name in bodies)


def test_all_draws_together_are_one_node_for_each_link(session):
    session.select(together=True)
    palm = next(body for body in session.stage._bodies if body.node.name.endswith("palm"))
    places = palm.node.batched_positions
    assert len(places) == len(session.samples)
    first, last = session.samples[0].T_world_palm, session.samples[len(places) - 1].T_world_palm
    assert places[-1] == pytest.approx((np.linalg.inv(first) @ last)[:3, 3], abs=1e-6)


def test_playing_moves_the_hand_by_the_clock(session):
    session.play("execution/configuration_000")
    with session.lock:  # the studio's own clock waits
        session.player.toggle()
        session.tick(0.02)
        assert session.figures()["moment"] == "0.02 s  push"
        assert session.figures()["outcome"] == "success"
        body = next(body for body in session.stage._bodies if body.group == "object")
        assert body.node.position == pytest.approx(session.scene.T_world_object[:3, 3] + 0.01 * session.scene.motion)
    session.play(MOTION)
    session.play("")
    assert session.figures()["configuration"] == "0"  # as its files are called


def test_what_is_played_has_its_goal_but_no_arrow_that_stays(session):
    def groups():
        return [body.group for body in session.stage._bodies]

    assert "motion" in groups()
    session.play("execution/configuration_000")
    assert "motion" not in groups()
    assert "goal" in groups()


def test_what_was_opened_stays_beside_what_is_sampled(session, told):
    opened, samples = session.shown, session.samples
    session.sample(num=2, seed=1, weights={})
    session.wait(120.0)
    assert (session.together, session.place) == (False, 0)
    assert session.outcome == f"{session.samples.num_verified} of 2 verified"
    assert session.playable == [MOTION]
    drawn = session.samples
    session.open(opened)
    assert session.samples is samples
    assert session.playable == ["execution/configuration_000", MOTION]
    session.open(MADE_HERE)
    assert session.samples is drawn
    with pytest.raises(InputError, match="there is no result 'gone'"):
        session.open("gone")
    assert not told


def test_while_it_draws_the_scene_keeps_its_changes_and_the_controls_are_locked(studio, session, told):
    panel = studio.panels._sample
    session.edit(heading=180.0)
    with session.lock:  # the draws wait
        session.sample(num=2, seed=1, weights={})
        locked = [panel._move, panel._build, panel._reset, *panel._angles.values(), *panel._numbers.values()]
        assert all(handle.disabled for handle in locked)
        with pytest.raises(InputError, match="busy"):
            session.edit(heading=0.0)
        with pytest.raises(InputError, match="busy"):
            session.drag(np.eye(4), ended=False)
    session.wait(120.0)
    assert not any(handle.disabled for handle in locked)
    assert (session.edits.heading, panel._angles["heading"].value) == (180.0, 180)
    assert not told


def test_a_name_that_is_taken_is_not_suggested_again(studio, session, told):
    name = studio.panels._sample._name
    first = name.value
    session.name = "shelf"
    session.save("shelf-studio")
    session.wait(60.0)
    assert name.value == "shelf-studio-2"
    session.save("shelf-studio-2")
    session.wait(60.0)
    assert name.value == "shelf-studio-3" != first
    session.save("shelf-studio")
    session.wait(60.0)
    assert told[-1][1:] == ("there is a folder 'shelf-studio' already; expected a new one; change *save as*", True)


def test_messages_name_the_fields_of_the_page():
    said = "blocked after 41 mm; shorten `motion_length` to 0.04, or choose another `motion`; `settle` is on"
    assert (
        in_fields(said)
        == "blocked after 41 mm; shorten *length* to 0.04 m, or choose another *heading*; *settle* is on"
    )


def test_another_scene_begins_with_the_one_that_is_shown(studio, session):
    panel = studio.panels._sample
    session.build("book", "shelf", 3)
    panel.begin()
    assert (panel._object.value, panel._family.value, panel._scene_seed.value) == ("book", "shelf", 3)


def test_what_is_chosen_shows_its_length_and_outcome_before_it_is_played(studio, session):
    panels = studio.panels
    assert session.player.recording is None
    assert (panels._time.min, panels._time.max, panels._time.disabled) == (0.0, 0.04, False)
    assert "success" in panels._moment.content
    panels._time.value = 0.02
    panels._seek()
    assert session.figures()["moment"] == "0.02 s  push"


def test_an_execution_opens_on_its_own_tab(result, tmp_path):
    for folder, first in ((result, "Draws"), (result / "execution", "Play")):
        with closing(Studio(folder, port=0, out=tmp_path)) as opened:
            assert opened.panels.tabs._tab_labels[0] == first
            assert (opened.session.player.recording is not None) == (first == "Play")


def test_the_motions_arrow_stays_green_inside_the_goal():
    share = OPACITY["goal"]
    red, green, _ = ((1 - share) * a + share * b for a, b in zip(PALETTE["arrow"], PALETTE["ghost"], strict=True))
    assert red < green / 2


def test_a_legend_names_each_colour_once():
    page = legend({"<b>": (1.0, 0.0, 0.5), "motion": (0.0, 1.0, 0.0)})
    assert re.findall(r"rgb\(([\d,]+)\).*?</span> ([^<]*)<", page) == [
        ("255,0,128", "&lt;b&gt;"),
        ("0,255,0", "motion"),
    ]
    assert {"contacts", "forces of the hand", "forces of the supports"} <= set(COLOURS)


def test_a_narrow_window_shows_the_same_width():
    tangent = np.tan(0.25)
    assert fitted(0.5, 800, 600) == pytest.approx(0.5)
    assert fitted(0.5, 1600, 600) == pytest.approx(0.5)
    assert np.tan(fitted(0.5, 300, 600) / 2) * 300 / 600 == pytest.approx(tangent * 4 / 3)


def test_margins_have_two_decimals_each(session):
    session.samples.verdicts.values["force_margin"][0] = 3.0
    assert session.figures()["force margin"] == "3.00"


def test_play_offers_the_only_execution_and_without_draws_no_slider(studio, session):
    panels = studio.panels
    assert panels._recording.value == "execution/configuration_000"
    assert not panels._run.disabled
    panels._toggle()
    assert session.player.running
    session.build("phone", "table", 0)
    assert not panels._place.visible
    assert panels._run.disabled


def test_sampling_appears_as_it_comes_and_is_saved_as_sample_does(session, told, tmp_path):
    seen = []
    session.changed = lambda: seen.append(session.busy)
    session.edit(numbers={**session.edits.numbers, "friction_hand": 0.9})
    session.sample(num=6, seed=1, weights={"contact": 5.0})
    with pytest.raises(InputError, match="busy"):
        session.sample(num=6, seed=1, weights={})
    session.wait(120.0)
    assert not told
    assert any(text.startswith("drawn 4 of 6") for text in seen)
    assert (len(session.samples), session.samples.scene.friction_hand, session.busy) == (6, 0.9, "")
    session.save("mine")
    session.wait(120.0)
    assert told == [("Saved", "mine; dexnudge check mine recomputes its figures", False)]
    assert dn.check(tmp_path / "out" / "mine").agrees


def test_nothing_is_saved_elsewhere(session):
    for name in ("../away", "/away", "", ".hidden", "a/b", "a\\b"):
        with pytest.raises(InputError, match="no folder's"):
            session.save(name)


def test_a_motion_that_is_blocked_is_told(session, told):
    session.build("phone", "corner", 0)
    session.edit(heading=180.0)
    session.sample(num=4, seed=0, weights={})
    session.wait(120.0)
    assert [(title, failed) for title, _, failed in told] == [("Not possible", True)]
    assert "blocked" in told[0][1]


def test_the_scene_before_is_freed(session):
    session.build("phone", "corner", 0)
    mesh = weakref.ref(session.scene.environment_mesh)
    gc.disable()
    try:
        session.build("phone", "table", 0)
        assert mesh() is None
    finally:
        gc.enable()


@pytest.mark.parametrize("phase", ["update", "end"])
@pytest.mark.parametrize(
    ("position", "wxyz"),
    [((0.0, math.nan, 0.0), (1.0, 0.0, 0.0, 0.0)), ((0.0,) * 3, (math.nan,) * 4), ((0.0,) * 3, (0.0,) * 4)],
)
def test_a_drag_to_no_pose_moves_nothing(studio, session, told, position, wxyz, phase):
    session.show_scene()
    before = session.edits
    target = SimpleNamespace(position=np.array(position), wxyz=np.array(wxyz))
    event = SimpleNamespace(client=0, target=target, phase=phase)
    handle = Mock(spec=["on_update"])
    panel = studio.panels._sample
    panel._on(handle, partial(panel._dragged, np.eye(4)))
    handle.on_update.call_args.args[0](event)
    assert session.edits is before
    assert told == []


def test_a_number_out_of_its_domain_changes_nothing(session):
    before = session.edits
    with pytest.raises(InputError):
        session.edit(numbers={**before.numbers, "mass": 0.0})
    assert session.edits is before


def test_closing_leaves_no_thread(result, tmp_path):
    before = set(threading.enumerate())
    with closing(Studio(result, port=0, out=tmp_path)) as studio:
        studio.session.sample(num=500, seed=0, weights={})
    studio.session.wait(120.0)  # for the draws that were under way
    assert len(studio.session.samples) < 500
    for thread in set(threading.enumerate()) - before:
        thread.join(10.0)
    assert set(threading.enumerate()) <= before


@contextmanager
def stopping(server):
    yield server
    server.stop()


def test_a_port_that_is_taken_gives_the_next_one_and_addresses_elsewhere_are_refused():
    with stopping(open_server(port=0)) as first, stopping(open_server(port=first.get_port())) as second:
        assert second.get_port() > first.get_port()
        assert second.url == f"http://127.0.0.1:{second.get_port()}"
    for host, port in (("192.0.2.1", 0), ("no.such.host.invalid", 0), ("127.0.0.1", 70_000)):
        with pytest.raises(InputError, match="expected"):
            open_server(host, port)


def test_where_no_port_is_left_nothing_is_waited_for():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", LARGEST_PORT))
        taken.listen()
        with pytest.raises(InputError, match=f"no free port from {LARGEST_PORT} to {LARGEST_PORT}"):
            open_server(port=LARGEST_PORT)


@pytest.mark.parametrize(
    ("origin", "host", "good"),
    [
        ("http://127.0.0.1:{}", "127.0.0.1:{}", True),
        ("http://localhost:{}", "localhost:{}", True),
        ("https://localhost:9000", "localhost:9000", True),  # forwarded
        (None, "127.0.0.1:{}", True),  # no browser
        ("http://evil.example", "127.0.0.1:{}", False),
        ("http://localhost:3000", "localhost:{}", False),
        ("null", "127.0.0.1:{}", False),
        ("http://evil.example:{}", "evil.example:{}", False),  # its name leads here
    ],
)
def test_other_web_pages_are_refused(origin, host, good):
    with stopping(open_server(port=0)) as server, socket.create_connection(("127.0.0.1", server.get_port())) as raw:
        lines = ["GET / HTTP/1.1", f"Host: {host}", *([f"Origin: {origin}"] if origin else [])]
        lines += ["Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Version: 13"]
        lines += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", f"Sec-WebSocket-Protocol: viser-v{viser.__version__}"]
        raw.sendall("\r\n".join([*lines, "", ""]).replace("{}", str(server.get_port())).encode())
        assert raw.recv(12) == (b"HTTP/1.1 101" if good else b"HTTP/1.1 403")


def frame(**fields):
    return msgspec.msgpack.encode(fields)


UPDATE = {"type": "GuiUpdateMessage", "uuid": "control"}
CAMERA = {"type": "ViewerCameraMessage", "wxyz": [1, 0, 0, 0], "position": [1, 1, 1], "look_at": [0, 0, 0]}
CAMERA |= {"up_direction": [0, 0, 1], "fov": 1, "near": 0.01, "far": 100, "image_height": 300, "image_width": 400}


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b"\xc1",
        b"\x93" * 10_000,
        "text",
        msgspec.msgpack.encode([1]),
        frame(type="Nope"),
        frame(type="GuiUpdateMessage"),
        frame(**UPDATE, updates={"update_cb": 5}),
        frame(**UPDATE, updates={"value": 5, "update_cb": 5}),
        frame(type="GuiUpdateMessage", uuid=[], updates={"value": 5}),
        frame(type="ViewerCameraMessage", wxyz="abcd"),
        *(frame(**UPDATE, updates={"value": value}) for value in ("abc", math.nan, math.inf, None, True, [1])),
    ],
)
def test_what_no_page_of_ours_sends_is_dropped(raw):
    assert admitted(raw, {"control": Mock(value=1, min=1, max=512)}.get) is None


@pytest.mark.parametrize(
    ("now", "sent", "taken"),
    [
        (1, 10**9, 512),
        (1, -3, 1),
        (1, 2.0, 2),
        (1.0, 1e308, 512.0),
        ("all", "verified", "verified"),
        (False, True, True),
    ],
)
def test_a_number_beyond_the_ends_of_its_control_is_brought_to_them(now, sent, taken):
    raw = admitted(frame(**UPDATE, updates={"value": sent}), {"control": Mock(value=now, min=1, max=512)}.get)
    assert msgspec.msgpack.decode(raw) == {**UPDATE, "updates": {"value": taken}}


@pytest.mark.parametrize(("now", "sent"), [("mine", "x" * 10**6), (False, "x"), ("mine", 5)])
def test_texts_are_short_and_boxes_are_ticked_or_not(now, sent):
    assert admitted(frame(**UPDATE, updates={"value": sent}), {"control": Mock(value=now)}.get) is None


def test_hostile_messages_leave_a_control_as_it_is_and_print_no_traceback(capfd):
    with stopping(open_server(port=0)) as server:
        number, address = server.gui.add_number("draws", 32, min=1, max=512, step=1), server.url.replace("http", "ws")
        handle, done = {"type": "GuiUpdateMessage", "uuid": number._impl.uuid}, threading.Event()
        number.on_update(lambda _: done.set())
        with connect(address, subprotocols=[f"viser-v{viser.__version__}"], max_size=None, max_queue=None) as client:
            client.send(b"")
            client.send(frame(**handle, updates={"update_cb": 5}))
            client.send(frame(type="SceneNodeClickMessage", name="/x", instance_index=None, ray_origin=[0]))
            client.send(frame(**handle, updates={"value": math.nan}))
            client.send(frame(**CAMERA))
            client.send(frame(**handle, updates={"value": 10**9}))
            assert done.wait(60.0)
    assert number.value == 512
    assert "Traceback" not in "".join(capfd.readouterr())


def test_what_cannot_be_played_any_more_is_refused_and_so_are_too_many_draws(session):
    with pytest.raises(InputError, match="there is no 'gone' to play"):
        session.play("gone")
    with pytest.raises(InputError, match="expected at most 512"):
        session.sample(num=10**9, seed=0, weights={})


@pytest.mark.parametrize(
    ("path", "hosts", "status"),
    [
        ("/", ["[::1]:{}"], 200),
        ("/", ["127.0.0.1"], 200),
        ("/", ["["], 403),
        ("/", [], 403),
        ("/", ["127.0.0.1:{}", "evil.example"], 403),
        ("/", ["evil.example@127.0.0.1"], 403),
        ("/", ["[::1].evil.example"], 403),
        ("/", ["127.0.0.1/.evil.example"], 403),
        ("/", ["1.2.3.4.5"], 403),
        (f"/{'a' * 300}", ["127.0.0.1:{}"], 404),
    ],
)
def test_a_name_is_read_as_a_whole_and_no_path_is_a_failure(path, hosts, status):
    with stopping(open_server(port=0)) as server, socket.create_connection(("127.0.0.1", server.get_port())) as raw:
        lines = [f"GET {path} HTTP/1.1", *(f"Host: {host}" for host in hosts), "", ""]
        raw.sendall("\r\n".join(lines).replace("{}", str(server.get_port())).encode())
        assert raw.recv(12) == f"HTTP/1.1 {status}".encode()


def test_names_are_text_and_folders_stay_on_this_machine():
    shown = table({"<i>name</i>": "/home/me/scans/<b>phone</b>.obj is empty"})
    assert "&lt;i&gt;name" in shown
    assert "<b>" not in shown
    assert "/home" not in shown
    assert (
        without_folders("cannot read /a/b/c.obj or C:\\x\\y.obj; 3 m/s, a/b")
        == "cannot read c.obj or y.obj; 3 m/s, a/b"
    )
