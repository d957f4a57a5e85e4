"""Running the page's own scripts, in node or in a browser, where there is one."""

import html
import json
import re
import shutil
import subprocess
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")


def in_node(assets: tuple[str, ...], code: str) -> Any:
    """Return the value of ``code``, after the scripts of the page named ``assets``."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node to run the page's own scripts")
    folder = resources.files("graphtrack.report") / "assets"
    scripts = "\n".join((folder / name).read_text(encoding="utf-8") for name in assets)
    program = f"{scripts}\n(async () => {{ {code} }})().then((x) => console.log(JSON.stringify(x)));"
    run = subprocess.run([node], input=program, capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


def in_browser(page: str, code: str, folder: Path) -> Any:
    """Return the value of ``code`` in the page, once its replay is loaded; no script may fail."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip(f"needs a browser to run the page in: one of {', '.join(BROWSERS)}")
    script = f"""<script>
    const errors = [];
    window.addEventListener("error", (event) => errors.push(event.message));
    window.addEventListener("unhandledrejection", (event) => errors.push(String(event.reason)));
    const part = (name) => document.querySelector('[data-part="' + name + '"]');
    // Frames and sizes come by timers: the clock of a headless browser runs ahead of what it draws.
    window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 5);
    window.ResizeObserver = class {{
      constructor(resized) {{ this.resized = resized; }}
      observe() {{ setTimeout(this.resized, 5); }}
    }};
    const next = () => new Promise((done) => setTimeout(done, 50));
    const visit = async () => {{
      while (!part("tally").textContent) await next();
      {code}
    }};
    window.addEventListener("load", async () => {{
      const result = await visit().catch((error) => {{ errors.push(error.stack); return null; }});
      document.documentElement.textContent = JSON.stringify({{ result, errors }});
    }});
    </script>"""
    path = folder / "page.html"
    # Before the scripts of the page, whose errors it should see.
    path.write_text(page.replace("</head>", script + "</head>"), encoding="utf-8")
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-background-networking"]
    options += ["--disable-component-update", "--disable-sync", "--no-first-run", "--window-size=1400,900"]
    options += [f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=20000", "--dump-dom"]
    run = subprocess.run([browser, *options, path.as_uri()], capture_output=True, text=True, timeout=120)
    found = re.search("<html[^>]*>(.*)</html>", run.stdout, flags=re.S)
    assert found, run.stderr[-2000:]
    answer = json.loads(html.unescape(found[1]))
    assert answer["errors"] == []
    return answer["result"]


def delta_decode(codes, step, n):
    """The inverse of `delta_code`: (n,) values, NaN where there is none."""
    out = np.full(n, np.nan)
    last = 0
    for i, code in enumerate(codes or ()):
        if code is not None:
            last += code
            out[i] = last * step
    return out


def decoded(data):
    """Return JavaScript that makes the people of a replay's data."""
    return (
        f"const data = {json.dumps(data)};"
        "const people = data.people.map((coded) => decodePerson(coded, data.steps));"
    )
