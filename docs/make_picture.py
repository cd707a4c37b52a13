"""Writes a picture of sections of a report, rendered in a browser:

    python3 docs/make_picture.py flight.html top,path docs/flight.png --height 1150
    python3 docs/make_picture.py compare.html top,differences docs/compare.png --height 800

Sections have the names of the page's links. --dark selects the dark scheme, --width 400 a phone's width.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/python"))

from browser import Browser  # noqa: E402

BOX = """
(() => {
    const boxes = [...document.querySelectorAll(%r)].map(el => el.getBoundingClientRect());
    const [top, bottom] = [Math.min(...boxes.map(b => b.top)), Math.max(...boxes.map(b => b.bottom))];
    return [boxes[0].left, top, boxes[0].width, bottom - top];
})()
"""


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("page", type=Path)
    parser.add_argument("sections", help="one or several, by commas; `top` is the part above the first")
    parser.add_argument("out", type=Path)
    parser.add_argument("--width", type=int, default=1000)
    parser.add_argument("--height", type=int, help="greatest height of the picture")
    parser.add_argument("--dark", action="store_true")
    args = parser.parse_args()
    chosen = ["header,.verdict,.figures" if name == "top" else f"#{name}" for name in args.sections.split(",")]
    browser = Browser()
    try:
        browser.open(args.page, args.width, dark=args.dark)
        browser.frame()
        left, top, width, height = browser.value(BOX % ",".join(chosen))
        margin = 12
        clip = {
            "x": max(0, left - margin),
            "y": max(0, top - margin),
            "width": width + 2 * margin,
            "height": min(args.height or 1e9, height + 2 * margin),
        }
        browser.picture(args.out, clip)
    finally:
        browser.close()


main()
