"""Pieces of a self-contained page: style, numbers, pictures inside the file, tables, a slider over two pictures."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Iterable, Sequence

import numpy as np
from PIL import Image

from gazenerf.viz.metrics.definitions import Metric
from gazenerf.viz.pictures.colormaps import to_uint8

escape = html.escape

VERDICTS = {"fail": "failed", "warn": "to watch", "pass": "passed", "unmeasured": "not measured"}
"""Verdict to how a sentence says it, worst first."""

STYLE = """
:root{color-scheme:light dark;--line:#8884;--soft:#8881}
*{box-sizing:border-box}
body{font:16px/1.5 system-ui,sans-serif;max-width:72rem;margin:0 auto;padding:1rem;background:Canvas;color:CanvasText;
  overflow-wrap:break-word}
h1{font-size:1.5rem;line-height:1.25;margin:.2rem 0 .6rem}
h2{font-size:1.2rem;margin:2.4rem 0 .5rem;padding-top:.4rem;border-top:1px solid var(--line)}
h3{font-size:1rem;margin:1.4rem 0 .3rem}
p{margin:.4rem 0;max-width:46rem}.quiet{opacity:.78;font-size:.9rem}code{font-size:.8rem;opacity:.75}
ul{margin:.3rem 0;padding-left:1.2rem}
.scroll{overflow-x:auto}table{border-collapse:collapse;width:100%;font-size:.93rem}
th,td{text-align:left;padding:.35rem .6rem;border-bottom:1px solid var(--line);vertical-align:top}
td code{display:block}th{font-weight:600}.g th{padding-top:1.1rem;border-bottom-width:2px}
.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}.bar{opacity:.7;font-size:.85em}
.v{display:inline-block;min-width:3.4rem;text-align:center;padding:.05rem .5rem;border-radius:1rem;color:#fff;
  font-size:.83rem;white-space:nowrap;print-color-adjust:exact;-webkit-print-color-adjust:exact}
.pass{background:#1a7f37}.warn{background:#9a6700}.fail{background:#b42318}.unmeasured{background:#666}
.counts{display:flex;flex-wrap:wrap;gap:.4rem;margin:.5rem 0}
.tiles{display:grid;grid-template-columns:repeat(4,1fr);gap:.6rem;margin:.4rem 0}
.tiles.two{grid-template-columns:repeat(2,1fr)}
.tiles.three{grid-template-columns:repeat(3,1fr)}
details{margin:.6rem 0}summary{cursor:pointer;font-size:.93rem}
figure{margin:0;min-width:0}figure img,figure svg{width:100%;display:block;border-radius:.3rem}
figcaption{font-size:.8rem;line-height:1.3;opacity:.85;margin-top:.2rem}
.strip img{height:auto;image-rendering:pixelated}
.key{display:flex;align-items:center;gap:.5rem;font-size:.85rem;margin:.3rem 0;flex-wrap:wrap}
.key img{width:14rem;height:.8rem;border-radius:.2rem}
.slide{display:grid;grid-template-columns:1fr 1fr;gap:.3rem;position:relative}
.slide input{display:none}.slide img{border-radius:.3rem}
.tiles.three:has(.slide){grid-template-columns:2fr 1fr 1fr}
.js .tiles.three:has(.slide){grid-template-columns:repeat(3,1fr)}
.js .slide{display:block}.js .slide .over{position:absolute;inset:0 0 auto 0;clip-path:inset(0 0 0 var(--at,50%))}
.js .slide input{display:block;width:100%;margin:.3rem 0 0}
svg text{fill:currentColor;font:11px system-ui,sans-serif}svg .grid{stroke:currentColor;opacity:.18}
svg .axis{stroke:currentColor;opacity:.55}
@media(max-width:44rem){.tiles,.tiles.three,.tiles.three:has(.slide),.js .tiles.three:has(.slide){
  grid-template-columns:repeat(2,1fr)}.tiles.two.tall{grid-template-columns:1fr}
  .tiles.three figure:has(.slide){grid-column:1/-1}
  body{padding:.7rem}th,td{padding:.3rem .25rem}table{font-size:.85rem}.wide{display:none}.key img{width:6rem}
  td code{overflow-wrap:anywhere;font-size:.72rem}.verdict .bar{display:block}.v{min-width:0;padding:.05rem .4rem}}
@media print{body{max-width:none;font-size:10pt}tr,figure{break-inside:avoid}h2,h3{break-after:avoid}
  .tiles{grid-template-columns:repeat(4,1fr)}.tiles.two{grid-template-columns:repeat(2,1fr)}
  .tiles.three:has(.slide),.js .tiles.three:has(.slide){grid-template-columns:2fr 1fr 1fr}
  .js .slide{display:grid}.js .slide .over{position:static;clip-path:none}.js .slide input,.slide input{display:none}}
"""

SCRIPT = """
document.documentElement.classList.add('js');
document.querySelectorAll('.slide input').forEach(function(i){i.addEventListener('input',function(){
i.parentNode.style.setProperty('--at',i.value+'%')})});
"""
"""Turns pictures side by side into a slider; the page is whole without it."""


def page(title: str, body: str) -> str:
    """A whole page."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>\n{body}\n<script>{SCRIPT}</script></body></html>\n"
    )


def number(value: float, unit: str = "", digits: int | None = None) -> str:
    """A value for people, `not measured` for NaN."""
    if not math.isfinite(value):
        return "not measured"
    if abs(value) < 0.01:
        return f"{value:.2g} {unit}".strip()
    if abs(value) >= 1000.0:
        return f"{value:,.0f} {unit}".strip()
    if digits is None:
        size = abs(value)
        digits = 0 if size >= 100.0 else 1 if size >= 10.0 else 3 if size < 1.0 or not unit else 2
    return f"{value:.{digits}f} {unit}".strip()


def with_error(metric: Metric) -> str:
    """A metric's value and error bar."""
    bar = f" <span class=bar>&plusmn; {number(metric.error)}</span>" if math.isfinite(metric.error) else ""
    return number(metric.value, metric.unit).replace(" ", "&nbsp;", 1 if metric.unit else 0) + bar


def pill(verdict: str, text: str = "") -> str:
    """A coloured verdict."""
    return f"<span class='v {verdict}'>{escape(text or verdict)}</span>"


def counts(metrics: Iterable[Metric]) -> str:
    """How many metrics have each verdict."""
    verdicts = [metric.verdict for metric in metrics]
    shown = (pill(kind, f"{verdicts.count(kind)} {said}") for kind, said in VERDICTS.items() if kind in verdicts)
    return f"<div class=counts>{''.join(shown)}</div>"


def verdict_table(metrics: Sequence[Metric]) -> str:
    """Every measured metric in its group; those that were not measured are named below their group."""
    known = any(math.isfinite(metric.reference) for metric in metrics)
    columns = 6 if known else 5
    rows = []
    for group in dict.fromkeys(metric.group for metric in metrics):
        inside = [metric for metric in metrics if metric.group == group]
        rows.append(f"<tr class=g><th colspan={columns} scope=rowgroup>{escape(group)}</th></tr>")
        rows += [_row(metric, known) for metric in inside if metric.verdict != "unmeasured"]
        if absent := [metric for metric in inside if metric.verdict == "unmeasured"]:
            names = ", ".join(escape(metric.label) for metric in absent)
            rows.append(f"<tr><td colspan={columns} class=quiet>Not measured: {names}.</td></tr>")
    reference = "<th class='n wide'>two references</th>" if known else ""
    return (
        "<div class=scroll><table class=verdict><tr><th>measure</th><th class=n>value</th>"
        f"{reference}<th>verdict</th><th class=n>passes</th><th class='n wide'>warns</th></tr>"
        f"{''.join(rows)}</table></div>"
    )


def _row(metric: Metric, known: bool) -> str:
    sign = "&ge;" if metric.higher_is_better else "&le;"
    reference = f"<td class='n wide'>{number(metric.reference) if math.isfinite(metric.reference) else ''}</td>"
    return (
        f"<tr><td>{escape(metric.label)}<code>{escape(metric.name)}</code></td><td class=n>{with_error(metric)}</td>"
        f"{reference if known else ''}<td>{pill(metric.verdict)}</td>"
        f"<td class=n>{sign}&nbsp;{metric.passes:g}</td><td class='n wide'>{sign}&nbsp;{metric.warns:g}</td></tr>"
    )


def worst_sentence(metrics: Sequence[Metric], most: int = 6) -> str:
    """What failed, or else what is to watch, in one sentence."""
    for verdict, said in (("fail", "Failed"), ("warn", "To watch")):
        if found := [metric for metric in metrics if metric.verdict == verdict]:
            names = "; ".join(f"{escape(m.label)} {number(m.value, m.unit)}" for m in found[:most])
            more = f"; and {len(found) - most} more" if len(found) > most else ""
            return f"<p>{said}: {names}{more}.</p>"
    return "<p>Everything that was measured passed.</p>"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; cells are HTML, columns after the first hold numbers."""
    top = "".join(f"<th{' class=n' if i else ''}>{cell}</th>" for i, cell in enumerate(head))
    body = "".join(
        "<tr>" + "".join(f"<td{' class=n' if i else ''}>{cell}</td>" for i, cell in enumerate(row)) + "</tr>"
        for row in rows
    )
    return f"<div class=scroll><table><tr>{top}</tr>{body}</table></div>"


def folded(title: str, content: str) -> str:
    """Content that opens on a click."""
    return f"<details><summary>{escape(title)}</summary>{content}</details>"


def tiles(figures: Sequence[str]) -> str:
    """Figures in rows of four; nothing for none."""
    return f"<div class=tiles>{''.join(figures)}</div>" if figures else ""


def photograph(picture: np.ndarray, quality: int = 88) -> str:
    """A picture as a JPEG inside the page."""
    return _inline(picture, "jpeg", quality=quality)


def chart(picture: np.ndarray) -> str:
    """A map of few colours as a PNG inside the page, at most 256 colours."""
    image = Image.fromarray(to_uint8(picture)).quantize(256, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    buffer = io.BytesIO()
    image.save(buffer, format="png", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def _inline(picture: np.ndarray, kind: str, **settings: int) -> str:
    buffer = io.BytesIO()
    Image.fromarray(to_uint8(picture)).save(buffer, format=kind, optimize=True, **settings)
    return f"data:image/{kind};base64," + base64.b64encode(buffer.getvalue()).decode()


def figure(source: str, caption: str, kind: str = "") -> str:
    """A picture with its caption."""
    return (
        f"<figure{f' class={kind}' if kind else ''}><img alt='{escape(caption)}' src='{source}'>"
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def slider(left: str, right: str, caption: str) -> str:
    """Two pictures of one size: side by side, or one over the other under a slider where scripts run."""
    return (
        f"<figure><div class=slide><img alt='{escape(caption)}: left' src='{left}'>"
        f"<img class=over alt='{escape(caption)}: right' src='{right}'>"
        f"<input type=range min=0 max=100 value=50 aria-label='{escape(caption)}'></div>"
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )
