"""What a captured person wears: the recorded strands, in the colors of the pictures that show them."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.data.dataset import CaptureDataset, Manifest, write_manifest, write_shot, write_subject
from grmm_core.data.layers import PART_LAYER, PARTS
from grmm_core.data.types import Picture, Shot, View
from grmm_core.geometry.camera import Camera
from grmm_core.hair import HairSettings, library_groom
from grmm_core.hair.coloring import HairView, WornHair, with_colors
from grmm_core.hair.groom import join
from grmm_core.head import load_open_head
from grmm_core.training.captured_hair import captured_hair

SIZE = 320
BROWS = HairSettings(melanin=0.8)


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """Ada, shown once with a bob and brows of known colors; Bo, whose strands are known and never seen; Cy without a record."""
    folder, head = tmp_path_factory.mktemp("capture"), load_open_head()
    write_manifest(folder, Manifest(head.name, ["ada", "bo", "cy"]))
    scalp, brows = library_groom("bob"), library_groom("bushy", head.name, "brows")
    groom, camera = join([scalp, brows]), Camera.orbit(SIZE, SIZE, 10.0, fov=14.0)
    vertices = np.asarray(head.v_template, np.float64)
    color = HairSettings(melanin=0.2, redness=0.4)
    rgb, alpha = WornHair(scalp, color, vertices, camera, head).drawn(color)
    dark, cover = WornHair(brows, BROWS, vertices, camera, head).drawn(BROWS)
    parts = np.zeros((len(PARTS), SIZE, SIZE), np.float32)
    parts[PARTS.index("hair")], parts[PARTS.index("brows")] = alpha, cover * (1.0 - alpha)
    behind = np.broadcast_to(np.array([0.75, 0.55, 0.45]), rgb.shape) * (1.0 - cover[..., None]) + dark
    rgb, alpha = rgb + (1.0 - alpha[..., None]) * behind, np.ones_like(alpha)
    bare = View("c00", camera, "0000_00_bare.png", "", "train")
    for name, worn in (("ada", groom), ("bo", groom), ("cy", None)):
        write_subject(folder, name, np.zeros(300, np.float32), {}, worn)
    view = View("c00", camera, "0000_00.png", "", "train", {PART_LAYER: "0000_00_parts.png"}, bare)
    straight = np.where(alpha[..., None] > 0.01, rgb / np.maximum(alpha[..., None], 0.01), 0.0).clip(0, 1)
    picture = Picture(straight, alpha, None, {PART_LAYER: parts}, Picture(straight, alpha, None))
    write_shot(
        folder,
        Shot("ada", 0, "neutral", np.zeros(60), np.zeros(100), np.zeros((5, 3)), (view,), folder / "shots" / "ada"),
        [picture],
    )
    return [CaptureDataset(folder)], color


def test_strands_are_those_recorded_and_colors_those_shown(capture):
    datasets, color = capture
    hair = captured_hair(datasets, "ada", load_open_head())
    assert len(hair.groom) == len(library_groom("bob")) + len(library_groom("bushy", part="brows"))
    assert abs(hair.settings.melanin - color.melanin) < 0.1
    assert hair.settings.dye == 0.0
    assert set(hair.parts) == {"brows"}
    assert abs(hair.parts["brows"].melanin - BROWS.melanin) < 0.15


def test_unseen_colors_are_left_and_unrecorded_hair_is_none(capture):
    datasets, _ = capture
    assert captured_hair(datasets, "bo", load_open_head()).settings == HairSettings()
    assert captured_hair(datasets, "cy", load_open_head()) is None


def test_grey_of_the_studio_is_one_tone():
    """White hairs among dark ones would hide where the curls of a truth go whose grey hairs are all alike."""
    head, groom, camera = load_open_head(), library_groom("bob"), Camera.orbit(SIZE, SIZE, 10.0, fov=14.0)
    vertices = np.asarray(head.v_template, np.float64)

    def shown(settings):
        return WornHair(groom, settings, vertices, camera, head).drawn(settings)

    for painted, grey in ((HairSettings(melanin=0.85, grey=0.75), True), (HairSettings(melanin=0.3), False)):
        rgb, alpha = shown(painted)
        view, full = HairView(camera, vertices, rgb, alpha, np.ones_like(alpha)), alpha > 0.8
        mixed, even = (with_colors(HairSettings(), groom, [view], head, even=one) for one in (False, True))
        assert mixed.dye == 0.0
        assert (mixed.grey > 0.0, even.dye == 1.0, even == mixed) == (grey, grey, not grey)
        np.testing.assert_allclose(shown(even)[0][full].mean(0), rgb[full].mean(0), atol=0.02)
