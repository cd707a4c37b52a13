"""Every HTML report in a real browser: at desktop and phone width, in the light and the dark scheme, with
and without scripts. Pages log no error, fetch nothing, fit and are legible, and their charts respond."""

import json
import subprocess

import pytest

from conftest import DOWNWASH, LOOKS, ROOT

# One xdist worker makes the pages for all: the diagnosis alone takes seconds of every core.
pytestmark = [pytest.mark.computes, pytest.mark.xdist_group("pages")]
# The smallest size of visible text, in pixels, and its element.
SMALLEST = """
(() => {
    let least = 1e9, what = '';
    for (const el of document.querySelectorAll('main *')) {
        const own = [...el.childNodes].some(n => n.nodeType === 3 && n.textContent.trim());
        if (!own || !el.getClientRects().length || el.closest('title')) continue;
        const scale = el.ownerSVGElement ? el.getBoundingClientRect().height / (el.getBBox().height || 1) : 1;
        const size = parseFloat(getComputedStyle(el).fontSize) * scale;
        if (size < least) { least = size; what = el.outerHTML.slice(0, 120); }
    }
    return [least, what];
})()
"""
# Elements that overflow the page outside boxes that scroll or clip.
BEYOND = """
[...document.querySelectorAll('main *')].filter(el => {
    const box = el.getBoundingClientRect();
    return box.width && !el.closest('.scroll') && !el.closest('svg')
        && (box.right > document.documentElement.clientWidth + 1 || box.left < -1);
}).map(el => el.outerHTML.slice(0, 120))
"""
# Charts without a text alternative.
WORDLESS = """
[...document.querySelectorAll('figure svg')].filter(svg => (svg.getAttribute('aria-label') || '').length < 20)
    .map(svg => svg.outerHTML.slice(0, 120))
"""


def downwash(*arguments, folder, codes=(0,)):
    done = subprocess.run([*DOWNWASH, *map(str, arguments)], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode in codes, done.stderr
    return done


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The pages of the quick commands, by name."""
    folder = tmp_path_factory.mktemp("pages")
    trajectory = folder / "circle.toml"
    trajectory.write_text("family = 'sinusoid-xy'\naltitude_m = 1.0\nduration_s = 6.0\namplitude_m = [0.8, 0.6]\nperiod_s = [3.0, 3.0]\n")
    logs = {"a": [], "b": []}
    for seed in (1, 2, 3):
        for side, effects in (("a", []), ("b", ["--effect", "rotor_drag:d_xy=0.01,d_z=0.005"])):
            out = folder / f"{side}{seed}"
            row = json.loads(
                downwash("simulate", trajectory, "--seed", seed, *effects, "--json", "--out", out, folder=folder).stdout
            )
            logs[side].append(folder / row["log"])
    found = {"flight": logs["b"][0].with_suffix(".html")}
    # A log as another program writes it: the same messages without what only downwash records.
    imported = folder / "imported.mcap"
    downwash("log", "import", logs["b"][0], "-o", imported, folder=folder)
    downwash("log", "report", imported, "-o", folder / "recording.html", folder=folder)
    found["recording"] = folder / "recording.html"
    downwash("compare", *logs["a"], "-o", folder / "compare.html", "--", *logs["b"], folder=folder)
    found["compare"] = folder / "compare.html"
    vehicle = ROOT / "config/vehicles/crazyflie.toml"
    downwash(
        "diagnose", *logs["b"], "--vehicle", vehicle, "--twins", 4, "--report", folder / "diagnosis", folder=folder
    )
    found["diagnosis"] = folder / "diagnosis/report.html"
    downwash("onset", logs["b"][0], "--vehicle", vehicle, "--report", folder / "onset", folder=folder)
    found["onset"] = folder / "onset/report.html"
    downwash("plan", trajectory, "--vehicle", vehicle, "--report", folder / "plan", "-o", folder / "plan.json", folder=folder)
    found["plan"] = folder / "plan/report.html"
    return found


@pytest.fixture(scope="module")
def slow_pages(tmp_path_factory):
    """The pages of the slow commands, by name."""
    folder = tmp_path_factory.mktemp("slow")
    downwash("demo", "--out", folder / "demo", folder=folder)
    # With so few cases the exam may exit with 10, which does not concern the page.
    downwash("exam", "--round-trip", "--cases", 2, "--out", folder / "exam", folder=folder, codes=(0, 10))
    return {
        "experiment": folder / "demo/report.html",
        "training": folder / "demo/training/report.html",
        "exam": folder / "exam/report.html",
    }


PAGES = ("flight", "recording", "compare", "diagnosis", "onset", "plan")


@pytest.mark.long
@pytest.mark.parametrize("name", ("experiment", "training", "exam"))
@pytest.mark.parametrize(("width", "dark"), LOOKS)
def test_slow_pages_fit_and_are_legible(slow_pages, browser, name, width, dark):
    check_look(slow_pages, browser, name, width, dark)


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize(("width", "dark"), LOOKS)
def test_pages_fit_and_are_legible(pages, browser, name, width, dark):
    check_look(pages, browser, name, width, dark)


def check_look(pages, browser, name, width, dark):
    browser.open(pages[name], width, dark=dark)
    browser.frame()
    assert browser.complaints == []
    assert browser.requests == [pages[name].resolve().as_uri()]
    assert browser.value("document.documentElement.scrollWidth") <= width
    assert browser.value(BEYOND) == []
    least, what = browser.value(SMALLEST)
    assert least >= 11, what
    background = browser.value("getComputedStyle(document.body).backgroundColor")
    assert (background == "rgb(255, 255, 255)") != dark


@pytest.mark.parametrize("name", PAGES)
def test_pages_are_complete_without_scripts(pages, browser, name):
    browser.open(pages[name], 400, scripts=False)
    text = pages[name].read_text()
    assert str(pages[name].parent) not in text and str(ROOT) not in text
    browser.open(pages[name], 1400)
    assert browser.value(WORDLESS) == []
    links = browser.value("[...document.querySelectorAll('nav a')].map(a => a.getAttribute('href'))")
    assert len(links) >= (1 if name == "onset" else 3) and all(browser.value(f"!!document.querySelector('{link}')") for link in links)


def centre(browser, selector):
    box = browser.value(
        f"(() => {{ const el = document.querySelector('{selector}'); el.scrollIntoView({{block: 'center'}});"
        " const b = el.getBoundingClientRect(); return [b.left, b.top, b.width, b.height]; })()"
    )
    return box[0], box[1] + box[3] / 2, box[2]


def test_charts_zoom_together_and_show_their_values(pages, browser):
    browser.open(pages["flight"])
    tracking = "#tracking-error .frame"
    left, middle, width = centre(browser, tracking)
    ticks = "[...document.querySelectorAll('#desired-and-flown .plot:first-of-type .x')].map(t => Number(t.textContent))"
    before = browser.value(ticks)
    browser.mouse("mouseMoved", left + 0.5 * width, middle)
    browser.frame()
    shown = "document.querySelectorAll('.cross[style*=block]').length"
    assert browser.value(shown) > 10, "the crosshair is in every chart over time"
    value = float(browser.value(f"document.querySelector('#tracking-error .read i b').textContent"))
    low, high = map(float, browser.value("document.querySelector('#tracking-error .plot').dataset.y").split())
    assert low <= value <= high
    browser.mouse("mousePressed", left + 0.5 * width, middle, button="left", clickCount=1)
    for share in (0.52, 0.56, 0.6):
        browser.mouse("mouseMoved", left + share * width, middle, button="left", buttons=1)
    browser.mouse("mouseReleased", left + 0.6 * width, middle, button="left", clickCount=1)
    browser.frame()
    after = browser.value(ticks)
    assert after[-1] - after[0] < 0.2 * (before[-1] - before[0])
    for _ in range(2):
        browser.mouse("mousePressed", left + 0.5 * width, middle, button="left", clickCount=2)
        browser.mouse("mouseReleased", left + 0.5 * width, middle, button="left", clickCount=2)
    browser.frame()
    assert browser.value(ticks) == before
    assert browser.complaints == []


def test_a_legend_toggles_its_curve(pages, browser):
    browser.open(pages["flight"])
    curves = "[...document.querySelectorAll('#desired-and-flown .chart')][0].querySelectorAll('.curve[data-name=desired].off').length"
    assert browser.value(curves) == 0
    browser.value("document.querySelector('#desired-and-flown .legend [data-name=desired]').click()")
    assert browser.value(curves) == 3


def test_an_event_link_zooms_and_the_path_rotates(pages, browser):
    browser.open(pages["flight"])
    at = browser.value(
        "(() => { const a = [...document.querySelectorAll('a[data-at]')].pop(); a.click(); return Number(a.dataset.at); })()"
    )
    browser.frame()
    ticks = browser.value(
        "[...document.querySelectorAll('#desired-and-flown .plot:first-of-type .x')].map(t => Number(t.textContent))"
    )
    assert min(ticks) - 1 <= at <= max(ticks) + 1 and ticks[-1] - ticks[0] < 10
    path = "document.querySelector('.scene .curve').getAttribute('d')"
    before = browser.value(path)
    left, middle, width = centre(browser, ".scene")
    browser.mouse("mousePressed", left + 0.5 * width, middle, button="left", clickCount=1)
    browser.mouse("mouseMoved", left + 0.6 * width, middle + 30, button="left", buttons=1)
    browser.mouse("mouseReleased", left + 0.6 * width, middle + 30, button="left", clickCount=1)
    browser.frame()
    assert browser.value(path) != before
    assert browser.complaints == []


def test_labels_of_the_path_do_not_overlap(pages, browser):
    """At both widths, in the initial view."""
    overlapping = """(() => {
        const boxes = [...document.querySelectorAll('.scene span')].filter(span => span.textContent)
            .map(span => [span.textContent, span.getBoundingClientRect()]);
        const meet = (a, b) => a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1;
        return boxes.flatMap(([text, a], i) => boxes.slice(i + 1).filter(([, b]) => meet(a, b)).map(([other]) => [text, other]));
    })()"""
    for width in (1400, 400):
        for name in ("flight", "compare", "plan"):
            browser.open(pages[name], width)
            browser.frame()
            assert browser.value(overlapping) == [], (name, width)
            outside = """[...document.querySelectorAll('.scene')].flatMap(scene => [...scene.querySelectorAll('span')]
                .filter(span => span.getBoundingClientRect().top < scene.getBoundingClientRect().top - 1)
                .map(span => span.textContent))"""
            assert browser.value(outside) == [], (name, width)


# `report_flight.rs` bounds the page of a made-up log.
@pytest.mark.long
def test_a_ten_minute_flight_makes_a_small_page(browser, tmp_path):
    (tmp_path / "long.toml").write_text(
        "family = 'sinusoid-xy'\naltitude_m = 1.0\nduration_s = 600.0\namplitude_m = [0.8, 0.6]\nperiod_s = [4.0, 4.0]\n"
    )
    # The battery is empty before the end.
    (tmp_path / "config.toml").write_text("[offboard.safety]\non_battery = 'warn'\n")
    done = downwash("simulate", "long.toml", "--config", "config.toml", "--json", "--out", ".", folder=tmp_path)
    row = json.loads(done.stdout)
    page = (tmp_path / row["log"]).with_suffix(".html")
    assert page.stat().st_size < 3e6
    browser.open(page, 1400)
    browser.frame()
    assert browser.complaints == []
    assert browser.value("document.querySelectorAll('.frame').length") > 10
