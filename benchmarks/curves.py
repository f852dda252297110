"""Curves of SNR over bytes, a panel for each data set, as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import ceil, floor, log2
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

#: A measured point: data set, method, bytes, dB.
Point = tuple[str, str, int, float]

#: Pixels of a panel, and of what lies around its curves: left, top, right, bottom.
PANEL, AROUND = (560, 400), (56, 40, 16, 44)
#: The first method's line is thicker.
WIDTHS = (4, 2)
INK, GRID, PAPER = (30, 30, 30), (225, 225, 225), (255, 255, 255)
COLOURS = (
    (0, 0, 0), (31, 119, 180), (255, 127, 14), (44, 160, 44), (148, 103, 189), (214, 39, 40), (23, 190, 207),
    (188, 189, 34), (140, 86, 75), (227, 119, 194), (127, 127, 127),
)  # fmt: skip


def draw(points: Sequence[Point], methods: Sequence[str], path: Path) -> None:
    """Write a PNG: panels two abreast, and a legend of the methods that have points."""
    panels = list(dict.fromkeys(point[0] for point in points))
    shown = [method for method in methods if any(point[1] == method for point in points)]
    if not panels:
        return
    rows, columns = -(-len(panels) // 2), min(2, len(panels))
    legend_rows = -(-len(shown) // (3 * columns))
    image = Image.new("RGB", (columns * PANEL[0], rows * PANEL[1] + 24 * legend_rows + 12), PAPER)
    pen = ImageDraw.Draw(image)
    colours = {method: COLOURS[number % len(COLOURS)] for number, method in enumerate(methods)}
    for number, name in enumerate(panels):
        at = (number % 2 * PANEL[0], number // 2 * PANEL[1])
        _panel(pen, at, name, [point for point in points if point[0] == name], shown, colours)
    for number, method in enumerate(shown):
        x, y = 24 + number % (3 * columns) * 180, rows * PANEL[1] + 6 + 24 * (number // (3 * columns))
        pen.line((x, y + 8, x + 28, y + 8), colours[method], WIDTHS[method != methods[0]])
        pen.text((x + 36, y), method, INK, _font(14))
    image.save(path)


def _panel(
    pen: ImageDraw.ImageDraw, at: tuple[int, int], name: str, points: Sequence[Point], methods: Sequence[str],
    colours: dict[str, tuple[int, int, int]],
) -> None:
    """Axes and curves of one data set; bytes are logarithmic."""
    left, top = at[0] + AROUND[0], at[1] + AROUND[1]
    right, bottom = at[0] + PANEL[0] - AROUND[2], at[1] + PANEL[1] - AROUND[3]
    low, high = floor(min(point[3] for point in points)), ceil(max(point[3] for point in points) + 0.5)
    few, many = (log2(least(point[2] for point in points)) for least in (min, max))

    def place(nbytes: float, snr: float) -> tuple[float, float]:
        return (left + 8 + (log2(nbytes) - few) / max(many - few, 1e-9) * (right - left - 16),
                bottom - (snr - low) / (high - low) * (bottom - top))

    pen.text((left, at[1] + 12), f"{name}: dB over KiB", INK, _font(16))
    step = next(step for step in (1, 2, 5, 10, 20, 50) if (high - low) / step <= 8 or step == 50)
    for snr in range(-(-low // step) * step, high + 1, step):
        y = place(2**few, snr)[1]
        pen.line((left, y, right, y), GRID)
        pen.text((left - 8, y), str(snr), INK, _font(13), anchor="rm")
    for power in range(ceil(few), floor(many) + 1):
        x = place(2**power, low)[0]
        pen.line((x, top, x, bottom), GRID)
        pen.text((x, bottom + 8), f"{2**power / 1024:g}", INK, _font(13), anchor="mt")
    pen.rectangle((left, top, right, bottom), outline=INK)
    for method in reversed(methods):
        own = [place(nbytes, snr) for nbytes, snr in sorted((p[2], p[3]) for p in points if p[1] == method)]
        for pair in pairwise(own):
            pen.line(pair, colours[method], WIDTHS[method != methods[0]])
        for x, y in own:
            pen.ellipse((x - 3, y - 3, x + 3, y + 3), colours[method])


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)
