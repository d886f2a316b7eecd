#!/usr/bin/env python3
"""Draws the figures of docs/src/how.md: `python3 docs/figures.py`. Nothing but the standard library is needed."""

import math
import pathlib

OUT = pathlib.Path(__file__).parent / "src" / "pictures"
STYLE = """<style>
text{font:14px system-ui,sans-serif;fill:#1c1d1f}.small{font-size:12px}.soft{fill:#5c6066}.b{font-weight:600}.m{text-anchor:middle}.e{text-anchor:end}
.box{fill:#f5f6f7;stroke:#8a8f96}.heavy{fill:#dbe9f8;stroke:#1766b5}.line{stroke:#5c6066;fill:none;stroke-width:1.5}.thin{stroke:#c3c7cc;fill:none}
.mark{stroke:#b3261e;stroke-width:2;fill:none}.c1{fill:#e41a1c}.c2{fill:#377eb8}.c3{fill:#4daf4a}.c4{fill:#d19a00}.head{fill:#5c6066}
@media(prefers-color-scheme:dark){text{fill:#e6e6e3}.soft{fill:#a2a5aa}.box{fill:#1f2226;stroke:#70757c}.heavy{fill:#17324f;stroke:#7ab8f5}.line{stroke:#a2a5aa}.thin{stroke:#43474d}.mark{stroke:#ff8a80}.head{fill:#a2a5aa}}
</style><defs><marker id="a" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto"><path class="head" d="M0 0 8 4 0 8z"/></marker></defs>"""


def svg(name: str, width: int, height: int, title: str, parts: list[str]) -> None:
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" role="img">'
    (OUT / f"{name}.svg").write_text("\n".join([head, f"<title>{title}</title>", STYLE, *parts, "</svg>", ""]))


def text(x: float, y: float, words: str, kind: str = "") -> str:
    return f'<text x="{x:g}" y="{y:g}" class="{kind}">{words}</text>'


def box(x: float, y: float, w: float, h: float, name: str, below: str = "", kind: str = "box") -> str:
    middle = y + h / 2 + (5 if not below else -2)
    parts = [f'<rect x="{x}" y="{y}" width="{w}" height="{h}" rx="6" class="{kind}"/>']
    parts.append(text(x + w / 2, middle, name, "b m"))
    if below:
        parts.append(text(x + w / 2, middle + 18, below, "small soft m"))
    return "".join(parts)


def arrow(points: list[tuple[float, float]]) -> str:
    way = " ".join(f"{x:g},{y:g}" for x, y in points)
    return f'<polyline points="{way}" class="line" marker-end="url(#a)"/>'


def data_flow() -> None:
    parts = [
        box(20, 30, 150, 54, "input, clock", "from outside"),
        box(290, 20, 170, 74, "renderer", "draws, splats, shows", "heavy"),
        box(600, 30, 170, 54, "analyzer", "what draws the eye"),
        box(600, 190, 170, 54, "allocator", "what is worth tracing"),
        box(290, 190, 170, 54, "cache ager", "which samples hold"),
        box(20, 190, 150, 54, "illuminator", "light on surfaces"),
        box(290, 320, 480, 54, "ray tracers 1 … n", "one for each free core", "heavy"),
        arrow([(170, 57), (288, 57)]), text(229, 49, "camera, deadline", "small m"),
        arrow([(460, 44), (598, 44)]), text(529, 36, "newest frame", "small m"),
        arrow([(685, 84), (685, 188)]), text(693, 140, "objects ranked", "small"),
        arrow([(440, 94), (598, 205)]), text(560, 150, "view, residuals", "small"),
        arrow([(340, 94), (340, 188)]), text(332, 128, "camera moved", "small e"),
        arrow([(390, 188), (390, 96)]), text(398, 172, "reprojected", "small"),
        arrow([(685, 244), (685, 318)]), text(693, 286, "jobs, best first", "small"),
        arrow([(340, 320), (340, 246)]), text(332, 296, "samples", "small e"),
        arrow([(500, 320), (500, 156), (430, 96)]), text(508, 296, "samples", "small"),
        arrow([(95, 188), (95, 130), (288, 80)]), text(120, 136, "better light", "small"),
    ]  # fmt: skip
    svg("data-flow", 800, 394, "Six kinds of actors and the messages between them", parts)


def one_frame() -> None:
    left, right = 130, 760
    at = lambda ms: left + (right - left) * ms / 100  # noqa: E731
    lanes = ["renderer", "cache ager", "allocator", "tracer 1", "tracer 2", "analyzer"]
    parts = []
    for i, lane in enumerate(lanes):
        y = 40 + 44 * i
        parts += [text(left - 12, y + 19, lane, "e"), f'<line x1="{left}" x2="{right}" y1="{y + 36}" y2="{y + 36}" class="thin"/>']

    def work(lane: int, start: float, end: float, words: str, kind: str = "box") -> None:
        y = 44 + 44 * lane
        parts.append(f'<rect x="{at(start):g}" y="{y}" width="{at(end) - at(start):g}" height="26" rx="3" class="{kind}"/>')
        parts.append(text((at(start) + at(end)) / 2, y + 18, words, "small m"))

    work(0, 0, 18, "base layer", "heavy")
    work(0, 24, 34, "warped", "heavy")
    work(0, 46, 50, "")
    work(0, 62, 66, "")
    work(0, 78, 82, "")
    work(0, 88, 100, "compose", "heavy")
    work(1, 1, 22, "which still hold")
    work(2, 19, 27, "order")
    work(2, 48, 51, "")
    work(2, 64, 67, "")
    for start, end in [(27, 44), (45, 60), (61, 76), (77, 88)]:
        work(3, start, end, "job", "heavy")
        work(4, start + 1, min(end + 2, 88), "job", "heavy")
    work(5, 0, 60, "saliency of the frame before")
    for ms, words in [(0, "the frame begins"), (88, "work ends"), (100, "the deadline")]:
        parts.append(f'<line x1="{at(ms):g}" x2="{at(ms):g}" y1="30" y2="306" class="mark"/>')
        parts.append(text(at(ms), 22, words, "small m" if ms else "small"))
    for ms in range(0, 101, 20):
        parts.append(text(at(ms), 326, f"{ms} ms", "small soft m"))
    svg("one-frame", 800, 336, "One frame of a tenth of a second, actor by actor", parts)


def lattice() -> None:
    side, origin, step = 25, (30, 30), 15
    parts = []
    # Each next coarser level is the one before, turned by atan(1/2) and wider by the root of 5: a = (2, 1), b = (-1, 2).
    inside = lambda x, y, a, b: (x * a + y * b) % 5 == 0 and (-x * b + y * a) % 5 == 0  # noqa: E731

    def level(x: int, y: int) -> int:
        x, y, coarse = x - side // 2, y - side // 2, 0
        while coarse < 3 and inside(x, y, 2, 1):
            x, y, coarse = (2 * x + y) // 5, (-x + 2 * y) // 5, coarse + 1
        return coarse

    radius, kinds = [2.4, 4.2, 5.6, 7.2], ["c4", "c3", "c2", "c1"]
    for y in range(side):
        for x in range(side):
            coarse = level(x, y)
            px, py = origin[0] + step * x, origin[1] + step * y
            parts.append(f'<circle cx="{px}" cy="{py}" r="{radius[coarse]}" class="{kinds[coarse]}"/>')
    names = [("c1", 7.2, "one pixel in 125"), ("c2", 5.6, "with these, one in 25"), ("c3", 4.2, "one in 5"), ("c4", 2.4, "every pixel")]
    for i, (kind, r, words) in enumerate(names):
        parts += [f'<circle cx="440" cy="{60 + 34 * i}" r="{r}" class="{kind}"/>', text(460, 65 + 34 * i, words)]
    middle = (origin[0] + step * (side // 2), origin[1] + step * (side // 2))
    degrees = math.degrees(math.atan(0.5))
    parts.append(text(440, 220, f"each level is turned by {degrees:.1f}° against", "small soft"))
    parts.append(text(440, 238, "the one before, and √5 times finer", "small soft"))
    parts.append(f'<circle cx="{middle[0]}" cy="{middle[1]}" r="10" class="mark"/>')
    parts.append(text(440, 270, "ring: the middle of the picture,", "small soft"))
    parts.append(text(440, 288, "where all levels begin", "small soft"))
    svg("lattice", 700, 420, "Four levels of the root-5 lattice", parts)


def life() -> None:
    steps = [
        ("asked for", "a job of the allocator: object, tile, level"),
        ("traced", "through one pixel, by whichever tracer is free"),
        ("splatted", "over its tile of the lattice, behind the test of ids"),
        ("kept", "by the cache ager, with point, normal and view"),
        ("reprojected", "the camera has moved: to where its point is now"),
        ("voted on", "of its object's samples of that age, how many still hold?"),
        ("replaced", "by a finer sample, or one of this view"),
    ]
    parts = []
    for i, (name, what) in enumerate(steps):
        y = 20 + 56 * i
        parts.append(box(40, y, 150, 38, name, "", "heavy" if i in (1, 4) else "box"))
        parts.append(text(210, y + 24, what))
        if i:
            parts.append(arrow([(115, y - 18), (115, y - 2)]))
    parts.append(arrow([(40, 20 + 56 * 5 + 19), (16, 20 + 56 * 5 + 19), (16, 20 + 56 * 4 + 19), (38, 20 + 56 * 4 + 19)]))
    parts.append(text(210, 20 + 56 * 5 + 43, "if not: expired, too old or turned by more than δ", "small soft"))
    svg("life-of-a-sample", 640, 410, "What becomes of a sample", parts)


if __name__ == "__main__":
    data_flow()
    one_frame()
    lattice()
    life()
