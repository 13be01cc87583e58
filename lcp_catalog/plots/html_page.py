"""The frame of every page: one HTML document that needs nothing but itself, light or dark as its reader likes it."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape


def page(
    title: str, body: Iterable[str], style: str = "", script: str = "", definitions: str = ""
) -> str:
    """A whole document. ``title`` is text; the rest is markup: parts of the body (empty ones are left
    out), rules after the common ones, a script, what drawings in the body refer to.
    """
    main = "\n".join(part for part in body if part)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}{style}</style>\n</head>\n<body>\n"
        + (f"{definitions}\n" if definitions else "")
        + f"<main>\n{main}\n</main>\n"
        + (f"<script>{script}</script>\n" if script else "")
        + "</body>\n</html>\n"
    )


def header(heading: str, below: str) -> str:
    """The page's heading and a soft line below; text."""
    return f"<header><h1>{escape(heading)}</h1><p class='file'>{escape(below)}</p></header>"


def tiles(figures: Iterable[tuple[str, str]]) -> str:
    """Figures that catch the eye, each with what it is; text."""
    shown = "".join(
        f"<div class='tile'><strong>{escape(value)}</strong><span>{escape(meaning)}</span></div>"
        for value, meaning in figures
    )
    return f"<div class='tiles'>{shown}</div>"


def facts(rows: Iterable[tuple[str, str]]) -> str:
    """Names and what they are, one below the other; text."""
    shown = "".join(f"<dt>{escape(name)}</dt><dd>{escape(meaning)}</dd>" for name, meaning in rows)
    return f"<dl>{shown}</dl>"


_STYLE = """
:root{color-scheme:light dark;--bg:#fbfbf9;--card:#fff;--ink:#1c1d20;--soft:#5d6068;--line:#d9dade;--void:#eeeeec}
@media (prefers-color-scheme:dark){:root{--bg:#15161a;--card:#1e2026;--ink:#e9e9ec;--soft:#a0a3ad;--line:#383b44;--void:#2a2c33}}
*{box-sizing:border-box}
body{margin:0;background:var(--bg);color:var(--ink);font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif}
main{max-width:1120px;margin:0 auto;padding:24px 20px 64px}
h1{font-size:1.7rem;line-height:1.2;margin:0}h2{font-size:1.25rem;margin:44px 0 8px}h3{font-size:.95rem;margin:0 0 6px}
p{margin:6px 0;max-width:72ch}.file,.none{color:var(--soft);margin:2px 0 0;overflow-wrap:anywhere}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(150px,1fr));gap:12px;margin:22px 0}
.tile{background:var(--card);border:1px solid var(--line);border-radius:8px;padding:12px 14px}
.tile strong{display:block;font-size:1.6rem;line-height:1.2}.tile span{color:var(--soft);font-size:.86rem}
dl{display:grid;grid-template-columns:max-content 1fr;gap:2px 16px;margin:0}
dt{color:var(--soft)}dd{margin:0;overflow-wrap:anywhere;min-width:0}
figure{margin:0}figcaption{font-size:.88rem;color:var(--soft)}figcaption b{color:var(--ink)}
svg{display:block;max-width:100%;font:12px system-ui,sans-serif}svg text{fill:var(--soft)}.defs{position:absolute}
code,pre{font:12px/1.5 ui-monospace,Menlo,Consolas,monospace}code{overflow-wrap:anywhere}
pre{overflow-x:auto;background:var(--card);border:1px solid var(--line);border-radius:8px;padding:12px}
summary{cursor:pointer;padding:6px 0}
.wide{overflow-x:auto}table{border-collapse:collapse;font-size:.92rem;width:100%}
td,th{padding:5px 10px;text-align:right;vertical-align:top;border-bottom:1px solid var(--line);white-space:nowrap}
th[scope=row]{text-align:left;font-weight:600}
select{font:inherit;color:inherit;background:var(--card);border:1px solid var(--line);border-radius:6px;padding:2px 6px}
@media (max-width:520px){main{padding:16px 14px 48px}dl{grid-template-columns:1fr;gap:0}dl dd{margin-bottom:6px}}
@media print{:root{color-scheme:light;--bg:#fff;--card:#fff;--ink:#111;--soft:#444;--line:#bbb;--void:#eee}
main{max-width:none;padding:0}figure,.tile,tr{break-inside:avoid}h2,h3{break-after:avoid}.wide{overflow:visible}}
"""
