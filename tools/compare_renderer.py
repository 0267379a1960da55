"""`python -m tools.compare_renderer --node-modules DIR`: an exported avatar in another project's renderer, beside ours.

The avatar is exported as .ply (or as --format says), and drawn from the same cameras by PlayCanvas's `splat-transform` (npm),
which shares no code with us, and by our rasteriser from the same file. Reports the PSNR of each view and writes OUT/views.png
with rows of theirs, ours, and the difference.

Needs `npm install @playcanvas/splat-transform` and a WebGPU device. Without a graphics card Vulkan's software device will do;
where it is not found by itself, name its description: VK_ICD_FILENAMES=/usr/lib/chromium/vk_swiftshader_icd.json.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np

VIEWS = ((0.0, 0.0), (35.0, 5.0), (-80.0, 0.0), (15.0, -20.0))  # degrees: yaw, pitch
DISTANCE, FOV = 1.1, 23.0
TIMEOUT = 600.0


def main() -> int:
    """Run; returns the exit code: 1 when a view differs by more than the limit."""
    parser = argparse.ArgumentParser(description="Compare an exported avatar in PlayCanvas's renderer with ours.")
    parser.add_argument("avatar", nargs="?", default="default")
    parser.add_argument("--node-modules", type=Path, required=True, help="folder with @playcanvas/splat-transform")
    parser.add_argument("--format", default=".ply", choices=(".ply", ".spz", ".splat", ".sog"))
    parser.add_argument("--sh-degree", type=int, default=1)
    parser.add_argument("--size", type=int, default=384)
    parser.add_argument("--out", type=Path, default=Path("out/renderer"))
    parser.add_argument("--views", type=int, default=len(VIEWS), help="how many of the views")
    parser.add_argument("--limit", type=float, default=30.0, help="lowest PSNR that passes, dB")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    from PIL import Image

    from grmm_core.camera import Camera
    from grmm_core.controls import Controls
    from grmm_core.formats import read_splats, write_splats
    from grmm_core.images import quantize
    from grmm_core.session import CloudArrays, Instance, RenderOptions, create_session
    from grmm_core.session.exporting import splat_cloud

    file = arguments.out / f"avatar{arguments.format}"
    rows, worst = [], np.inf
    with create_session() as session:
        write_splats(file, splat_cloud(session, session.open(arguments.avatar).id, Controls(), arguments.sh_degree))
        cloud = read_splats(file)
        number = session.put_cloud("file", "1", CloudArrays(cloud.means, cloud.quats, cloud.scales, cloud.opacities, cloud.sh))
        for index, (yaw, pitch) in enumerate(VIEWS[: arguments.views]):
            camera = Camera.orbit(arguments.size, arguments.size, yaw=yaw, pitch=pitch, distance=DISTANCE, fov=FOV)
            options = RenderOptions(passes=("rgb",), background=(0.0, 0.0, 0.0))
            ours = quantize(session.render([Instance(number)], camera, options)["rgb"])
            theirs = _theirs(arguments, file, camera.position, arguments.out / f"view{index}.webp")
            error = np.square(ours.astype(float) - theirs.astype(float)).mean()
            psnr = 10.0 * np.log10(255.0**2 / max(error, 1e-9))
            worst = min(worst, psnr)
            print(f"yaw {yaw:g}, pitch {pitch:g}: {psnr:.1f} dB, mean colour {theirs.mean():.2f} and {ours.mean():.2f}")
            difference = np.clip(np.abs(ours.astype(int) - theirs.astype(int)) * 4, 0, 255).astype(np.uint8)
            rows.append(np.concatenate([theirs, ours, difference], 0))
    Image.fromarray(np.concatenate(rows, 1)).save(arguments.out / "views.png")
    print(f"{cloud.count} splats; wrote {arguments.out / 'views.png'} (theirs, ours, four times the difference)")
    return 0 if worst >= arguments.limit else 1


def _theirs(arguments: argparse.Namespace, file: Path, position: np.ndarray, target: Path) -> np.ndarray:
    """Picture of splat-transform, [H, W, 3] uint8. It turns files by half a turn about z where we turn them about x."""
    from PIL import Image

    program = arguments.node_modules / "@playcanvas" / "splat-transform" / "bin" / "cli.mjs"
    where = ",".join(f"{value:.7f}" for value in position * [-1.0, 1.0, -1.0])
    command = [
        "node", str(program), "-q", "-w", str(file), str(target), "--camera", where, "--look-at", "0,0,0", "--fov", str(FOV),
        "--resolution", f"{arguments.size}x{arguments.size}",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, check=False)
    if done.returncode != 0:
        raise SystemExit(f"compare_renderer: splat-transform failed: {done.stderr.strip() or done.stdout.strip()}")
    with Image.open(target) as picture:
        return np.asarray(picture.convert("RGB"))


if __name__ == "__main__":
    sys.exit(main())
