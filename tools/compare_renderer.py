"""`python -m tools.compare_renderer --node-modules DIR`: an exported avatar in another project's renderer, beside ours.

The avatar is exported as .ply and drawn from the same cameras by the PlayCanvas engine (npm) in a headless Chromium, which
shares no code with us, and by our rasteriser from the same file. Reports the PSNR of each view and writes OUT/views.png with
rows of theirs, ours, and the difference.


Needs `npm install playcanvas` and Chromium; software rendering will do, no graphics card is needed.
"""

from __future__ import annotations

import argparse
import http.server
import json
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

VIEWS = ((0.0, 0.0), (35.0, 5.0), (-80.0, 0.0), (15.0, -20.0))  # degrees: yaw, pitch
DISTANCE, FOV = 1.1, 23.0
TIMEOUT = 600.0
_PAGE = """<!doctype html><body style="margin:0"><canvas id="c" width="SIZE" height="SIZE"></canvas><script type="module">
import * as pc from "/playcanvas.mjs";
const canvas = document.getElementById("c"), views = VIEWS;
const app = new pc.Application(canvas, {graphicsDeviceOptions: {preserveDrawingBuffer: true, antialias: false, alpha: false}});
app.setCanvasFillMode(pc.FILLMODE_NONE);
app.setCanvasResolution(pc.RESOLUTION_FIXED, SIZE, SIZE);
app.graphicsDevice.maxPixelRatio = 1;
const camera = new pc.Entity("camera");
camera.addComponent("camera", {clearColor: new pc.Color(0, 0, 0, 1), fov: FOV, nearClip: 0.05, farClip: 20,
                               toneMapping: pc.TONEMAP_NONE});
app.root.addChild(camera);
const asset = new pc.Asset("avatar", "gsplat", {url: "/FILE"});
app.assets.add(asset);
asset.on("error", message => fetch("/failed", {method: "POST", body: String(message)}));
let view = 0, waited = 0;
function place() { camera.setPosition(...views[view]); camera.lookAt(0, 0, 0); waited = 0; }
asset.ready(() => {
  const splats = new pc.Entity("splats");
  splats.addComponent("gsplat", {asset: asset});
  splats.setLocalEulerAngles(180, 0, 0);  // these files have y down
  app.root.addChild(splats);
  place();
  app.on("frameend", () => {
    waited += 1;
    if (waited < FRAMES || view >= views.length) return;  // the splats are sorted by a worker, some frames later
    const picture = canvas.toDataURL("image/png");
    const name = "/view" + view;
    view += 1;
    if (view < views.length) place();
    fetch(name, {method: "POST", body: picture});
  });
});
app.assets.load(asset);
app.start();
</script>"""
_SETTLE_FRAMES = 40


def main() -> int:
    """Run; returns the exit code: 1 when a view differs by more than the limit."""
    parser = argparse.ArgumentParser(description="Compare an exported avatar in PlayCanvas's renderer with ours.")
    parser.add_argument("avatar", nargs="?", default="default")
    parser.add_argument("--node-modules", type=Path, required=True, help="folder with playcanvas")
    parser.add_argument("--chromium", default="chromium", help="program to run")
    parser.add_argument("--sh-degree", type=int, default=1)
    parser.add_argument("--size", type=int, default=384)
    parser.add_argument("--out", type=Path, default=Path("out/renderer"))
    parser.add_argument("--views", type=int, default=len(VIEWS), help="how many of the views")
    parser.add_argument("--limit", type=float, default=30.0, help="lowest PSNR that passes, dB")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    from PIL import Image

    from grmm_core.controls.frame import Controls
    from grmm_core.formats import read_splats, write_splats
    from grmm_core.geometry.camera import Camera
    from grmm_core.pictures.images import quantize
    from grmm_core.session import CloudArrays, Instance, RenderOptions, create_session
    from grmm_core.session.exporting import splat_cloud

    file = arguments.out / "avatar.ply"
    size = arguments.size
    cameras = [
        Camera.orbit(size, size, yaw=yaw, pitch=pitch, distance=DISTANCE, fov=FOV) for yaw, pitch in VIEWS[: arguments.views]
    ]
    columns, worst = [], np.inf
    with create_session() as session:
        write_splats(file, splat_cloud(session, session.open(arguments.avatar), Controls(), arguments.sh_degree))
        cloud = read_splats(file)
        number = session.put_cloud("file", "1", CloudArrays(cloud.means, cloud.quats, cloud.scales, cloud.opacities, cloud.sh))
        options = RenderOptions(passes=("rgb",), background=(0.0, 0.0, 0.0))
        ours = [quantize(session.render([Instance(number)], camera, options)["rgb"]) for camera in cameras]
    theirs = _theirs(arguments, file, [camera.position for camera in cameras])
    for (yaw, pitch), own, other in zip(VIEWS, ours, theirs, strict=False):
        error = np.square(own.astype(float) - other.astype(float)).mean()
        psnr = 10.0 * np.log10(255.0**2 / max(error, 1e-9))
        worst = min(worst, psnr)
        print(f"yaw {yaw:g}, pitch {pitch:g}: {psnr:.1f} dB, mean {other.mean():.2f} and {own.mean():.2f}")
        difference = np.clip(np.abs(own.astype(int) - other.astype(int)) * 4, 0, 255).astype(np.uint8)
        columns.append(np.concatenate([other, own, difference], 0))
    Image.fromarray(np.concatenate(columns, 1)).save(arguments.out / "views.png")
    print(f"{cloud.count} splats; wrote {arguments.out / 'views.png'} (theirs, ours, four times the difference)")
    return 0 if worst >= arguments.limit else 1


class _Pictures(http.server.BaseHTTPRequestHandler):
    """Serves the page, the engine and the avatar, and takes the pictures."""

    files: ClassVar[dict[str, tuple[str, bytes]]]
    received: ClassVar[dict[str, bytes]]
    done: ClassVar[threading.Event]
    expected: ClassVar[int]

    def do_GET(self) -> None:
        kind, data = self.files.get(self.path, ("text/plain", b""))
        self.send_response(200 if data else 404)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def do_POST(self) -> None:
        self.received[self.path] = self.rfile.read(int(self.headers["Content-Length"]))
        self.send_response(204)
        self.end_headers()
        if len(self.received) == self.expected or self.path == "/failed":
            self.done.set()

    def log_message(self, *_: Any) -> None:
        """Say nothing."""


def _theirs(arguments: argparse.Namespace, file: Path, positions: list[np.ndarray]) -> list[np.ndarray]:
    """Pictures of the PlayCanvas engine, [H, W, 3] uint8 each."""
    import base64
    import io

    from PIL import Image

    page = _PAGE.replace("SIZE", str(arguments.size)).replace("FOV", str(FOV)).replace("FILE", file.name)
    page = page.replace("VIEWS", json.dumps([position.tolist() for position in positions]))
    page = page.replace("FRAMES", str(_SETTLE_FRAMES))
    engine = arguments.node_modules / "playcanvas" / "build" / "playcanvas.mjs"

    class Handler(_Pictures):
        files: ClassVar[dict[str, tuple[str, bytes]]] = {
            "/": ("text/html", page.encode()), "/playcanvas.mjs": ("text/javascript", engine.read_bytes()),
            f"/{file.name}": ("application/octet-stream", file.read_bytes()),
        }  # fmt: skip
        received: ClassVar[dict[str, bytes]] = {}
        done = threading.Event()
        expected = len(positions)

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    profile = tempfile.mkdtemp(prefix="grmm-chromium-")
    command = [
        arguments.chromium, "--headless=new", "--no-sandbox", "--disable-gpu-sandbox", "--use-gl=angle",
        "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars", f"--user-data-dir={profile}",
        f"http://127.0.0.1:{server.server_port}/",
    ]  # fmt: skip
    browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        Handler.done.wait(TIMEOUT)
    finally:
        browser.terminate()
        browser.wait()
        server.shutdown()
        shutil.rmtree(profile, ignore_errors=True)
    missing = [f"/view{k}" for k in range(len(positions)) if f"/view{k}" not in Handler.received]
    if missing:
        reason = Handler.received.get("/failed", b"no picture came in time").decode(errors="replace")
        raise SystemExit(f"compare_renderer: {reason}")
    result = []
    for k in range(len(positions)):
        data = base64.b64decode(Handler.received[f"/view{k}"].split(b",", 1)[1])
        with Image.open(io.BytesIO(data)) as picture:
            result.append(np.asarray(picture.convert("RGB")))
    return result


if __name__ == "__main__":
    sys.exit(main())
