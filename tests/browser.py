"""A page opened in a real browser: what it complains of, and what does not fit."""

import html
import json
import re
import shutil
import subprocess

import pytest

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
needs_browser = pytest.mark.skipif(
    CHROMIUM is None, reason="no chromium here: apt-get install chromium"
)
WIDTHS = (1200, 420)

_BEFORE = (
    "<script>window.wrong = []; window.onerror = (text) => { window.wrong.push(text); };</script>"
)
_AFTER = """<script>
window.onload = () => {
  const width = document.documentElement.clientWidth;
  const name = (e) => `${e.tagName} ${e.className.baseVal ?? e.className} ${(e.textContent || "").trim().slice(0, 40)}`;
  const wide = [...document.body.querySelectorAll("*")].filter((e) => {
    const box = e.getBoundingClientRect();
    return box.width && box.right > width + 1 && !e.closest(".scroll");
  }).map(name);
  const over = [];
  for (const drawing of document.querySelectorAll("svg")) {
    const boxes = [...drawing.querySelectorAll("g[id^=text_]")].map((e) => e.getBoundingClientRect()).filter((b) => b.width);
    boxes.forEach((a, i) => boxes.slice(i + 1).forEach((b) => {
      const x = Math.min(a.right, b.right) - Math.max(a.left, b.left);
      const y = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
      const least = Math.min(a.width * a.height, b.width * b.height);
      if (x > 0 && y > 0 && x * y > 0.15 * least) over.push([a.left, a.top, b.left, b.top].map(Math.round).join(" "));
    }));
  }
  const said = document.createElement("pre");
  said.id = "said";
  said.textContent = JSON.stringify({width, wrong: window.wrong, wide, over});
  document.body.append(said);
};
</script>"""


def looked_at(page, width, folder):
    """What a browser of that width says of a page: its width, script errors, what is too wide, labels over others."""
    text = (
        page.read_text("utf-8")
        .replace("<head>", f"<head>{_BEFORE}")
        .replace("</body>", f"{_AFTER}</body>")
    )
    outer = folder / f"outer-{width}.html"  # a frame may be narrower than a window
    outer.write_text(
        f'<!doctype html><body style="margin:0"><iframe id="f" scrolling="no" srcdoc="{html.escape(text)}" '
        f'style="width:{width}px;height:2000px;border:0"></iframe><script>setInterval(() => {{'
        'const s = document.getElementById("f").contentDocument.getElementById("said");'
        'if (s && !document.getElementById("got")) { const p = document.createElement("pre"); p.id = "got";'
        "p.textContent = s.textContent; document.body.append(p); }}, 50);</script>",
        "utf-8",
    )
    words = [
        CHROMIUM,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--window-size=1300,2000",
        "--virtual-time-budget=5000",
        "--dump-dom",
    ]
    done = subprocess.run(
        [*words, outer.as_uri()], capture_output=True, text=True, timeout=120, check=False
    )
    found = re.search(r'<pre id="got">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found, done.stderr[-2000:]
    return json.loads(html.unescape(found[1]))


def check(page, folder):
    """Asserts that a page is sound in a browser, wide and narrow."""
    for width in WIDTHS:
        found = looked_at(page, width, folder)
        assert found == {"width": width, "wrong": [], "wide": [], "over": []}
