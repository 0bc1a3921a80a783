"""Matplotlib figures as SVG elements that can stand in a page: no ids that clash, no prologue, a text alternative."""

from __future__ import annotations

import html
import io
import re
from collections.abc import Callable
from typing import Any

STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",  # text stays text: to be searched, and small
    "svg.hashsalt": "thermotrue",  # the same figure is the same file
    "path.simplify_threshold": 0.3,  # of a pixel; drops what paper does not show
    "text.parse_math": False,  # a dollar in a name is a dollar
    "font.size": 7.5,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7.5,
    "axes.linewidth": 0.6,
    "axes.titlepad": 4.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.9",
    "axes.axisbelow": True,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
}


def draw(prefix: str, alt: str, size: tuple[float, float], fill: Callable[[Any], None]) -> str:
    """Return a figure as an SVG element.

    Parameters
    ----------
    prefix : put before all ids inside; letters and digits, different for each figure of a page
    alt : what the picture shows, for those who do not see it
    size : in inches
    fill : draws into the figure
    """
    import matplotlib  # noqa: PLC0415 (slow to import)
    from matplotlib.figure import Figure  # noqa: PLC0415

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=size)
        fill(figure)
        file = io.StringIO()
        nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(file, format="svg", metadata=nothing)
    return _inline(file.getvalue(), prefix, alt)


def _inline(text: str, prefix: str, alt: str) -> str:
    body = text[text.index("<svg") :]
    opening, rest = body.split(">", 1)
    view = re.search(r'viewBox="([^"]*)"', opening)
    assert view is not None
    rest = re.sub(r"<metadata>.*?</metadata>", "", rest, flags=re.DOTALL)
    rest = re.sub(r"<style[^>]*>.*?</style>", "", rest, flags=re.DOTALL)  # it would reach out to the whole page
    rest = re.sub(r"<!--.*?-->\s*", "", rest, flags=re.DOTALL)
    # Ids that nothing refers to go; the others get the prefix.
    used = set(re.findall(r'(?:url\(#|href="#)([^)"]+)', rest))
    rest = re.sub(r' id="([^"]*)"', lambda m: f' id="{prefix}-{m[1]}"' if m[1] in used else "", rest)
    rest = re.sub(r'(url\(#|href="#)', rf"\g<1>{prefix}-", rest).replace("xlink:href", "href")
    rest = re.sub(r"\s*\n\s*", "\n", rest)
    # Text takes the page's font, which is one of the reader's own computer.
    rest = re.sub(r"font-family: [^;\"]*;? ?", "", rest)
    return f'<svg role="img" aria-label="{html.escape(alt)}" viewBox="{view[1]}" xmlns="http://www.w3.org/2000/svg">{rest}'.rstrip()
