"""The page of the live view in a real browser: a flight in progress, and the playback of a log."""

import os
import re

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from conftest import LOOKS, Program, fly_arguments, hover_for

HOVER = hover_for(4)
STATE = "document.getElementById('figure-state').textContent"


def address(program):
    program.says("view at ")
    return re.search(r"view at (http://\S+/)", program.err).group(1)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """The log of a short simulated flight."""
    folder = tmp_path_factory.mktemp("view")
    (folder / "hover.toml").write_text(HOVER)
    flown = Program("simulate", folder / "hover.toml", "--no-report", "--out", folder)
    assert flown.finish()[0] == 0
    flown.close()
    return next(folder.glob("*.mcap"))


def logged_events(path):
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [event.message for *_, event in reader.iter_decoded_messages(topics=["/log"])]


def check_clean(browser, url):
    assert browser.complaints == []
    assert set(browser.requests) <= {url, "data:,"}


def test_the_page_shows_a_flight_live(program, browser, tmp_path):
    (tmp_path / "hover.toml").write_text(HOVER)
    flight = program("simulate", tmp_path / "hover.toml", "--no-log", "--view=127.0.0.1:0")
    url = address(flight)
    browser.open(url, 1400, 1000)
    browser.until(f"{STATE} === 'track'")
    browser.until("known.plan.length > 50 && known.trail.length > 10 && known.rotors.length === 4")
    browser.until("document.getElementById('figure-mode').textContent === 'Offboard'")
    browser.until("lines.get('north').t.length > 100 && lines.get('motor 1').t.length > 100")
    # The vehicle is at its commanded height; the page's axes are east, north, up.
    assert abs(browser.value("known.state.p[2]") - 0.8) < 0.3
    events = browser.value("document.getElementById('events').textContent")
    assert "heard" in events
    browser.value("document.getElementById('settings').open = true")
    parameters = browser.until("document.getElementById('parameters').textContent")
    assert "control.law" in parameters
    assert flight.finish()[0] == 0
    # The server ends with the flight, and the page shows it.
    browser.until("document.getElementById('link').className === 'bad'")


def test_a_log_plays_pauses_and_seeks(program, browser, log):
    replay = program("replay", log, "--view=127.0.0.1:0", "--paused")
    url = address(replay)
    browser.open(url, 1400, 1000)
    browser.until("playback && !playback.playing && known.rotors.length === 4 || playback && known.now > 0")
    # The playback state arrives before any command.
    middle = browser.value("(playback.from + playback.to) / 2")
    browser.value("control(1, 1, (playback.from + playback.to) / 2)")
    browser.until("!playback.playing && Math.abs(known.now - (playback.from + playback.to) / 2) < 0.01")
    assert browser.value("known.now") == pytest.approx(middle, abs=0.01)
    browser.until("known.trail.length > 10 && known.plan.length > 50")
    browser.value("document.getElementById('play').click()")
    browser.until(f"playback.playing && known.now > (playback.from + playback.to) / 2 + 0.5 && {STATE} !== '–'")
    # A seek backwards removes later samples from the curves.
    browser.value("control(1, 1, playback.from + 2)")
    browser.until("!playback.playing && Math.abs(known.now - playback.from - 2) < 0.01")
    browser.value("control(0, 8, playback.from + 2)")
    browser.until("playback.speed === 8 && known.now > playback.from + 4")
    curve = browser.value("lines.get('height').t.every((t, i, all) => i === 0 || t > all[i - 1])")
    assert curve is True
    browser.until("!playback.playing && known.now >= playback.to - 0.01")
    check_clean(browser, url)
    replay.signal(2)
    assert replay.finish()[0] == 130


def test_the_page_fits_and_is_readable_in_every_look(program, browser, log):
    url = address(program("replay", log, "--view=127.0.0.1:0"))
    for width, dark in LOOKS:
        browser.open(url, width, 1000, dark=dark)
        browser.until("playback")
        browser.value("control(0, 8, playback.from)")
        browser.until("known.now > playback.from + 3 && known.trail.length > 5")
        assert browser.value("document.documentElement.scrollWidth") <= width
        small = """[...document.querySelectorAll('body *')].filter(e => e.childNodes.length
            && [...e.childNodes].some(n => n.nodeType === 3 && n.data.trim()))
            .map(e => parseFloat(getComputedStyle(e).fontSize)).filter(size => size < 11)"""
        assert browser.value(small) == [], (width, dark)
        unlabelled = "[...document.querySelectorAll('canvas')].filter(c => !c.getAttribute('aria-label')).length"
        assert browser.value(unlabelled) == 0
        check_clean(browser, url)


@pytest.fixture
def writable(program, hover, crazyflie, tmp_path):
    """A long hover with --view-write, on its own vehicle; the program and its URL."""
    hover.write_text(hover_for(120))
    options = ("--view=127.0.0.1:0", "--view-write")
    flight = program(*fly_arguments(hover, crazyflie().peer_url(), tmp_path, *options))
    return flight, address(flight)


def test_the_page_moves_the_goal(writable, browser, tmp_path):
    flight, url = writable
    browser.open(url, 1400, 1000)
    browser.until(f"{STATE} === 'track' && !document.getElementById('change').hidden")
    held = "[...document.querySelectorAll('#writable span')].map(s => s.textContent).join()"
    browser.until(f"{held} === '(now 0.00),(now 0.00),(now 0.00),(now 1.00)'")
    before = browser.value("known.state.p")
    fill = """(values => { [...document.querySelectorAll('#writable input')].forEach((input, i) => input.value = values[i]);
        document.querySelector('#change button').click(); })"""
    # A goal too far away is refused with an event; nothing moves.
    browser.value(f"{fill}([9, 0, 0, 1])")
    browser.until("document.getElementById('events').textContent.includes('a goal moves by at most 3 m')")
    browser.value(f"{fill}([1, -0.5, 0.4, 1.2])")
    browser.until(f"{held} === '(now 1.00),(now -0.50),(now 0.40),(now 1.20)'")
    browser.until("document.getElementById('events').textContent.includes('feedback x 1.20')")
    # East, north, up.
    moved = [before[0] - 0.5, before[1] + 1.0, before[2] + 0.4]
    near = " && ".join(f"Math.abs(known.state.p[{i}] - {where}) < 0.15" for i, where in enumerate(moved))
    browser.until(near)
    check_clean(browser, url)
    flight.signal(2)
    flight.finish()
    # Both are in the log.
    logged = logged_events(next(tmp_path.glob("*.mcap")))
    assert any("a viewer's change is refused (goal 9.00 m north" in text for text in logged)
    assert any("a viewer's change: goal 1.00 m north, -0.50 m east, 0.40 m up" in text for text in logged)


def test_the_change_form_fits_in_every_look(writable, browser):
    _, url = writable
    for width, dark in LOOKS:
        browser.open(url, width, 1000, dark=dark)
        browser.until("!document.getElementById('change').hidden && known.state")
        assert browser.value("document.documentElement.scrollWidth") <= width, dark
        sizes = "[...document.querySelectorAll('#change *')].map(e => parseFloat(getComputedStyle(e).fontSize))"
        assert min(browser.value(sizes)) >= 11, (width, dark)
        assert browser.value("[...document.querySelectorAll('#change input')].every(i => i.labels.length === 1)")
        check_clean(browser, url)


def test_without_view_no_port_is_opened(program, hover, tmp_path):
    """A flight without --view listens on no TCP port."""
    flight = program(*fly_arguments(hover, "udpin:127.0.0.1:0", tmp_path))
    flight.says("link open")
    sockets = set()
    for descriptor in os.listdir(f"/proc/{flight.process.pid}/fd"):
        target = os.readlink(f"/proc/{flight.process.pid}/fd/{descriptor}")
        if target.startswith("socket:["):
            sockets.add(target[8:-1])
    for table in ("tcp", "tcp6"):
        with open(f"/proc/{flight.process.pid}/net/{table}") as lines:
            listening = [line.split()[9] for line in list(lines)[1:] if line.split()[3] == "0A"]
        assert not sockets.intersection(listening)
