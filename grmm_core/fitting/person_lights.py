"""The lights of all photos of a person.

Of several photos the skin's colors are the mean, and the lights are found again by them. Photos do not count alike: the
harder a light is, the less of it twelve wide directions explain, and what is left would be taken for color and spoil the lights
of the other photos. So each counts by how even it leaves the skin (`doubts`), in shadow little, and one tone counts a little.

Used by `invert` and `pixel_stage`. Needs numpy only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.camera import Camera
from ..head import HeadModel
from ..light.posture import Posture
from ..light.relight import to_linear
from ..light.resting import Texels
from ..light.turning import turned_light
from ..model.layout import TexelLayout
from .photo_light import FEW, Light, PhotoHead, Seen, Shown, seen_skin
from .types import PhotoTrack
from .white_balance import cast

_ONE_TONE = 0.3  # that the skin is of one tone, beside 1 for the surest photo where it faces the camera
_SURE = 0.03  # doubt below which photos count alike
_MARK = 0.4  # of the logarithm: by so much colors of skin differ from its tone
_AGAIN = 2  # times that the lights of several photos are found again, by the colors that all of them show
_STILL = np.zeros((5, 3))  # pose at rest


def found_lights(
    head: HeadModel, layout: TexelLayout, tracks: Sequence[PhotoTrack],
    pictures: Sequence[tuple[Camera, np.ndarray, np.ndarray]],
) -> tuple[list[Light], np.ndarray, np.ndarray]:  # fmt: skip
    """Find the light of each photo of a person; the first gives the skin's tone.

    The person is the mesh that was tracked, without what a model has learned.

    Args:
        head: Head model.
        layout: Texels of the avatar.
        tracks: Photos.
        pictures: Of each its camera, colors and bare pixels as in `seen_skin`.

    Returns:
        The lights, their `PhotoHead.spread`, [P, N, 4] float32, and how uneven each leaves skin of one tone (`doubts`), [P].
    """
    heads = _Heads(head, layout)
    lights: list[Light] = []
    ratios: list[np.ndarray] = []
    every: list[tuple[Seen, PhotoHead | None]] = []
    tone = None
    for track, (camera, picture, inside) in zip(tracks, pictures, strict=True):
        shown = _tracked(head, track)
        seen = seen_skin(head, heads.texels, shown.posed, camera, picture, inside)
        colors, light, here = seen.colors[seen.weights > 0], Light.studio(), None
        if len(colors) >= FEW:
            middle = np.median(colors, 0)
            here = heads.photo(track, shown, middle)
            if "face" in head.regions:
                light = here.solve(seen, tone)
            else:  # what is light and what is color cannot be told
                level = np.maximum(np.asarray(to_linear(middle)), 1e-4)
                light = Light.studio(level if tone is None else tone, 1.0 if tone is None else level / tone)
            tone = light.tone
        lights.append(light)
        every.append((seen, here))
        ratios.append(heads.even(light, track, shown) if here is None else here.spread(light))
    several = [(seen, here) for seen, here in every if here is not None]
    if not several or "face" not in head.regions:
        return lights, np.stack(ratios), np.full(len(lights), _SURE)
    told = [index for index, (_, here) in enumerate(every) if here is not None]
    doubt = doubts(several, [ratios[index] for index in told])
    in_rig, middle = not any(light.known for light in lights), _middle(several[0], ratios[told[0]])
    for _ in range(_AGAIN if len(several) > 1 else 0):
        known = [ratios[index] for index in told]
        flat = mean_flat(several, known, doubt)
        for number, (index, (seen, here)) in enumerate(zip(told, several, strict=True)):
            if in_rig:
                lights[index] = _beside_others(several, known, doubt, number, lights[index])
            else:
                lights[index] = here.again(seen, lights[index], flat)
        # what all lights have in common stays as the first photo's alone is
        common = (middle / _middle(several[0], several[0][1].spread(lights[told[0]]))).astype(np.float32)
        for index, (_, here) in zip(told, several, strict=True):
            lights[index] = lights[index].scaled(common)
            ratios[index] = here.spread(lights[index])
    tint = cast(lights[told[0]].tone)
    for index, (_, here) in zip(told, several, strict=True):
        lights[index] = lights[index].scaled(tint)._replace(tone=lights[index].tone / tint)
        ratios[index] = here.spread(lights[index])
    every_doubt = np.full(len(lights), doubt.min())
    every_doubt[told] = doubt
    return lights, np.stack(ratios), every_doubt


def trust_in(doubt: np.ndarray) -> np.ndarray:
    """How much each photo tells of the colors beside the one whose light is known best, by `found_lights`, 0..1 [P]."""
    trust: np.ndarray = doubt.min() / doubt  # squared, too little would be left of folds that one photo shows
    return trust


def _beside_others(
    every: Sequence[tuple[Seen, PhotoHead]], ratios: Sequence[np.ndarray], doubt: np.ndarray, number: int, light: Light
) -> Light:
    """How strong the studio's light is in one photo by what the others show; arguments as of `mean_flat`."""
    others = [index for index in range(len(every)) if index != number]
    flat = mean_flat([every[index] for index in others], [ratios[index] for index in others], doubt[others])
    shown = np.stack([every[index][0].weights for index in others]).max(0) > _ONE_TONE
    return every[number][1].exposed(every[number][0], light, flat, shown)


def _middle(one: tuple[Seen, PhotoHead], ratio: np.ndarray) -> np.ndarray:
    """Median of a photo's light on the skin that it reaches, by its `PhotoHead.spread`, [3]."""
    seen, here = one
    light = ratio[:, :3] / ratio[:, 3:]
    middle: np.ndarray = np.median(light[here.lit(seen, light)], 0)
    return middle


def doubts(every: Sequence[tuple[Seen, PhotoHead]], ratios: Sequence[np.ndarray]) -> np.ndarray:
    """How uneven each photo's light, as found, leaves skin of one tone: deviation of the logarithm, [P].

    That is the median deviation. It does not see a lamp at the side that the found light has missed, since that shines on less
    than half of what is seen, and the photo's colors would spoil those of others: of several photos what deviates by more than
    skin does (`_MARK`) counts besides.

    Arguments as of `mean_flat`.
    """
    found = []
    for (seen, here), ratio in zip(every, ratios, strict=True):
        counted = (seen.weights > 0) & here.told
        off = np.log(np.maximum(_flat(seen, ratio) / here.one_tone, 1e-3))[counted].mean(1)
        deviation = np.abs(off - np.median(off))
        missed = (deviation - _MARK).clip(0.0) if len(every) > 1 else np.zeros(1)
        found.append(float(np.hypot(1.48 * np.median(deviation), np.sqrt(np.mean(missed**2)))) if counted.any() else np.inf)
    return np.maximum(found, _SURE)


def mean_flat(every: Sequence[tuple[Seen, PhotoHead]], ratios: Sequence[np.ndarray], doubt: np.ndarray) -> np.ndarray:
    """Colors of the texels in the studio's rig, the mean over the photos and skin of one tone, linear RGB, [N, 3].

    Args:
        every: What each photo shows, and its head.
        ratios: `PhotoHead.spread` of each photo's light.
        doubt: Of each photo (`doubts`), [P].
    """
    surest = float(doubt.min())
    total, weight = np.zeros((len(ratios[0]), 3)), np.zeros((len(ratios[0]), 1))
    for (seen, here), ratio, own in zip(every, ratios, doubt, strict=True):
        light = (ratio[:, :3] / ratio[:, 3:]).min(1)
        counted = (seen.weights > 0) & here.told
        middle = np.median(light[counted]) if counted.any() else 1.0
        told = (seen.weights * (surest / own) ** 2 * np.clip(light / middle, 0.0, 1.0))[:, None]
        total += told * _flat(seen, ratio)
        weight += told
    even, told = every[0][1].one_tone, every[0][1].told & (weight[:, 0] > _ONE_TONE)
    if not told.any():
        return even * (total.sum(0) / (even * weight).sum(0).clip(1e-6))
    tone = np.median(total[told] / weight[told] / even[told], 0)
    mean: np.ndarray = (total + _ONE_TONE * tone * even) / (weight + _ONE_TONE)
    return mean


def _flat(seen: Seen, ratio: np.ndarray) -> np.ndarray:
    """Colors of the texels of a photo in the studio's rig, by its `PhotoHead.spread`, linear RGB, [N, 3]."""
    linear = np.asarray(to_linear(np.asarray(seen.colors, np.float64)))
    return linear / np.maximum(ratio[:, :3] / ratio[:, 3:], 1e-2)


def kept_lights(
    head: HeadModel, layout: TexelLayout, tracks: Sequence[PhotoTrack], lights: Sequence[Light], shown: Sequence[Shown],
    colors: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """`PhotoHead.spread` of lights that were found before as a session has them, [P, N, 4] float32.

    Args:
        head: Head model.
        layout: Texels of the avatar.
        tracks: Photos.
        lights: Of each.
        shown: The person in each, with what the model has learned.
        colors: Of the texels at rest, display sRGB, [N, 3].
    """
    heads = _Heads(head, layout)
    ratios = [
        heads.photo(track, here, colors).spread(light) if light.known else heads.even(light, track, here)
        for track, here, light in zip(tracks, shown, lights, strict=True)
    ]
    return np.stack(ratios)


def _tracked(head: HeadModel, track: PhotoTrack) -> Shown:
    """A person as tracked."""
    rest = head.vertices(track.shape, np.zeros(1), _STILL)
    return Shown(rest, head.vertices(track.shape, track.expression, head.pose_of(track.expression, track.pose)))


class _Heads:
    """What the photos of an avatar's person have in common."""

    def __init__(self, head: HeadModel, layout: TexelLayout) -> None:
        self._head, self.texels = head, Texels.of(head, layout.face, layout.barycentric)
        self._lying = self.texels.shadows(head, layout.uv, layout.grid, layout.texel)

    def photo(self, track: PhotoTrack, shown: Shown, colors: np.ndarray) -> PhotoHead:
        """What light does in a photo; colors as of `PhotoHead`."""
        pose = self._head.pose_of(track.expression, track.pose)
        turn = Posture(self._head, track.shape, _STILL, pose, shown.rest).turn
        turned = self._turned(track, shown)
        return PhotoHead(self._head, self.texels, shown, track.camera.position, colors, turned, turn, self._lying)

    def even(self, light: Light, track: PhotoTrack, shown: Shown) -> np.ndarray:
        """`PhotoHead.spread` of the studio's light, stronger or weaker."""
        turned = self._turned(track, shown)
        lit = turned * light.level * self.texels.factor(light.local, light.fine_factor)
        return np.concatenate([lit, np.ones_like(turned)], 1)

    def _turned(self, track: PhotoTrack, shown: Shown) -> np.ndarray:
        """What the turn of a photo's neck makes of the studio's light, [N, 1] float32."""
        light = turned_light(self._head, self.texels, shown.posed, self._head.pose_of(track.expression, track.pose))
        return np.ones((len(self.texels.face), 1), np.float32) if light is None else light
