"""The light of a photo, apart from the person's flat colors: what is seen is flat colors x light, as a session lights avatars.

Skin of one person is taken as one tone with marks on it; what varies smoothly and with the normals is light. The light is that
of surroundings (nine coefficients a color, Ramamoorthi and Hanrahan 2001) and of a few directions with shadows, none of which
may take light away, found by robust least squares; what it does not explain, highlights too, stays in the flat colors. Tone and
light are known as a product only: in the light of the first photo the median of the seen skin is as in the studio's rig.

Used by `person_lights`, `invert` and `result`. Needs numpy only.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from ..geometry.camera import Camera
from ..geometry.zbuffer import triangle_depth
from ..head import HeadModel
from ..light.bounce import nearest_points
from ..light.lamps import STUDIO, Lighting, Sun
from ..light.materials import materials_of
from ..light.relight import to_linear
from ..light.resting import RestLight, Texels, casters_of, even_mouth, mouth_rows
from ..light.shading import Learned, Response, reached, relative, shade, straight
from ..light.shadows import Receivers, maps_of
from ..light.surroundings import TERMS, Surroundings, sphere
from ..light.texel_shadows import TexelShadows
from ..light.transfer import vertex_normals
from ..pictures.sampling import bilinear
from .chin import below_chin

SUNS = tuple(Sun(direction=tuple(d), angle=1.0) for d in sphere(24)[0] if d[2] > -0.3 and d[1] > -0.5)
"""Directions that light may come from, in head axes; as wide as soft boxes and windows."""
FINE_STEP, FINE_MOST = 0.02, 127  # of `Light.fine`: as many steps as a byte has
_NO_LOCAL = np.zeros((0, 3), np.float32)
MATT = Response(gloss=0.0, even_mouth=True, rig_at_rest=True)
"""How an avatar takes the light of its photo, whose highlights are in its colors."""
_EVEN = 0.05  # of the weight of what is seen: that light is even all over the skin, for what the photo does not show
_TINT = 0.1  # of the mean square: keeps the light's color one
_RIDGE = 0.1  # likewise: keeps lights small that the face hardly shows
# median deviation of the logarithm from skin of one tone in the rig, below which a photo's light is taken for the rig's: people
# of the studio have 0.03 to 0.06, real photos 0.17 and more
_AS_RIG = 0.08
_ROUNDS, _CUT = 6, 5.0  # of robust weights
_KNOWN = 0.2  # of `_EVEN`, `_TINT` and `_RIDGE` where other photos tell the colors
_LIT, _BRIGHT = 0.5, 0.9  # of the quantile of a light's strength: skin that is as light as that is not in shade
_NOT_SKIN = ("lips", "lids", "brows", "lashes", "mouth_interior")
# how much more skin below the chin counts while a photo stands alone: it shows little of it, slantwise, and that little tells
# how deep the chin's shadow is; where other photos tell the colors, each texel counts as it is seen
_UNDER = 12.0
FACING = 0.25  # cosine between normal and view from which skin tells its color
_BEHIND = 0.004  # metres behind the mesh's depth that still are its surface
_DARK = 0.004  # linear color of a texel below which it tells no light
FEW = 60  # texels: less skin tells no light


class Light(NamedTuple):
    """The light of one photo.

    Attributes:
        suns: Linear RGB of each of `SUNS`, [L, 3] W/m2.
        around: Coefficients of the surroundings' radiance in head axes, [9, 3].
        tone: Of the skin in the studio's rig, linear RGB, [3].
        level: Of the studio's rig, where neither suns nor surroundings could be found, [3].
        local: As `Lighting.local`.
        fine: Logarithm of `Lighting.fine` in steps of `FINE_STEP`, whole numbers up to `FINE_MOST`, so that a file holds them
            in a byte each.
    """

    suns: np.ndarray
    around: np.ndarray
    tone: np.ndarray
    level: np.ndarray
    local: np.ndarray = _NO_LOCAL
    fine: np.ndarray = _NO_LOCAL

    @staticmethod
    def studio(tone: np.ndarray | float = 1.0, level: np.ndarray | float = 1.0) -> Light:
        """The studio's light, stronger or weaker."""
        dark = np.zeros((len(SUNS), 3), np.float32), np.zeros((TERMS, 3), np.float32)
        return Light(*dark, *(np.full(3, value, np.float32) for value in (tone, level)))

    def scaled(self, factor: np.ndarray) -> Light:
        """Stronger by a factor a color, [3]."""
        if not self.known:
            return self._replace(level=self.level * factor)
        return self._replace(suns=self.suns * factor, around=self.around * factor)

    @property
    def known(self) -> bool:
        """Whether it was found."""
        return bool(np.any(self.suns) or np.any(self.around))

    @property
    def fine_factor(self) -> np.ndarray:
        """`Lighting.fine`."""
        factor: np.ndarray = np.exp(FINE_STEP * self.fine.clip(-FINE_MOST, FINE_MOST)).astype(np.float32)
        return factor

    @property
    def lighting(self) -> Lighting | None:
        """As a session takes it, head axes; None is the studio's."""
        if not self.known:
            rig = STUDIO.scaled(tuple(self.level))
            usual = np.all(self.level == 1.0) and not len(self.local) and not len(self.fine)
            return None if usual else dataclasses.replace(rig, local=self.local, fine=self.fine_factor)
        lit = (dataclasses.replace(sun, color=tuple(color)) for color, sun in zip(self.suns, SUNS, strict=True) if color.any())
        return Lighting(tuple(lit), Surroundings(np.asarray(self.around, np.float64)), local=self.local, fine=self.fine_factor)


class Seen(NamedTuple):
    """What a photo shows of a head, mostly of its skin.

    Attributes:
        colors: Of texels, display sRGB, [N, 3].
        weights: How much each counts, 0 where it is no skin or is not seen, [N].
    """

    colors: np.ndarray
    weights: np.ndarray

    def of_skin(self, head: HeadModel, texels: Texels) -> Seen:
        """Bare skin alone."""
        return self._replace(weights=self.weights * _skin(head)[texels.corners].all(1))


class Shown(NamedTuple):
    """A person's mesh as a photo shows it.

    Attributes:
        rest: Vertices at rest, [V, 3] metres.
        posed: As in the photo, likewise.
    """

    rest: np.ndarray
    posed: np.ndarray


class PhotoHead:
    """What light does on a head as a photo shows it.

    Args:
        head: Head model.
        texels: Of the avatar.
        shown: The person.
        eye: Place of the camera, [3].
        colors: Of the texels in the studio's light, or of all skin, display sRGB, [N, 3] or [3].
        turned: What the turn of the neck makes of the studio's light (`light.turning.turned_light`), [N, 1].
        turn: From the axes of the head at rest to those of the posed one (`light.posture.Posture`), [3, 3]; None: they are the
            same.
        lying: How the texels lie where these are all of an avatar, as sessions look for shadows by it.

    Attributes:
        told: Texels of skin that light is found by, [N] bool.
        one_tone: Skin of one tone in the studio's rig: the trained colors carry its shade below brows, nose and chin, [N, 3].
    """

    def __init__(
        self, head: HeadModel, texels: Texels, shown: Shown, eye: np.ndarray, colors: np.ndarray,
        turned: np.ndarray | float = 1.0, turn: np.ndarray | None = None, lying: TexelShadows | None = None,
    ) -> None:  # fmt: skip
        rest, posed = (np.asarray(vertices, np.float64) for vertices in shown)
        self._materials, every = materials_of(head, *texels[:2]), (len(texels.face), 3)
        self._rest = RestLight.of(head, texels, self._materials, rest, np.broadcast_to(colors, every), lying)
        self._head, self._texels, self._eye = head, texels, eye
        self._turned = np.broadcast_to(turned, (len(texels.face), 1))
        self._receivers = texels.receivers(posed, vertex_normals(posed, head.faces))
        self._turn = np.eye(3) if turn is None else turn
        self._at_vertices = nearest_points(texels.corners, texels.barycentric, len(rest))
        casters = casters_of(head, posed)
        maps = (maps_of(sun, self._receivers, casters) for sun in SUNS)
        if lying is None:
            self._seen = np.stack([one.seen(self._receivers) for one in maps])
        else:
            self._seen = np.stack([lying.all_seen(one, self._receivers, posed) for one in maps])
        skin = _skin(head)[texels.corners].all(1)
        self.told = skin & (self._rest.rig > reached(self._rest.rig).min(0)).all(1)
        self.one_tone = self._rest.rig / np.median(self._rest.rig[self.told], 0)
        self._telling = 1.0 + _UNDER * texels.at(below_chin(head)[:, None])[:, 0]

    def ratio(self, light: Light) -> np.ndarray:
        """Irradiance relative to the rig's at the texels, [N, 3] float32."""
        premultiplied = self.spread(light)
        return premultiplied[:, :3] / premultiplied[:, 3:]

    def spread(self, light: Light) -> np.ndarray:
        """`ratio` times how much each texel counts at a pixel (`light.shading.Arrived.front`), and that, [N, 4] float32."""
        if not light.known:
            even = self._turned * light.level * self._texels.factor(light.local, light.fine_factor)
            return np.concatenate([even, np.ones_like(self._turned)], 1).astype(np.float32)
        suns = tuple(dataclasses.replace(sun, color=tuple(color)) for color, sun in zip(light.suns, SUNS, strict=True))
        around = Surroundings(np.asarray(light.around, np.float64)).turned(self._turn.T).coefficients
        rest, corners = self._rest, self._texels.corners
        scene = shade(suns, self._receivers, self._seen, self._materials, rest.transfer, self._eye, around, MATT, self._turn)
        bounced = rest.exchange.bounced(scene.irradiance[self._at_vertices], rest.albedo)
        learned = Learned(rest.rig, np.zeros_like(rest.rig))
        found = relative(scene, bounced, corners, self._texels.barycentric, learned, 0.0)[:, [0, 1, 2, 6]]
        found[:, :3] *= self._texels.factor(light.local, light.fine_factor)
        even_mouth(*mouth_rows(self._head, corners), found, 3)
        return found

    def again(self, seen: Seen, light: Light, flat: np.ndarray) -> Light:
        """Find the light of a photo once more, when the colors of each texel are known from all photos.

        Args:
            seen: Its skin.
            light: As it was found.
            flat: Colors in the studio's rig, linear RGB, [N, 3].
        """
        counted = (seen.weights > 0) & self.told & (flat > _DARK).all(1)
        wanted = np.asarray(to_linear(np.asarray(seen.colors[counted], np.float64))) / flat[counted]
        level = np.median(wanted, 0)
        return self._found(seen.weights, counted, wanted / level, level, light.tone, _KNOWN)

    def exposed(self, seen: Seen, light: Light, flat: np.ndarray, shown: np.ndarray) -> Light:
        """Find how strong the studio's light is in a photo, on the skin that others show.

        Args:
            seen: Its skin.
            light: As it was found.
            flat: Colors in the rig by the other photos, linear RGB, [N, 3].
            shown: Whether these show a texel, [N] bool.
        """
        counted = (seen.weights > 0) & self.told & (flat > _DARK).all(1) & shown
        if counted.sum() < FEW:
            return light
        wanted = np.asarray(to_linear(np.asarray(seen.colors[counted], np.float64))) / flat[counted]
        return light._replace(level=np.median(wanted / self._turned[counted], 0).astype(np.float32))

    def solve(self, seen: Seen, tone: np.ndarray | None = None) -> Light:
        """Find the light of a photo.

        Args:
            seen: Its skin.
            tone: As another photo of the person has it, linear RGB, [3]; None: that of this one.
        """
        linear = np.asarray(to_linear(np.asarray(seen.colors, np.float64)))
        counted = (seen.weights > 0) & self.told
        own, few = tone is None, counted.sum() < FEW
        level = np.maximum(np.median(linear[seen.weights > 0 if few else counted], 0), 1e-4)
        tone = level if tone is None else tone
        if few:
            return Light.studio(tone, level / tone)
        # skin of one tone that the rig lit is no even color: the trained colors carry its shade below brows, nose and chin
        rig = self._rest.rig[counted]
        wanted = linear[counted] / level * (np.median(rig, 0) / rig)
        if np.median(np.abs(np.log(np.maximum(wanted / self._turned[counted], 1e-3))).mean(1)) < _AS_RIG:
            return Light.studio(tone, level / tone)
        light = self._found(seen.weights * self._telling, counted, wanted, level / tone, tone)
        if own:
            ratio = self.ratio(light)
            lit = self.lit(seen, ratio)
            middle = np.median(ratio[lit], 0)
            light = light.scaled(1.0 / middle)._replace(tone=middle * np.median(linear[lit] / ratio[lit], 0))
        return light

    def lit(self, seen: Seen, ratio: np.ndarray) -> np.ndarray:
        """Skin that a photo's light reaches, [N] bool: for it photos are exposed, not for what is in shade.

        Args:
            seen: The skin.
            ratio: Of the light, [N, 3].
        """
        shown, strength = seen.weights > 0, ratio.mean(1)
        counted = shown & self.told if (shown & self.told).any() else shown
        lit: np.ndarray = counted & (strength >= _LIT * np.quantile(strength[counted], _BRIGHT))
        return lit

    def _found(
        self, given: np.ndarray, counted: np.ndarray, wanted: np.ndarray, scale: np.ndarray, tone: np.ndarray, held: float = 1.0
    ) -> Light:  # fmt: skip
        """The light whose ratio to the rig's is nearest to `wanted` [K, 3] at the `counted` texels, times `scale` [3].

        How much it is `held` to even light is a factor.
        """
        told, weights = np.flatnonzero(self.told), given[counted]  # the counted are of these
        receivers = Receivers.around(self._receivers.points[told], self._receivers.normals[told])
        lit = straight(SUNS, receivers, list(self._seen[:, told]), self._materials.taken(told), MATT)
        ambient, rig = self._rest.transfer[told] * MATT.intensity, self._rest.rig[told].astype(np.float64)
        columns = [np.concatenate([lit[:, :, c].T, ambient], 1) / rig[:, c, None] for c in range(3)]  # [T, U] each

        def solved(every: np.ndarray, seen: np.ndarray, near: np.ndarray | None) -> np.ndarray:
            return _robust(every[counted[told]], seen, weights, every, near, held)

        grey = solved((columns[0] + columns[1] + columns[2]) / 3.0, wanted.mean(1), None)
        found = np.stack([solved(own, wanted[:, c], grey) for c, own in enumerate(columns)], 1) * scale
        suns, around = found[: len(SUNS)].astype(np.float32), Surroundings(found[len(SUNS) :]).turned(self._turn).coefficients
        return Light(suns, around.astype(np.float32), tone, np.ones(3, np.float32))


def _skin(head: HeadModel) -> np.ndarray:
    """Vertices of bare skin, [V] bool; of a head that has no such regions all but a few."""
    bare = head.marked("face", "neck")
    return (bare if bare.any() else ~bare) & ~head.marked(*_NOT_SKIN)


def seen_skin(
    head: HeadModel, texels: Texels, posed: np.ndarray, camera: Camera, picture: np.ndarray, inside: np.ndarray
) -> Seen:  # fmt: skip
    """Skin of a posed head in a picture.

    Args:
        head: Head model.
        texels: Points on it.
        posed: Vertices, [V, 3] metres.
        camera: Of the picture.
        picture: Display sRGB, [H, W, 3].
        inside: Pixels that are the person's, 0..1, [H, W].
    """
    pixels, weights = seen_texels(head, texels, posed, camera, inside)
    return Seen(bilinear(picture, pixels), weights).of_skin(head, texels)


def seen_texels(
    head: HeadModel, texels: Texels, posed: np.ndarray, camera: Camera, inside: np.ndarray, least: float = FACING
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Where points of a posed head are in a picture, [N, 2] pixels, and how directly they are seen there, 0..1 [N].

    Arguments as of `seen_skin`, and the `least` cosine between normal and view.
    """
    posed = np.asarray(posed, np.float64)
    points = texels.receivers(posed, vertex_normals(posed, head.faces))
    local, pixels = camera.project(points.points.astype(np.float64))
    rays = points.points - camera.position
    facing = -(points.normals * rays).sum(1) / np.maximum(np.linalg.norm(rays, axis=1), 1e-9)
    column = np.clip(pixels[:, 0].astype(int), 0, camera.width - 1)
    row = np.clip(pixels[:, 1].astype(int), 0, camera.height - 1)
    there = (pixels >= 0.0).all(1) & (pixels < [camera.width, camera.height]).all(1)
    near = local[:, 2] < triangle_depth(posed[head.faces], camera)[row, column] + _BEHIND
    seen = there & near & (facing > FACING)
    return pixels, seen * facing.clip(0.0, 1.0) * (inside[row, column] > 0.5)


def _robust(
    columns: np.ndarray, wanted: np.ndarray, weights: np.ndarray, everywhere: np.ndarray, near: np.ndarray | None, held: float
) -> np.ndarray:
    """Least squares of [K, U] unknowns, those of lamps not below zero; outliers (brows, marks, highlights) count little.

    The same columns of all skin [M, U] are pulled to 1, and unknowns to those of `near` [U], `held` times as much as usual.
    """
    trust = np.ones(len(wanted))
    even = everywhere.T @ everywhere * (held * _EVEN / len(everywhere)), everywhere.mean(0) * (held * _EVEN)
    for _ in range(_ROUNDS):
        weighted = columns * (weights * trust / weights.sum())[:, None]
        square, right = weighted.T @ columns + even[0], weighted.T @ wanted + even[1]
        pull = held * (_RIDGE if near is None else _TINT) * np.trace(square) / len(square)
        square += pull * np.eye(len(square))
        found = _not_below_zero(square, right if near is None else right + pull * near)
        off = columns @ found - wanted
        scale = max(1.48 * float(np.median(np.abs(off))), 1e-3)
        trust = 1.0 / (1.0 + (off / (_CUT * scale)) ** 2) ** 2
    return found


def _not_below_zero(square: np.ndarray, right: np.ndarray) -> np.ndarray:
    kept = np.ones(len(square), bool)
    while True:
        found = np.zeros(len(square))
        found[kept] = np.linalg.solve(square[np.ix_(kept, kept)], right[kept])
        worst = int(found[: len(SUNS)].argmin())
        if found[worst] >= 0.0:
            return found
        kept[worst] = False
