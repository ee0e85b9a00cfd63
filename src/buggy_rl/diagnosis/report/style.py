"""How the page looks, and how a figure gets into it."""

import io
import re
from typing import Any

from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

MEASURED = "#222222"
FAINT = "#9a9a9a"
SIMULATED = "#d1495b"
REPAIRED = "#00798c"
STEERING = "#8d6a9f"
THROTTLE = "#b9851b"
ERROR = LinearSegmentedColormap.from_list("error", ["#f3ede6", "#edae49", "#d1495b", "#5c1a33"])
SETTINGS: dict[Any, Any] = {
    "svg.fonttype": "none",  # letters stay letters: small, and found by a search in the page
    "svg.hashsalt": "buggy_rl",  # the same figure has the same ids
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "axes.edgecolor": "#777777",
    "xtick.color": "#444444",
    "ytick.color": "#444444",
}
RASTER = 200  # [dots per inch] of what is too many points for a vector


def tidy(axis: Axes) -> None:
    """A faint grid, and a frame on two sides only."""
    axis.grid(alpha=0.25, lw=0.6)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)


def inline(figure: Figure, words: str) -> str:
    """A figure as an SVG element that refers to nothing outside the page.

    Args:
        figure: Drawn and to be saved with `SETTINGS` in force.
        words: What it shows, for who cannot see it.
    """
    stream = io.StringIO()
    figure.savefig(stream, format="svg", dpi=RASTER, metadata={"Date": None})
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<style type=\"text/css\">.*?</style>", "", text, flags=re.DOTALL)
    opening, rest = text.split(">", 1)
    opening = re.sub(r'\s(xmlns(:xlink)?|width|height|version)="[^"]*"', "", opening)
    label = words.replace("&", "and").replace('"', "'").replace("<", "").replace(">", "")
    return f'{opening} role="img" aria-label="{label}">{rest}'


PAGE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0; background: #f6f4f0; color: #222; line-height: 1.5;
  font: 17px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; }
main { max-width: 1080px; margin: 0 auto; padding: 16px; }
section, header { background: #fff; border: 1px solid #e5e1da; border-radius: 10px;
  padding: 18px 20px; margin: 0 0 16px; }
h1 { font-size: 1.6em; line-height: 1.2; margin: .15em 0 .5em; }
h2 { font-size: 1.2em; margin: 0 0 .4em; }
h3 { font-size: 1em; margin: 1.2em 0 .3em; }
p { margin: .4em 0; max-width: 72ch; }
ul { margin: .3em 0; padding-left: 1.2em; max-width: 76ch; }
small, figcaption, .quiet { color: #666; font-size: .85em; }
.lead { font-size: 1.08em; }
.chip { display: inline-block; padding: 2px 12px; border-radius: 99px; font-size: .85em;
  color: #fff; background: #2e4057; }
.missing_physics, .wrong_parameters { background: #d1495b; }
.no_mismatch { background: #3f7d5c; }
.unknown_physics { background: #8d6a9f; }
.cannot_tell { background: #8a6512; }
.figures { display: grid; gap: 16px; grid-template-columns: repeat(auto-fit, minmax(290px, 1fr)); }
figure { margin: 8px 0; min-width: 0; }
svg { width: 100%; height: auto; display: block; }
svg * { stroke-linejoin: round; stroke-linecap: butt; }
.bars { margin: .6em 0; max-width: 760px; }
.bar { display: grid; gap: 10px; align-items: center; margin: 5px 0;
  grid-template-columns: minmax(110px, 15em) minmax(60px, 1fr) 7em; }
.bar .label { overflow-wrap: anywhere; line-height: 1.2; font-size: .92em; }
.bar .value { font-variant-numeric: tabular-nums; font-size: .92em; line-height: 1.2; }
.track { display: block; height: 14px; background: #eeebe5; border-radius: 3px; }
.track i { display: block; height: 100%; background: #a9a49b; border-radius: 3px; }
.strong .track i { background: #00798c; }
.strong .label, .strong .value { font-weight: 600; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; margin: .5em 0; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 4px 12px; white-space: nowrap;
  border-bottom: 1px solid #e5e1da; }
th:first-child { text-align: left; padding-left: 0; font-weight: 500; }
thead th { font-weight: 600; white-space: normal; border-bottom: 2px solid #bbb5aa; }
.effect { border-left: 4px solid #00798c; padding: 2px 0 2px 16px; margin: 16px 0; }
.equation { font-family: ui-monospace, Menlo, Consolas, monospace; background: #f6f4f0;
  padding: 8px 12px; border-radius: 6px; overflow-x: auto; display: block; font-size: .92em; }
.warning { color: #8a3200; }
@media (max-width: 520px) {
  body { font-size: 16px; } main { padding: 8px; } section, header { padding: 14px; }
  .bar { grid-template-columns: 1fr 5.5em; gap: 2px 8px; } .bar .label { grid-column: 1 / -1; }
  th, td { padding: 4px 7px; font-size: .92em; } .effect { padding-left: 10px; }
}
@media print {
  body { background: #fff; font-size: 10.5pt; } main { max-width: none; padding: 0; }
  section, header { border: 0; padding: 0 0 10px; }
  figure, .effect, .bars, table, header { break-inside: avoid; } h2, h3 { break-after: avoid; }
  .figures { grid-template-columns: repeat(3, 1fr); }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
}
"""
