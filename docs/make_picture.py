"""The README's picture, out of the report of `downwash demo --diagnose --hidden rotor_drag:d_xy=0.012,d_z=0.006`:

    python3 docs/make_picture.py demo-out/report.html > docs/demo-diagnose.svg

Two of the report's charts under one another, without what only a browser shows.
"""

import re
import sys

INK = {"c1": "#0072b2", "c2": "#d55e00"}
STYLE = """
.paper{fill:#fff}text{font:13px sans-serif;fill:#5b6572}.name,.title{fill:#1b1f24;font-weight:600}.title{font-size:16px}
.grid{stroke:#e6e9ee;fill:none}.axis{stroke:#d5dae1;fill:none}.band{fill:#eef1f6}
.curve{fill:none;stroke-width:2;stroke-linejoin:round}.c1{stroke:#0072b2}.c2{stroke:#d55e00;stroke-dasharray:9 3}
.ref{stroke:#3b4048;stroke-dasharray:5 4;stroke-width:1.3}.shadow{fill:none;stroke:#5b6572;stroke-opacity:.5}
"""


def chart(page, label):
    """The inside of one chart, its width and its height."""
    pattern = rf'<svg class="chart" viewBox="0 0 (\d+) (\d+)"[^>]*aria-label="{re.escape(label)}">(.*?)</svg>'
    width, height, inside = re.search(pattern, page, re.DOTALL).groups()
    # What the pointer shows.
    inside = re.sub(r'<(rect|circle|path)[^>]*class="hover".*?(/>|</\1>)', "", inside, flags=re.DOTALL)
    inside = re.sub(r"<g[^>]*class=\"hover\".*?</g>|<title>.*?</title>", "", inside, flags=re.DOTALL)
    return inside, int(width), int(height)


def main():
    page = open(sys.argv[1], encoding="utf-8").read()
    path, width, high = chart(page, "3D path")
    error, _, low = chart(page, "distance (m)")
    legend = [
        ("c1", "planned with the vehicle file as shipped"),
        ("c2", "planned with what the diagnosis found"),
        ("ref", "desired"),
    ]
    parts = ['<text class="title" x="20" y="28">A flight of a vehicle with a hidden drag, before and after its diagnosis</text>']
    for row, (kind, words) in enumerate(legend):
        y = 52 + 20 * row
        parts.append(f'<path class="curve {kind}" d="M20 {y - 4}h34"/><text x="62" y="{y}">{words}</text>')
    parts.append(f'<g transform="translate(0 84)">{path}</g>')
    error = re.sub(r'<text class="name".*?</text>', "", error)
    parts.append(f'<text class="title" x="20" y="{high + 104}">Distance from the desired trajectory, m, over time, s</text>')
    parts.append(f'<g transform="translate(0 {high + 112})">{error}</g>')
    height = high + low + 128
    print(f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}">')
    print(f'<style>{STYLE}</style><rect class="paper" width="{width}" height="{height}"/>')
    print("\n".join(parts), "</svg>", sep="\n")


main()
