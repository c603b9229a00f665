"""Pages opened in a real browser: what they complain of, what does not fit, what cannot be read."""

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
SCHEMES = ("light", "dark")
CONTRAST = 3.0  # of letters against what is behind them

_BEFORE = (
    "<script>window.wrong = []; window.onerror = (text) => { window.wrong.push(text); };</script>"
)
_AFTER = """<script>
window.onload = () => {
  const width = document.documentElement.clientWidth;
  const name = (e) => `${e.tagName} ${e.className.baseVal ?? e.className} ${(e.textContent || "").trim().slice(0, 40)}`;
  const wide = [...document.body.querySelectorAll("*:not(svg *)")].filter((e) => {
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
  const shade = (text) => {
    const [r, g, b, a = 1] = text.match(/[\\d.]+/g).map(Number);
    const [x, y, z] = [r, g, b].map((v) => (v /= 255, v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return [0.2126 * x + 0.7152 * y + 0.0722 * z, a];
  };
  const behind = (e) => {
    for (; e; e = e.parentElement) {
      const [found, opaque] = shade(getComputedStyle(e).backgroundColor);
      if (opaque > 0.5) return found;
    }
    return matchMedia("(prefers-color-scheme: dark)").matches ? 0 : 1;
  };
  const pale = [...document.body.querySelectorAll("*:not(svg *, script, style)")].filter((e) => {
    if (![...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim()) || !e.getClientRects().length) return false;
    const pair = [shade(getComputedStyle(e).color)[0], behind(e)].sort((a, b) => a - b);
    return (pair[1] + 0.05) / (pair[0] + 0.05) < CONTRAST;
  }).map(name);
  const said = document.createElement("pre");
  said.id = "said";
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  said.textContent = JSON.stringify({width, dark, wrong: window.wrong, wide, over, pale});
  document.body.append(said);
};
</script>""".replace("CONTRAST", str(CONTRAST))

_COLLECT = """<script>setInterval(() => {
  const said = [...document.querySelectorAll("iframe")].map((f) => [f.id, f.contentDocument.getElementById("said")]);
  if (said.some(([, s]) => !s) || document.getElementById("got")) return;
  const all = document.createElement("pre");
  all.id = "got";
  all.textContent = JSON.stringify(Object.fromEntries(said.map(([id, s]) => [id, JSON.parse(s.textContent)])));
  document.querySelectorAll("iframe").forEach((f) => f.remove());
  document.body.append(all);
}, 50);</script>"""


def _frame(page, width, scheme):
    """A page in a frame, which may be narrower than a window, and has the colours of its own."""
    text = page.read_text("utf-8")
    text = text.replace("<head>", f"<head>{_BEFORE}").replace("</body>", f"{_AFTER}</body>")
    style = f"width:{width}px;height:2000px;border:0;color-scheme:{scheme}"
    return (
        f'<iframe id="{page.stem} {width} {scheme}" scrolling="no" srcdoc="{html.escape(text)}" '
        f'style="{style}"></iframe>'
    )


def looked_at(pages, folder, widths=WIDTHS, schemes=SCHEMES):
    """What a browser says of pages, opened once: by name, width and colours.

    Width, script errors, what is too wide, labels that stand over others, letters that are hard to read.
    """
    frames = [_frame(p, w, s) for p in pages for w in widths for s in schemes]
    outer = folder / "outer.html"
    outer.write_text(f'<!doctype html><body style="margin:0">{"".join(frames)}{_COLLECT}', "utf-8")
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
        [*words, outer.as_uri()], capture_output=True, text=True, timeout=300, check=False
    )
    found = re.search(r'<pre id="got">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found, done.stderr[-2000:]
    return json.loads(html.unescape(found[1]))


def check(pages, folder, widths=WIDTHS, schemes=SCHEMES):
    """Asserts that pages are sound in a browser, wide and narrow, light and dark."""
    found = looked_at(pages, folder, widths, schemes)
    assert found == {
        f"{page.stem} {width} {scheme}": {
            "width": width, "dark": scheme == "dark", "wrong": [], "wide": [], "over": [], "pale": []
        }
        for page in pages for width in widths for scheme in schemes
    }  # fmt: skip
