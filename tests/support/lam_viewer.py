"""LAM's viewer (npm: gaussian-splat-renderer-for-lam) in a headless Chromium: pictures of what it shows of a file."""

from __future__ import annotations

import base64
import http.server
import io
import json
import subprocess
import threading
from pathlib import Path

import numpy as np
from PIL import Image

_PAGE = """<!doctype html><body style="margin:0"><div id="view" style="width:200px;height:200px"></div><script type="module">
const say = (path, text) => fetch(path, {method: "POST", body: String(text)});
console.error = (...all) => say("/failed", all.map(one => one && one.stack || one).join(" "));
window.onunhandledrejection = event => say("/failed", event.reason && event.reason.stack || event.reason);
const plain = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, options) {
  return plain.call(this, kind, {...options, preserveDrawingBuffer: true});
};
const viewer = await import("/viewer.js");
const expressions = EXPRESSIONS;
let shown = 0;
await viewer.GaussianSplatRenderer.getInstance(document.getElementById("view"), `http://${location.host}/person.zip`, {
  getChatState: () => "Idle", getExpressionData: () => ({...expressions[shown]}), backgroundColor: "0xffffff"});
for (; shown < expressions.length; ) {
  await new Promise(done => setTimeout(done, SECONDS * 1000));
  await say("/picture", document.querySelector("canvas").toDataURL("image/png"));
  if (++shown == expressions.length) break;
}
</script>"""


def pictures(viewer: Path, file: Path, expressions: list[dict[str, float]], seconds: float = 12.0) -> list[np.ndarray]:
    """Pictures of a file with expressions, [200, 200, 3] each, `seconds` after one another; splats fade in at first."""
    received: list[tuple[str, bytes]] = []
    complete = threading.Event()
    page = _PAGE.replace("EXPRESSIONS", json.dumps(expressions)).replace("SECONDS", str(seconds))
    files = {"/": ("text/html", page.encode()), "/viewer.js": ("text/javascript", viewer.read_bytes()),
             "/person.zip": ("application/zip", file.read_bytes())}  # fmt: skip

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            kind, data = files.get(self.path, ("text/plain", b""))
            self.send_response(200 if data else 404)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        def do_POST(self):
            received.append((self.path, self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()
            if self.path == "/failed" or sum(path == "/picture" for path, _ in received) == len(expressions):
                complete.set()

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    browser = subprocess.Popen([
        "chromium", "--headless=new", "--no-sandbox", "--disable-gpu-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader", f"--user-data-dir={file.parent / 'chromium'}", f"http://127.0.0.1:{server.server_port}/",
    ], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # fmt: skip
    try:
        complete.wait(60.0 + 4.0 * seconds * len(expressions))
    finally:
        browser.terminate()
        browser.wait()
        server.shutdown()
    said = [data.decode(errors="replace") for path, data in received if path == "/failed"]
    assert not said, said[0]
    found = [Image.open(io.BytesIO(base64.b64decode(data.split(b",", 1)[1]))) for path, data in received if path == "/picture"]
    assert len(found) == len(expressions), "the viewer showed nothing in time"
    return [np.asarray(picture.convert("RGB")).astype(float) for picture in found]
