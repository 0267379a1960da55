"""Say what each pixel of a tracked photo shows: skin, hair, beard, glasses, a hat, clothes, what stands before the face.

The head that was tracked is drawn without hair beside the picture, so that the network only decides what a bald mesh cannot
know: where hair, cloth and things begin. It works at 128 x 128 pixels, 3.5 mm each; the guided filter of `person` brings
edges to the picture's own. Trained on synthetic pictures only (`tools/photo_parser`). Imports torch.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Protocol

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ..geometry.camera import Camera
from ..geometry.zbuffer import EMPTY, triangle_depth
from ..head.head_model import HeadModel
from ..pictures.color import srgb_to_linear
from .beard import Place, beard_on_chin
from .parser_network import load_parser
from .person import guided_filter
from .widening import widened

SIZE = 128
REACH = 0.2  # metres from the head's origin that are 1 in the channels of place
EDGE_RADIUS, EDGE_EPSILON = 1.0 / 96.0, 4e-4  # of the guided filter: share of the side, squared intensity
LEAST_GLASSES, LEAST_THING = 0.008, 0.006  # of the person's pixels; smaller finds are dark eyes, buttons, shadows
# of the eyes' distance: how far above or below them glasses cross the nose, and where; the share that they then have there:
# 44 of 45 drawn sunglasses have more, made-up eyes in blue light 0.58 (frames of clear glasses are found by outlines as well)
BRIDGE_HEIGHT, BRIDGE, BRIDGED, BROW_HEIGHT = 0.4, (0.3, 0.7), 0.6, 0.2  # the last: brows above eyes, likewise
# metres beside the middle of the lips and above them, and the share there of a moustache; upper lips without have up to 0.34
UPPER_LIP, LEAST_MOUSTACHE = ((-0.016, 0.016), (0.003, 0.012)), 0.5
# of hat and hair together, where a smaller part is hair in another light; of the picture, where hats have 0.046 and more and
# short black hair 0.012
LEAST_HAT, SMALL_HAT = 0.15, 0.02
# parts of the mesh around which hair is surely the person's, so many of the network's pixels around; how much likelier a color
# must be on skin than in that hair to be bare skin beyond
ON_HEAD, BESIDE_HEAD, BARE = ("eyes", "brows", "ears", "scalp", "skin"), 14, 4.0
AROUND_EYES = 4  # of the network's pixels, within which eyes, brows and mouth are not asked whether they are hair
# of the face: larger pieces of skin that hair parts from eyes and mouth are skin; more hair than one part in so many parts them
MOST_APART, PASSED = 0.12, 3.0
# one label or another by color: steps of each channel, share from which a label is sure, share of the picture that must be, a
# color's likelihood that is none, how much a color can say, and the share of either from which on the other is not asked
COLORS, SURE, LEAST_SURE, LEAST_LIKELY, STRONGEST, DOUBT = 24, 0.8, 0.002, 1e-6, 20.0, 0.08
PERSON = ("skin", "hair", "brows", "beard", "eyes", "lips", "mouth", "ears", "neck")
# share of a pixel from which on its color is a thing's, how much likelier than the person's a color must be to be one, and
# how far around it that is asked, as a share of the side; beyond, the person's colors are read; how much of eyes and mouth no
# thing hides
THING, FOREIGN, AROUND_THING, MOST_FEATURES = 0.3, 8.0, 0.12, 0.75
MESH_PARTS = {
    "eyes": ("left_eyeball", "right_eyeball"), "mouth": ("mouth_interior", "upper_teeth", "lower_teeth", "tongue"),
    "lips": ("lips",), "brows": ("brows",), "ears": ("ears",), "scalp": ("scalp",), "neck": ("neck",), "skin": (),
}  # fmt: skip
"""Parts of the mesh and their regions, what counts first above; the last has the rest."""
INPUTS = 3 + 2 + len(MESH_PARTS) + 2


@dataclass(frozen=True, eq=False)
class PhotoParts:
    """How much each pixel of a working picture shows of what, 0..1, float32, [H, W] each; they sum to 1.

    Attributes:
        background: Nothing of the person.
        skin: Of the face and of a bald head.
        hair: Of the scalp.
        brows, beard, eyes, lips, ears: As they say.
        mouth: Teeth, tongue and what is behind the lips.
        glasses: Frames and dark lenses; what clear lenses show is what it is.
        hat: Whatever covers the scalp.
        neck: With bare chest and shoulders.
        clothes: As it says.
        other: Things and hands in front of the person.
    """

    background: np.ndarray
    skin: np.ndarray
    hair: np.ndarray
    brows: np.ndarray
    beard: np.ndarray
    eyes: np.ndarray
    lips: np.ndarray
    mouth: np.ndarray
    glasses: np.ndarray
    hat: np.ndarray
    ears: np.ndarray
    neck: np.ndarray
    clothes: np.ndarray
    other: np.ndarray


class Tracked(Protocol):
    """What is used of a `fitting.types.PhotoTrack`."""

    image: np.ndarray
    mask: np.ndarray
    valid: np.ndarray
    camera: Camera
    shape: np.ndarray
    expression: np.ndarray
    pose: np.ndarray
    labels: np.ndarray | None


LABELS = tuple(item.name for item in fields(PhotoParts))


@lru_cache(maxsize=8)
def parse(track: Tracked, head: HeadModel) -> PhotoParts:
    """Label the working picture of a tracked photo, or take the labels that are known.

    The last few answers are kept, for a fit asks at every resolution.

    Args:
        track: The photo.
        head: The model that it was tracked with.
    """
    if track.labels is not None:
        return PhotoParts(*track.labels)
    planes = np.concatenate([track.image, track.mask[..., None], track.valid[..., None]], -1)
    pixels = torch.from_numpy(np.ascontiguousarray(planes, np.float32)).permute(2, 0, 1)[None]
    small = functional.interpolate(pixels, (SIZE, SIZE), mode="bilinear", antialias=True, align_corners=False)
    vertices = head.vertices(track.shape, track.expression, head.pose_of(track.expression, track.pose))
    mesh = mesh_channels(head, vertices, track.camera.resized(SIZE, SIZE))
    with torch.no_grad():
        logits = load_parser(INPUTS, len(LABELS))(network_input(small, torch.from_numpy(mesh)[None]))
        shares = _believed(logits.softmax(1), mesh, small[0, :3])
        shares = functional.interpolate(shares, pixels.shape[2:], mode="bilinear", align_corners=False)
        radius = max(1, round(max(pixels.shape[2:]) * EDGE_RADIUS))
        sharp = guided_filter(pixels[:, :3].mean(1, keepdim=True), shares[0, :, None], radius, EDGE_EPSILON)[:, 0].clamp_min(
            0.0
        )
        sharp *= pixels[0, 4:5]  # beyond the photo's edge there is background
        sharp[0] += 1.0 - pixels[0, 4]
        sharp = sharp / sharp.sum(0, keepdim=True).clamp_min(1e-6)
        eyes = torch.from_numpy(mesh[[tuple(MESH_PARTS).index(name) for name in ("eyes", "mouth")]]).amax(0)[None, None]
        features = widened(eyes[0], AROUND_EYES)[None]
        features = functional.interpolate(features, pixels.shape[2:])[0, 0]
        divided = _by_color(sharp, pixels[0, :3], ("hat", "hair"), torch.ones_like(features))
        divided = _by_color(divided, pixels[0, :3], ("hair", "skin"), 1.0 - features)
        divided = _things(divided, pixels[0, :3], features)
        head_alone = torch.from_numpy(mesh[[tuple(MESH_PARTS).index(name) for name in ON_HEAD]]).amax(0)[None]
        near = functional.interpolate(widened(head_alone, BESIDE_HEAD)[None], pixels.shape[2:])[0, 0]
        divided = _bare(divided, pixels[0, :3], near)
    return PhotoParts(*_enclosed(divided, eyes).numpy())


def _enclosed(shares: Tensor, features: Tensor) -> Tensor:
    """Give small pieces of skin that hair parts from the face, as glints in a fringe, to the hair.

    Args:
        shares: Of the labels, [L, H, W].
        features: 1 at eyes and mouth, [1, 1, S, S].
    """
    hair, skin = (LABELS.index(name) for name in ("hair", "skin"))
    small = functional.interpolate(shares[None], (SIZE, SIZE), mode="area")[0]
    face = (small[skin] + small[LABELS.index("brows")] > PASSED * small[hair])[None, None].float()
    reached = features
    for _ in range(SIZE):  # from eyes and mouth over everything that is no hair
        reached = torch.minimum(functional.max_pool2d(reached, 3, 1, 1), torch.maximum(face, features))
    apart = 1.0 - functional.max_pool2d(reached, 3, 1, 1)
    if float((apart * small[skin]).sum()) > MOST_APART * float(small[skin].sum()):
        return shares
    apart = functional.interpolate(apart, shares.shape[1:], mode="bilinear")[0, 0]
    divided = shares.clone()
    divided[hair], divided[skin] = shares[hair] + apart * shares[skin], (1.0 - apart) * shares[skin]
    return divided


def _by_color(shares: Tensor, picture: Tensor, names: tuple[str, str], asked: Tensor) -> Tensor:
    """Divide what has one of two labels, the network does not know which, by the colors of what surely has either.

    Args:
        shares: Of the labels, [L, H, W].
        picture: [3, H, W].
        names: Of the two.
        asked: 0 where colors are neither's, as of eyes, brows and mouth beside hair and skin, [H, W].
    """
    labels = [LABELS.index(name) for name in names]
    both = shares[labels].sum(0)
    sure = [shares[label] * (shares[label] > SURE) for label in labels]
    likely = [_likelihood_around(picture, part, _quarters(sure[1])) for part in sure]
    if likely[0] is None or likely[1] is None:
        return shares
    evidence = (likely[0] / likely[1]).log()[None, None]
    ratio = functional.avg_pool2d(evidence, 5, 1, 2, count_include_pad=False)[0, 0].exp().clamp(1.0 / STRONGEST, STRONGEST)
    told = shares[labels[0]] / both.clamp_min(1e-6)
    doubtful = (told > DOUBT) & (told < 1.0 - DOUBT) & (asked > 0.5)
    told = torch.where(doubtful, told * ratio / (told * ratio + 1.0 - told), told)
    divided = shares.clone()
    divided[labels[0]], divided[labels[1]] = both * told, both * (1.0 - told)
    return divided


def _quarters(shares: Tensor) -> Tensor:
    """Weights of the four quarters of what has shares [H, W], sums of 1 that go over into one another, [4, H, W]."""
    ramps = []
    for axis in (0, 1):
        there = torch.nonzero(shares.amax(1 - axis) > 0.5)[:, 0].float()
        first, last = (float(there.min()), float(there.max())) if len(there) else (0.0, 1.0)
        ramp = ((torch.arange(shares.shape[axis]) - first) / max(last - first, 1.0)).clamp(0.0, 1.0)
        ramps.append(torch.stack([1.0 - ramp, ramp]))
    return (ramps[0][:, None, :, None] * ramps[1][None, :, None, :]).flatten(0, 1)


def _likelihood_around(picture: Tensor, sure: Tensor, quarters: Tensor) -> Tensor | None:
    """`_likelihood` by the colors around: away from a lamp at the side skin has those that hair has in its light."""
    whole = _likelihood(picture, sure)
    if whole is None:
        return None
    found = [_likelihood(picture, sure * quarter) for quarter in quarters]
    return sum(quarter * (whole if own is None else own) for quarter, own in zip(quarters, found, strict=True))


def _likelihood(picture: Tensor, sure: Tensor) -> Tensor | None:
    """How likely each pixel's color [3, H, W] is where something surely is, [H, W] likewise; None where it is nowhere."""
    if float(sure.sum()) < LEAST_SURE * sure.numel():
        return None
    smooth = functional.avg_pool2d(picture[None], 3, 1, 1, count_include_pad=False)[0]
    cell = (smooth.clamp(0, 1) * (COLORS - 1)).round().long()
    number = ((cell[0] * COLORS + cell[1]) * COLORS + cell[2]).flatten()
    counted = torch.bincount(number, sure.flatten(), COLORS**3).reshape(1, 1, COLORS, COLORS, COLORS)
    for _ in range(2):
        counted = functional.avg_pool3d(counted, 3, 1, 1)
    return (counted.flatten() / counted.sum())[number].reshape(sure.shape) + LEAST_LIKELY


def _things(shares: Tensor, picture: Tensor, features: Tensor) -> Tensor:
    """Give what has the color of a thing in front of the person, and hardly any of the person has, to the thing.

    Around it the network sees neither skin nor hair, and calls what the mesh has there.

    Args:
        shares: Of the labels, [L, H, W].
        picture: [3, H, W].
        features: Around eyes and mouth, 0..1, [H, W]. What would take most of them is no thing, for the face was found.
    """
    other, person = LABELS.index("other"), [LABELS.index(name) for name in PERSON]
    own = shares[person].sum(0)
    thing = _likelihood(picture, shares[other] * (shares[other] > THING))
    reach = round(AROUND_THING * max(own.shape))
    around = widened((shares[other] > THING)[None].float(), reach)[0]
    body = _likelihood(picture, own * (own > SURE) * (1.0 - around))
    if thing is None or body is None:
        return shares
    taken = shares.clone()
    foreign = functional.avg_pool2d((thing > FOREIGN * body)[None, None].float(), 5, 1, 2)[0, 0].round() * around
    if (foreign * features).sum() > MOST_FEATURES * features.sum():
        return shares
    taken[other] += foreign * own
    taken[person] *= 1.0 - foreign
    return taken


def _bare(shares: Tensor, picture: Tensor, near: Tensor) -> Tensor:
    """Give what is far from the head and has the colors of the person's skin rather than those of the hair to the neck: arms.

    Args:
        shares: Of the labels, [L, H, W].
        picture: [3, H, W].
        near: 1 on the head and beside it, [H, W]; hair there tells the colors of hair.
    """
    hair, skin, neck = (LABELS.index(name) for name in ("hair", "skin", "neck"))
    own, bare = shares[hair], shares[skin] + shares[neck]
    likely = [_likelihood(picture, part) for part in (own * (own > SURE) * near, bare * (bare > SURE))]
    if likely[0] is None or likely[1] is None:
        return shares
    foreign = (likely[1] > BARE * likely[0])[None, None].float()
    other = functional.avg_pool2d(foreign, 9, 1, 4, count_include_pad=False)[0, 0].round() * (1.0 - near)
    given = shares.clone()
    given[hair], given[neck] = own * (1.0 - other), shares[neck] + own * other
    return given


def _believed(shares: Tensor, mesh: np.ndarray, picture: Tensor) -> Tensor:
    """Give what is too small to be glasses, a hat or a thing, and glasses without a bridge, to the other labels.

    Args:
        shares: Of the labels, [1, L, S, S].
        mesh: `mesh_channels`.
        picture: Display sRGB, [3, S, S].
    """
    seen = (shares > 0.5).sum((0, 2, 3)).double()
    glasses, hat, other, hair, background = (LABELS.index(name) for name in ("glasses", "hat", "other", "hair", "background"))
    person = shares[0, 0].numel() - seen[background]
    kept = torch.ones(len(LABELS))
    kept[glasses] = float(seen[glasses] > LEAST_GLASSES * person and bridged(shares[0, glasses].numpy(), mesh))
    kept[other] = float(seen[other] > LEAST_THING * person)
    kept[hat] = float(seen[hat] > max(LEAST_HAT * float(seen[hat] + seen[hair]), SMALL_HAT * shares[0, 0].numel()))
    shares = _beard(shares, mesh, srgb_to_linear(picture.numpy()).mean(0)) * kept[:, None, None] + 1e-6
    return shares / shares.sum(1, keepdim=True)


def _beard(shares: Tensor, mesh: np.ndarray, light: np.ndarray) -> Tensor:
    """Believe a beard on the chin or above the lip: one below the chin alone is its shade, and goes to the skin.

    Where there is one on the chin, what looks like a thing before chin and throat is the beard, and so is dark skin.

    Args:
        shares: Of the labels, [1, L, S, S].
        mesh: `mesh_channels`.
        light: Of the picture, linear, [S, S].
    """
    names, up, across = tuple(MESH_PARTS), mesh[-2] * REACH, mesh[-1] * REACH
    beard, other, skin, neck = (LABELS.index(name) for name in ("beard", "other", "skin", "neck"))
    lips, on_skin, on_neck = (mesh[names.index(name)] > 0.5 for name in ("lips", "skin", "neck"))
    if not lips.any():
        return shares
    place = Place(across - across[lips].mean(), up[lips].min() - up, up - up[lips].max(), on_skin, on_neck)
    share, divided = shares[0, beard].numpy(), shares.clone()
    found, lip = beard_on_chin(share, place, light), place.zone(*UPPER_LIP, above=True)
    if found is not None:
        around = torch.from_numpy(np.float32(found.around))
        for label, taken in ((other, around), (skin, torch.from_numpy(found.dark))):
            divided[0, beard] += taken * shares[0, label]
            divided[0, label] -= taken * shares[0, label]
    elif not lip.any() or share[lip].mean() < LEAST_MOUSTACHE:
        on_throat = torch.from_numpy(mesh[names.index("neck")])
        divided[0, skin] += (1.0 - on_throat) * shares[0, beard]
        divided[0, neck] += on_throat * shares[0, beard]
        divided[0, beard] = 0.0
    return divided


def bridged(glasses: np.ndarray, mesh: np.ndarray) -> bool:
    """Whether what may be glasses runs over the nose from eye to eye: sockets in deep shade do not.

    Args:
        glasses: Their share of each pixel, [S, S].
        mesh: `mesh_channels`.
    """
    up, across = mesh[-2], mesh[-1]
    place = _eyes_in(mesh)
    if place is None:  # of a face from the side
        return True
    left, right, level = place
    zone = np.abs(up - level) < BRIDGE_HEIGHT * (right - left)
    share = (across - left) / (right - left)
    steps = [zone & (share >= low) & (share < low + 0.1) for low in np.arange(*BRIDGE, 0.1)]
    return all(float(glasses[step].max()) > BRIDGED for step in steps if step.any())


def _eyes_in(mesh: np.ndarray) -> tuple[float, float, float] | None:
    """Where both eyes are sideways, and how high, in the units of `mesh_channels`; None where only one side is seen."""
    up, across = mesh[-2], mesh[-1]
    for name, above in (("eyes", 0.0), ("brows", BROW_HEIGHT)):  # of closed eyes nothing is seen
        part = mesh[tuple(MESH_PARTS).index(name)] > 0.5
        middle = float(across[part].mean()) if part.any() else 0.0
        sides = [part & (across < middle), part & (across >= middle)]
        if all(side.any() for side in sides):
            left, right = (float(across[side].mean()) for side in sides)
            return left, right, float(up[part].mean()) - above * (right - left)
    return None


def network_input(picture: Tensor, mesh: Tensor) -> Tensor:
    """Join what the network sees.

    Args:
        picture: Display sRGB, mask of the person, validity, 0..1, [B, 5, S, S].
        mesh: `mesh_channels`, [B, M, S, S].

    Returns:
        [B, `INPUTS`, S, S].
    """
    return torch.cat([picture * 2.0 - 1.0, mesh], 1)


def mesh_channels(head: HeadModel, vertices: np.ndarray, camera: Camera) -> np.ndarray:
    """The bald head beside a picture: one plane for each of `MESH_PARTS`, place up and across the head; float32 [M, S, S]."""
    parts = part_map(head, vertices, camera)[0]
    middle, top = camera.project(np.array([[0.0, 0.0, 0.0], [0.0, 0.1, 0.0]]))[1]
    up = (top - middle) / max(float(np.linalg.norm(top - middle)), 1e-6)
    depth = float(camera.world_to_camera[2, 3])
    unit = REACH * camera.fx / (1.0 if camera.orthographic else max(depth, 1e-3))
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    x, y = (columns - middle[0]) / unit, (rows - middle[1]) / unit
    places = [x * up[0] + y * up[1], y * up[0] - x * up[1]]
    return np.stack([*(parts == number for number in range(len(MESH_PARTS))), *places]).astype(np.float32)


def part_map(head: HeadModel, vertices: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Number of the nearest of `MESH_PARTS` at each pixel, -1 for none, and its depth in metres; [H, W] each."""
    triangles = np.asarray(vertices, np.float64)[head.faces]
    owner = face_parts(head)
    depths = np.stack([triangle_depth(triangles[owner == number], camera) for number in range(len(MESH_PARTS))])
    nearest = depths.min(0)
    return np.where(nearest < EMPTY, depths.argmin(0), -1), nearest


def face_parts(head: HeadModel) -> np.ndarray:
    """Number of the part that each triangle of a head belongs to, by most of its corners, [F]."""
    owner = np.full(len(head.faces), len(MESH_PARTS) - 1)
    for number, regions in reversed(list(enumerate(MESH_PARTS.values()))):
        members = [head.regions[name] for name in regions if name in head.regions]
        inside = np.isin(head.faces, np.concatenate([np.zeros(0, int), *members]))
        owner[inside.sum(1) >= 2] = number
    return owner
