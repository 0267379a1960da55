"""`grmm render`: draw a picture of an avatar, or one for each frame of a recorded performance.

With --performance, #### in the name is where a frame's number goes. The main file is a PNG with straight alpha, an OpenEXR
(scene-linear, premultiplied, every pass as named channels) or an .npz with the raw arrays. Beside a PNG called ``out.png``,
each further pass of ``--passes`` is a file of its own:

================  ========================================================================
out.alpha.png     coverage, 16-bit grey
out.depth.npy     camera depth in metres, float32 [H, W]; 1e10 where nothing is
out.raw.png       before the refinement network, straight alpha
out.normal.png    world-space normals as 0.5 + 0.5 n, 16-bit
out.mask.png      coverage of the avatar, 16-bit grey
out.hair.png      coverage of its strands, 16-bit grey
out.features.npy  feature channels, float32 [H, W, F], premultiplied
out.diffuse.npy   light from inside the skin, float32 [H, W, 3], linear, premultiplied
out.specular.npy  light off its surface, likewise; both add up to the picture
out.shadow.png    share of the lamps' light that reaches it, 16-bit grey
================  ========================================================================
"""

from __future__ import annotations

import argparse
import io
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

from ..avatar import EXTENSION, load_avatar
from ..controls.frame import Controls
from ..errors import ConfigError
from ..files.access import atomic_write_bytes
from ..formats.sequence import frame_path
from ..geometry.camera import Camera
from ..hair.swing import SwingBake, write_bake
from ..light.lamps import Lighting
from ..light.parse import FORMS, PHOTO_WORD, lighting_of
from ..light.shading import Response
from ..model.portrait import PORTRAIT_DISTANCE, PORTRAIT_FOV
from ..pictures.color import scene_linear_premultiplied, srgb_to_linear, straight_rgba
from ..pictures.images import quantize, write_exr, write_png
from ..session import (
    FINAL_STRANDS,
    MAX_LOD,
    PASS_NAMES,
    AvatarInfo,
    HairUse,
    Instance,
    RenderOptions,
    Session,
    create_session,
)
from ..session.swinging import swinging, worn_groom
from .common import add_avatar, add_controls, add_hair, add_model, add_output, check_folder, controls_of, hair_of, picture_size
from .playing import add_playing, performance_of, playable, together

SUFFIXES = (".png", ".exr", ".npz")
_AS_NUMBERS = ("depth", "features", "diffuse", "specular")  # passes that no PNG holds: beyond 0..1


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "render",
        help="draw a picture of an avatar, or of each frame of a performance",
        description="Draw a picture of an avatar, or of each frame of a performance.",
        epilog=(__doc__ or "").partition("\n\n")[2],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_avatar(parser)
    add_output(parser, "the picture to write: .png, .exr or .npz")
    parser.add_argument("--size", type=picture_size, default=(512, 512), metavar="512|WxH", help="pixels (default: 512)")
    add_controls(parser)
    add_hair(parser)
    parser.add_argument(
        "--light", action="append", default=[], metavar="LIGHT", help=f"light it by {FORMS}; several times for several lights"
    )
    parser.add_argument(
        "--wrinkles", type=float, default=1.0, metavar="X", help="factor of the furrows of the expression (default: 1)"
    )
    parser.add_argument("--yaw", type=float, default=0.0, help="camera angle to the subject's left, degrees (default: 0)")
    parser.add_argument("--pitch", type=float, default=0.0, help="camera angle upwards, degrees (default: 0)")
    parser.add_argument("--distance", type=float, default=PORTRAIT_DISTANCE, help="metres from the head (default: %(default)s)")
    parser.add_argument("--fov", type=float, default=PORTRAIT_FOV, help="angle of view, degrees (default: %(default)s)")
    parser.add_argument("--no-refine", action="store_true", help="leave out the refinement network")
    parser.add_argument("--coarse", action="store_true", help="refine at half the resolution: faster, a little softer")
    parser.add_argument("--lod", type=int, choices=range(MAX_LOD + 1), default=0, help="fewer, larger Gaussians (default: 0)")
    parser.add_argument("--background", metavar="R,G,B", type=_color, help="display sRGB 0..1 (default: transparent)")
    parser.add_argument(
        "--passes", type=_passes, default=("rgb",), metavar="LIST", help=f"of {','.join(PASS_NAMES)} (default: rgb)"
    )
    playing = parser.add_argument_group("performances")
    add_playing(playing)
    playing.add_argument("--frames", type=_range, metavar="A-B", help="of the performance, from 0 on (default: all)")
    playing.add_argument(
        "--hair-swing", nargs="?", const="", metavar="FILE",
        help="let long hair swing; with an .npz file, keep how in it, or use what it holds",
    )  # fmt: skip
    add_model(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Draw the picture and write the files."""
    path: Path = args.output
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"{path} does not end in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}; choose one of these formats.")
    check_folder(path)
    controls, (lighting, response) = controls_of(args), _light(args)
    played = performance_of(args)
    if played is None and (args.hair_swing is not None or args.frames is not None):
        raise ConfigError("Hair swings, and frames are chosen, in a performance; name one with --performance.")
    width, height = args.size
    camera = Camera.orbit(width, height, args.yaw, args.pitch, args.distance, args.fov)
    passes = tuple(dict.fromkeys((*args.passes, "rgb", "alpha")))
    fine = 1.0 if args.lod or args.coarse else FINAL_STRANDS
    options = RenderOptions(not args.no_refine, passes, args.lod, args.background, args.coarse, lighting, fine)
    files: dict[str, str] = {}
    seconds = 0.0
    with create_session(weights=args.weights, device=args.device, threads=args.threads, head=args.head) as session:
        avatar = session.open(args.avatar)
        hair, frames = hair_of(args, avatar), [controls]
        if played is not None:
            played = playable(played, avatar, args)
            frames = [together(controls, played.controls(number)) for number in range(played.frame_count)]
        first, last = args.frames or (0, len(frames) - 1)
        if first >= len(frames):
            raise ConfigError(f"The performance has {len(frames)} frames, from 0 on; there is no frame {first}.")
        wearing: Iterator[HairUse] = repeat(hair)
        if args.hair_swing is not None and played is not None:
            simulated = frames if args.hair_swing else frames[: last + 1]  # a bake holds all
            wearing = _swinging(session, avatar, hair, simulated, played.fps, args.hair_swing)
        for number, (posed, worn) in enumerate(zip(frames[: last + 1], wearing, strict=False)):
            if number < first:
                continue
            start = time.perf_counter()
            shown = Instance(avatar.id, posed, hair=worn, response=response, wrinkles=args.wrinkles)
            buffers = session.render([shown], camera, options)
            seconds += time.perf_counter() - start
            target = path if played is None else frame_path(path, number)
            written = write_buffers(target, buffers, args.passes, args.background is not None)
            files |= written if played is None else {f"{number}.{name}": file for name, file in written.items()}
            for file in written.values():
                args.console.line(f"Wrote {file}.")
    return {
        "files": files,
        "width": camera.width,
        "height": camera.height,
        "avatar": avatar.name,
        "weights": avatar.weights_name,
        "gaussians": avatar.gaussian_count,
        "refined": options.refine,
        "seconds": round(seconds, 4),
    }


def _light(args: argparse.Namespace) -> tuple[Lighting | None, Response | None]:
    """What `--light` says, and how the avatar takes it."""
    word, _, number = args.light[0].partition(":") if len(args.light) == 1 else ("", "", "")
    if word != PHOTO_WORD:
        lighting = lighting_of(args.light)
        return lighting, None if lighting is None else Response()
    from ..fitting.photo_light import MATT
    from ..fitting.result import photo_light

    if Path(args.avatar).suffix != EXTENSION or (not number.isdecimal() and number):
        raise ConfigError("--light photo, or photo:2 and so on, is for an avatar's file that was made from photos; name one.")
    light = photo_light(load_avatar(args.avatar), int(number or 1) - 1).lighting
    if light is None:
        raise ConfigError(f"{args.avatar} does not know the light of its photo; make it from the photo again.")
    return light, MATT


def _swinging(
    session: Session, avatar: AvatarInfo, hair: HairUse, frames: list[Controls], fps: float, bake: str
) -> Iterator[HairUse]:
    """What is worn in each frame; out of the file of a bake, or simulated and kept in it, where one is named."""
    if not bake:
        yield from swinging(session, avatar, hair, frames, fps)
        return
    groom = worn_groom(avatar, hair)
    if groom is None:
        raise ConfigError("The avatar wears no strands that could swing; choose some with --hair.")
    if not Path(bake).exists():
        moved = (use.swing for use in swinging(session, avatar, hair, frames, fps))
        write_bake(bake, (one for one in moved if one is not None), 0, fps)
    kept = SwingBake.read(bake)
    if len(kept.frames) != len(frames):
        raise ConfigError(f"{bake} holds {len(kept.frames)} frames, the performance has {len(frames)}; delete it to bake anew.")
    for number in range(len(frames)):
        yield replace(hair, swing=kept.at(number, len(groom)))


def write_buffers(path: Path, buffers: dict[str, np.ndarray], passes: tuple[str, ...], opaque: bool) -> dict[str, str]:
    """Write render buffers as files.

    Args:
        path: Main file.
        buffers: Of `Session.render`, with "rgb" and "alpha" and all of `passes`.
        passes: What else to write beside a PNG.
        opaque: The buffers have a background, so the picture has no alpha.

    Returns:
        What each file holds to its name.
    """
    alpha = np.ones_like(buffers["alpha"]) if opaque else buffers["alpha"]
    if path.suffix.lower() == ".npz":
        stream = io.BytesIO()
        np.savez_compressed(stream, **buffers)
        atomic_write_bytes(path, stream.getvalue())
        return {"all": str(path)}
    if path.suffix.lower() == ".exr":
        write_exr(path, _exr_channels(buffers, alpha, opaque))
        return {"all": str(path)}
    files = {"rgb": str(path)}
    write_png(path, quantize(_picture(buffers["rgb"], alpha, opaque)))
    for name in passes:
        if name == "rgb":
            continue
        buffer = buffers[name]
        file = path.with_suffix(f".{name}.npy" if name in _AS_NUMBERS else f".{name}.png")
        if name in _AS_NUMBERS:
            stream = io.BytesIO()
            np.save(stream, buffer[..., 0] if name == "depth" else buffer, allow_pickle=False)
            atomic_write_bytes(file, stream.getvalue())
        elif name == "raw":
            write_png(file, quantize(_picture(buffer, alpha, opaque)))
        elif name == "normal":
            write_png(file, quantize(0.5 + 0.5 * buffer, bits=16))
        else:
            write_png(file, quantize(buffer[..., :1], bits=16))
        files[name] = str(file)
    return files


def _picture(rgb: np.ndarray, alpha: np.ndarray, opaque: bool) -> np.ndarray:
    return rgb if opaque else straight_rgba(rgb, alpha)


def _exr_channels(buffers: dict[str, np.ndarray], alpha: np.ndarray, opaque: bool) -> dict[str, np.ndarray]:
    """Return OpenEXR channels under the names that compositors expect."""
    channels: dict[str, np.ndarray] = {}
    for name, buffer in buffers.items():
        if name in ("rgb", "raw"):
            linear = srgb_to_linear(buffer) if opaque else scene_linear_premultiplied(buffer, alpha)
            prefix = "" if name == "rgb" else "raw."
            channels |= {prefix + letter: linear[..., i] for i, letter in enumerate("RGBA"[: linear.shape[-1]])}
        elif name == "depth":
            channels["depth.Z"] = buffer[..., 0]
        elif name == "normal":
            channels |= {f"normal.{axis}": buffer[..., i] for i, axis in enumerate("XYZ")}
        elif name in ("diffuse", "specular"):
            channels |= {f"{name}.{letter}": buffer[..., i] for i, letter in enumerate("RGB")}
        elif name == "alpha":
            channels["alpha.A"] = buffer[..., 0]
        else:
            channels |= {f"{name}.{i:02d}": buffer[..., i] for i in range(buffer.shape[-1])}
    return channels


def _passes(text: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    unknown = [name for name in names if name not in PASS_NAMES]
    if unknown:
        raise argparse.ArgumentTypeError(f"there is no render pass {unknown[0]!r}; choose from {', '.join(PASS_NAMES)}")
    return names


def _range(text: str) -> tuple[int, int]:
    first, dash, last = text.partition("-")
    if not (first.isdecimal() and (last if dash else first).isdecimal() and int(last or first) >= int(first)):
        raise argparse.ArgumentTypeError(f"{text!r} is not a range of frames; write for example 0-99")
    return int(first), int(last or first)


def _color(text: str) -> tuple[float, float, float]:
    try:
        red, green, blue = (float(part) for part in text.split(","))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not a color; write for example 1,1,1") from error
    if not all(0.0 <= value <= 1.0 for value in (red, green, blue)):
        raise argparse.ArgumentTypeError(f"{text!r} is not a color of numbers from 0 to 1; write for example 1,1,1")
    return red, green, blue
