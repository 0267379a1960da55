"""The groom that a photo shows: found among the package's, both ways round, with its color."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from grmm_core.fitting import hair_match, hair_shape
from grmm_core.fitting import hair_texture as texture
from grmm_core.fitting.hair_grain import directions
from grmm_core.fitting.hair_match import best_grooms
from grmm_core.fitting.hair_shape import FINE, bent, field_to, offsets
from grmm_core.fitting.hair_stage import _curl, fit_hair
from grmm_core.geometry.camera import Camera
from grmm_core.geometry.zbuffer import EMPTY
from grmm_core.hair import HairSettings, library_groom
from grmm_core.hair.coloring import HairView, WornHair, with_colors
from grmm_core.hair.mirror import mirrored
from grmm_core.head import load_open_head
from grmm_core.splat import Gaussians, rasterize

AXES = torch.tensor([1.0, 0.0, 0.0])[:, None, None, None]
SKIN = np.array([0.75, 0.56, 0.47])


def photo(groom, settings, yaw):
    """What a photo of the mean head with a groom shows, and its hair's true cover."""
    head = load_open_head()
    vertices, camera = np.asarray(head.v_template, np.float64), Camera.orbit(288, 288, yaw, 6.0)
    rgb, alpha = WornHair(groom, settings, vertices, camera, head).drawn(settings)
    image = rgb + (1 - alpha[..., None]) * SKIN
    return HairView(camera, vertices, image, alpha, np.ones_like(alpha))


@pytest.mark.parametrize(
    ("name", "flipped", "settings"),
    [("bob", False, HairSettings(melanin=0.3)), ("side_part", True, HairSettings(melanin=0.9, grey=0.5))],
)
def test_a_packaged_groom_is_found_again_with_its_color(name, flipped, settings):
    head = load_open_head()
    groom = mirrored(library_groom(name), head) if flipped else library_groom(name)
    hair = fit_hair([photo(groom, settings, yaw) for yaw in (-20.0, 35.0)], head)
    roots, found = (set(zip(one.triangles, map(tuple, one.weights), strict=True)) for one in (groom, hair.groom))
    assert found <= roots
    assert len(hair.groom) > 0.998 * len(groom)  # a bend may lead a handful astray
    shown, again = (photo(groom, made, -20.0) for made in (settings, hair.settings))
    full = (shown.hair > 0.95) & (again.hair > 0.95)
    np.testing.assert_allclose(again.image[full].mean(0), shown.image[full].mean(0), atol=0.05)
    assert np.minimum(shown.hair, again.hair).sum() > 0.85 * np.maximum(shown.hair, again.hair).sum()


@pytest.mark.parametrize("size", [1, 5, 15])
def test_cover_is_averaged_over_squares(size):
    cover = torch.rand(1, 20, 13, generator=torch.Generator().manual_seed(size))
    rows, columns = (hair_shape._banded(count, size) for count in cover.shape[1:])
    expected = torch.nn.functional.avg_pool2d(cover, size, 1, size // 2)
    torch.testing.assert_close(rows @ cover @ columns, expected)


def test_long_hair_is_not_bent_to_short_hair(monkeypatch):
    """It covers any silhouette once it is cut short and bent; what was not likely before that stays out."""
    monkeypatch.setattr(hair_match, "groom_names", lambda: ("long", "crop", "ponytail"))
    matches = best_grooms([photo(library_groom("crop"), HairSettings(melanin=0.7), 10.0)], load_open_head())
    assert [match.name for match in matches] == ["crop"]


def test_hair_that_is_seen_to_hang_low_on_one_side_is_not_short_behind(monkeypatch):
    """What lies behind a shoulder is not seen: long hair cut to the jaw and bent covered the rest as well."""
    head, shown = load_open_head(), photo(library_groom("long"), HairSettings(melanin=0.6), 15.0)
    monkeypatch.setattr(hair_match, "groom_names", lambda: ("bob", "long"))
    column, row = shown.camera.project(np.zeros((1, 3)))[1][0].astype(int)
    hair = shown.hair.copy()
    hair[row:, column:] = 0.0
    match, *_ = best_grooms([replace(shown, hair=hair)], head)
    assert match.name == "long"
    assert match.length >= 0.8
    assert hair_match._lowest(shown.camera, shown.hair) == pytest.approx(-0.147, abs=0.01), "metres below the head's middle"


def test_of_bent_hair_what_is_too_long_costs_less_than_what_is_missing():
    """What hangs beside a photo's hair is cut afterwards; what is missing stays so."""
    head = load_open_head()
    stages = [hair_match.Stage(photo(library_groom("bob"), HairSettings(), 10.0), head)]
    short, right, long = (hair_match.Candidate.of("bob", False, head).course(stages, length) for length in (0.8, 1.0, 1.5))
    found, cut = (
        [hair_match._agreement(stages, course, beyond=beyond) for course in (short, right, long)]
        for beyond in (1.0, hair_match.TRIMMED)
    )
    assert found[1] > found[0] > found[2] + 0.05
    assert cut[2] > cut[0] + 0.05
    assert cut[1] > cut[0]


def test_long_hair_below_a_hat_is_long(monkeypatch):
    head, shown = load_open_head(), photo(library_groom("long"), HairSettings(melanin=0.6), 10.0)
    monkeypatch.setattr(hair_match, "LONG_UNDER_HATS", ("bob", "long"))
    brim = int(shown.camera.project(np.array([[0.0, 0.07, 0.09]]))[1][0, 1])
    hair, counts = shown.hair.copy(), shown.counts.copy()
    hair[:brim] = counts[:brim] = 0.0
    match, *_ = best_grooms([replace(shown, hair=hair, counts=counts)], head)
    assert match.name == "long"
    assert match.field is not None, "what shows of it is bent to"
    hair[int(0.45 * len(hair)) :] = 0.0
    match, *_ = best_grooms([replace(shown, hair=hair, counts=counts)], head)
    assert match.name in hair_match.UNDER_HATS
    assert match.field is None


def test_hair_that_hardly_shows_is_not_dyed():
    """Blue of a sky in the few pixels beside a hat made a lilac head of hair; where all of it shows, it may be lilac."""
    head, groom = load_open_head(), library_groom("bob")
    lilac = HairSettings(dye=1.0, dye_red=0.5, dye_green=0.35, dye_blue=0.5)
    whole = photo(groom, lilac, 0.0)
    rows, columns = np.nonzero(whole.hair > 0.9)
    beside = np.zeros_like(whole.hair)
    beside[rows[:1200], columns[:1200]] = 1.0
    plain, dyed = (
        with_colors(HairSettings(redness=0.6), groom, [replace(whole, hair=hair)], head) for hair in (beside, whole.hair)
    )
    assert dyed.dye == 1.0
    assert plain.dye == plain.redness == 0.0
    shown, again = (photo(groom, settings, 0.0).image[whole.hair > 0.95].mean() for settings in (lilac, plain))
    assert abs(shown - again) < 0.1, "how bright it is is believed"


def test_a_head_without_hair_is_bald():
    head = load_open_head()
    view = photo(library_groom("bob"), HairSettings(), 0.0)
    nothing = HairView(view.camera, view.vertices, view.image, np.zeros_like(view.hair), view.counts)
    assert fit_hair([nothing], head) is None


def test_streaks_of_a_photo_are_found_and_fade_where_it_shows_nothing():
    head = load_open_head()
    groom, settings = library_groom("bob"), HairSettings(melanin=0.7)
    places = texture.places_of(groom, head)
    streaked = np.sin(places[:, :1, :1] / 0.008) * np.ones((1, texture.TINTS, 1)) * np.array([0.2, 0.15, 0.1])
    camera, vertices = Camera.orbit(256, 256, 10.0, 6.0), np.asarray(head.v_template, np.float64)

    def strands(tints):
        worn = WornHair(replace(groom, tints=tints), settings, vertices, camera, head, vertices)
        return worn, Gaussians(*(torch.from_numpy(part) for part in worn.gaussians(settings)))

    skin, (_, true), (worn, plain) = torch.full((256, 256, 3), 0.5), strands(streaked.astype(np.float32)), strands(None)
    shown = rasterize(true, camera)
    image = shown.rgb + (1.0 - shown.alpha)[..., None] * skin
    rows, where = (torch.from_numpy(part) for part in worn.pieces(settings))
    seen = texture.Photo(
        image, shown.alpha, shown.alpha, torch.ones_like(shown.alpha), skin, plain, rows, where, camera, np.ones(len(groom))
    )
    found, known = texture.reconstructed([texture.Onto(seen, len(groom))], places)
    tints = texture.spread(places, found, known)

    again, before = (rasterize(one, camera).rgb for one in (strands(tints)[1], plain))
    full = (shown.alpha > 0.95) & (texture.faced(plain, camera) > 0.95)
    off, was = (float((one - shown.rgb)[full].square().mean().sqrt()) for one in (again, before))
    assert off < 0.35 * was
    back = places[..., 2].min(1) < -0.06
    assert np.abs(tints[back]).mean() < 0.2 * np.abs(tints[known > 0.5]).mean()
    assert (known[back] < 0.1).mean() > 0.9
    assert np.isfinite(tints).all()


def test_a_wall_that_is_perhaps_hair_gives_dark_hair_no_bright_ends():
    """The parser takes walls beside shoulders for hair now and then, less surely than hair, whose colors tell what is hair."""
    head = load_open_head()
    groom, settings = library_groom("long"), HairSettings(melanin=0.9)
    camera, vertices = Camera.orbit(256, 256, 0.0, 0.0), np.asarray(head.v_template, np.float64)
    worn = WornHair(groom, settings, vertices, camera, head, vertices)
    strands = Gaussians(*(torch.from_numpy(part) for part in worn.gaussians(settings)))
    shown, low = rasterize(strands, camera), torch.zeros(256, 256)
    low[int(camera.project(np.array([[0.0, -0.08, 0.0]]))[1][0, 1]) :] = 1.0
    image = shown.rgb + (1.0 - shown.alpha)[..., None] * 0.5
    image = torch.where((low > 0.0)[..., None], torch.tensor([0.9, 0.8, 0.4]), image)
    rows, where = (torch.from_numpy(part) for part in worn.pieces(settings))
    ends = []
    for doubt in (0.0, 0.3):
        seen = texture.Photo(
            image, shown.alpha, shown.alpha - doubt * low, torch.ones_like(shown.alpha), torch.full_like(image, 0.5), strands,
            rows, where, camera, np.ones(len(groom)),
        )  # fmt: skip
        places = texture.places_of(groom, head)
        tints, known = texture.reconstructed([texture.Onto(seen, len(groom))], places)
        ends.append(float(tints[(known > 0.5) & (places[..., 1] < -0.1)].mean()))
    assert ends[0] > 0.15
    assert ends[1] < 0.3 * ends[0]


def test_colors_of_hair_are_even_along_strands():
    places = np.zeros((2, texture.TINTS, 3))
    places[..., 1] = -np.linspace(0.0, 0.1, texture.TINTS)
    banded = np.where(np.arange(texture.TINTS) % 2, 0.2, -0.2)  # narrow locks of a photo cross the strands
    seen = Pixels(np.stack([banded, banded + 0.3]), np.array([1.0, 0.5]))
    found, known = texture.reconstructed([seen], places)
    assert np.ptp(found, axis=1).max() < np.ptp(banded) / 3
    np.testing.assert_allclose(found[1].mean(0) - found[0].mean(0), 0.3, atol=0.03)
    assert (known[0] > known[1]).all()


class Pixels:
    """In the place of `texture.Onto`: a pixel for each place, which shows it to so much of the strand's."""

    def __init__(self, colors: np.ndarray, shown: np.ndarray) -> None:
        self.colors = torch.from_numpy(np.repeat(colors.reshape(-1, 1), 3, 1).astype(np.float32))
        self.shown = torch.from_numpy(np.repeat(shown, texture.TINTS).astype(np.float32))
        self.pure = torch.ones_like(self.shown)
        nothing = torch.zeros(0, 3)
        strands = SimpleNamespace(colors=nothing)
        self.photo = SimpleNamespace(image=nothing, hair=torch.zeros(0), sure=torch.zeros(0), strands=strands)

    def mean(self, values: torch.Tensor) -> torch.Tensor:
        return torch.zeros_like(self.colors)

    def step(self, tints: torch.Tensor) -> torch.Tensor:
        return self.shown[:, None] * (self.colors - tints)


def test_hair_at_a_slant_tells_no_color():
    across, up = (part.reshape(-1) for part in np.meshgrid(np.linspace(-0.1, 0.1, 60), np.linspace(-0.1, 0.1, 60)))
    camera = Camera.orbit(64, 64, distance=1.0, fov=8.0)
    for degrees, believed in ((0.0, 1.0), (60.0, 1.0), (80.0, 0.5), (88.0, 0.0)):
        angle = np.radians(degrees)
        sheet = np.stack([across * np.cos(angle) * 3.0, up, across * np.sin(angle) * 3.0], 1)
        count = len(sheet)
        strands = Gaussians(*(torch.from_numpy(np.asarray(part, np.float32)) for part in (
            sheet, np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), np.full((count, 3), 0.004), np.ones(count), np.ones((count, 3)),
        )))  # fmt: skip
        assert abs(float(texture.faced(strands, camera)[24:40, 30:34].mean()) - believed) < 0.15


def test_directions_are_those_of_stripes():
    y, x = np.mgrid[0:40, 0:40] * 1.0
    for degrees in (0.0, 30.0, 90.0, 150.0):
        angle = np.radians(degrees)
        stripes = 0.5 + 0.4 * np.sin(0.8 * (x * np.sin(angle) - y * np.cos(angle)))
        seen = directions(np.repeat(stripes[..., None], 3, 2), np.ones((40, 40)))
        inner = (slice(8, -8),) * 2
        assert np.mean(seen.cosine[inner] * np.cos(2 * angle) + seen.sine[inner] * np.sin(2 * angle)) > 0.9


def test_a_field_moves_tips_and_leaves_roots():
    head = load_open_head()
    vertices = np.asarray(head.v_template, np.float64)
    groom = library_groom("bob")
    field = torch.zeros(3, *FINE[-1].nodes[::-1])
    field[2] = -0.02
    moved = bent(groom, 1.0, field, head)
    flat, back = (one.posed(one.frames(vertices, head.faces), vertices) for one in (groom.resampled(moved.counts[0]), moved))
    first, last = moved.offsets[:-1], moved.offsets[1:] - 1
    np.testing.assert_allclose(back[first], flat[first], atol=1e-4)
    assert abs(float(np.median(back[last, 2] - flat[last, 2])) + 0.02) < 0.003


def test_long_hair_leaves_its_parting_sooner_than_short_hair_leaves_the_head():
    field = torch.zeros(3, *FINE[-1].nodes[::-1])
    field[1] = 0.02
    along = np.linspace(0.0, 1.0, 11)[None, :, None] * np.array([1.0, 0.0, 0.0])
    short, long = (offsets(field, length * along)[0, :, 1] for length in (0.05, 0.2))
    np.testing.assert_allclose(short, 0.02 * np.linspace(0, 1, 11), atol=1e-6)
    np.testing.assert_allclose(long, 0.02 * np.minimum(np.linspace(0, 1, 11) * 10, 1.0), atol=1e-6)


@pytest.mark.parametrize(
    ("wavy", "least", "most"), [(None, 0.0, 0.0), (0.1, 0.0, 0.0), (0.35, 0.0, 0.0), (0.5, 0.15, 0.6), (2.0, 0.6, 0.6)]
)
def test_straight_hair_is_curled_as_far_as_the_photo_shows(wavy, least, most):
    """Even very straight hair is left as it is where the photo shows no waves."""
    for name in ("bob", "slick_back"):
        assert least <= _curl(library_groom(name), [SimpleNamespace(wavy=wavy)], load_open_head()) <= most


def test_hair_swells_to_the_outline_that_a_photo_shows():
    head = load_open_head()
    nodes = FINE[-1].nodes
    wide = bent(library_groom("bob"), 1.0, 0.02 * torch.linspace(-1, 1, nodes[0]).expand(3, *nodes[::-1]) * AXES, head)
    view = photo(wide, HairSettings(melanin=0.5), 0.0)
    hair = fit_hair([view], head)
    again, plain = (photo(one, HairSettings(melanin=0.5), 0.0).hair for one in (hair.groom, library_groom("bob")))
    off = [float(np.abs(view.hair - cover).sum()) for cover in (again, plain)]
    assert off[0] < 0.7 * off[1]


def test_a_fringe_is_swept_to_the_side_as_in_the_photo(monkeypatch):
    """The same silhouette is not the same hair: by cover alone, strands lie across those of the photo."""
    head, groom = load_open_head(), library_groom("fringe")
    sideways = 0.04 * AXES.expand(3, *FINE[-1].nodes[::-1])
    stage = hair_match.Stage(photo(groom, HairSettings(), 0.0), head)
    plain, true = (
        hair_match.Strands(one, head, hair_match.STRANDS).course([stage], 1.0)
        for one in (groom, bent(groom, 1.0, sideways, head))
    )
    stage.hair, stage.seen = stage.drawn(true.posed[0], true.radii)

    def errors():
        field = field_to(plain, [stage])
        points = plain.posed[0] + np.matmul(offsets(field, plain.rest), plain.turns[0])
        cover, way = stage.drawn(points.astype(np.float32), plain.radii)
        clear = np.hypot(*stage.seen) * np.hypot(*way)
        agree = stage.seen.cosine * way.cosine + stage.seen.sine * way.sine
        before = (clear > 0.3) & (stage.depth < EMPTY)
        angles = 0.5 * np.degrees(np.arccos(np.clip(agree[before] / clear[before], -1.0, 1.0)))
        return float(angles.mean()), float(np.abs(cover - stage.hair).sum() / stage.hair.sum())

    turned, off = errors()
    monkeypatch.setattr(hair_shape, "TURNED", 0.0)
    by_cover = errors()[0]
    assert turned < 0.9 * by_cover
    assert off < 0.2
