"""What the embedded weights and avatars reach, measured on committed truth: a change that draws people worse fails here.

The truth is eight views of two people in expressions that were held out (`tools/quality_views.py` remakes them), and one real
photo. The figures are those of today, by `pytest -s`; after better weights they are raised. A few views say less than
the model cards' tables, but the same views say at once whether something was lost.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tolerances import QUALITY_DECIBELS, QUALITY_SHARE

from grmm_core.avatar import load_avatar
from grmm_core.avatar.library import library_file
from grmm_core.controls.frame import Controls
from grmm_core.data.dataset import CaptureDataset
from grmm_core.evaluation.photo_fits import evaluate_photo
from grmm_core.evaluation.protocols import EXPRESSION, Evaluation, Settings
from grmm_core.evaluation.regions import REGIONS, region_pixels, triangle_groups
from grmm_core.evaluation.scene import Scene
from grmm_core.files.tensorfile import read_tensors
from grmm_core.geometry.camera import Camera
from grmm_core.head import load_open_head
from grmm_core.model.weights_file import resolve_weights
from grmm_core.session import create_session
from grmm_core.session.wearing import HairUse
from grmm_core.splat import GaussianArrays, Gaussians, rasterize
from grmm_core.splat.cpu.count import count_work
from grmm_core.splat.cpu.drawing import draw
from grmm_core.splat.rules import View
from grmm_core.training.losses import psnr_of

WEIGHTS = resolve_weights("default")
BALD = HairUse("none", brows="none", beard="none", lashes="none")
# PSNR in dB over black at 256 pixels: means over views, and of all pixels of a region; of avatars, on their own person. The
# truth is studio 11's. On studio 9's, whose brows stand lower than in the pictures that the weights were trained on, as here,
# faces had 33.28, 32.97, 33.70 and eyes 26.16, 25.41, 28.91; since then eyes lie in the shade of lids, and lips end where their
# landmarks are, in the model and in the truth. Mouths had 24.57, 25.12, 23.83 on studio 10's: in a darker mouth less light
# goes to and fro, which the model's tone of colors does not know of.
PSNR = {
    None: {"frame": 32.84, "mask": 31.54, "mouth": 24.16, "eyes": 25.34, "hair": 30.34, "face": 32.84, "neck": 31.85},
    "default": {"frame": 32.27, "mask": 31.39, "mouth": 24.50, "eyes": 23.64, "hair": 30.95, "face": 32.60, "neck": 32.09},
    "beard": {"frame": 33.14, "mask": 31.83, "mouth": 23.72, "eyes": 30.31, "hair": 30.08, "face": 33.15, "neck": 31.67},
}
# Median opacity of the face's Gaussians; median depth spread of what is blended at a pixel of the face, millimetres.
FOG = {"default": (0.907, 1.11), "long": (0.906, 1.03), "beard": (0.906, 1.27), "afro": (0.905, 1.05)}
# Of values 0..1 in the photo's own view and light, preset fast, skin alone, drawn with the strands. 0.0158 by the program that
# told shapes by the head model's landmarks alone: lower teeth show in the smile now. Likeness at rest, by 30 degrees was 0.473,
# 0.542 and is 0.461, 0.495.
PHOTO_RMSE = 0.0167
PHOTO_LANDMARKS = 0.0128  # off from those that MediaPipe finds, of the eyes' distance; by that program 0.016
PHOTO_HAIR = 0.916  # overlap of its hair with the photo's; by another groom 0.84


@pytest.mark.parametrize("avatar", PSNR)
def test_people_are_drawn_as_well_as_ever(avatar, repository):
    scene = Scene(WEIGHTS, avatar=None if avatar is None else load_avatar(library_file(f"library:{avatar}")))
    truth = CaptureDataset(repository / "tests" / "data" / "quality")
    rows = Evaluation(scene, [truth], Settings(limit=0, ablations=False)).run(EXPRESSION).rows
    assert len(rows) == (8 if avatar is None else 4)
    found = {"frame": np.mean([row.errors.psnr for row in rows]), "mask": np.mean([row.errors.psnr_mask for row in rows])}
    for region in REGIONS:
        sums = [row.errors.regions[region] for row in rows if region in row.errors.regions]
        found[region] = psnr_of(sum(squared for squared, _ in sums) / sum(count for _, count in sums))
    print(f"\n{avatar or 'weights'}: {', '.join(f'{name} {value:.2f}' for name, value in found.items())} dB")
    worse = {name: value for name, value in found.items() if value < PSNR[avatar][name] - QUALITY_DECIBELS}
    assert worse == {}


@pytest.fixture(scope="module")
def session():
    with create_session("local", device="cpu") as session:
        yield session


@pytest.mark.parametrize("avatar", FOG)
def test_skin_is_a_surface_and_no_fog(avatar, session):
    """Skin made of many faint Gaussians at many depths looks right from trained views alone, and blurs in between."""
    head = load_open_head()
    groups = triangle_groups(head)
    camera = Camera.orbit(256, 256, pitch=6.0, distance=1.1, fov=12.0, target=(0.0, 0.008, 0.055))
    person = session.open(f"library:{avatar}")
    drawn, mesh = session.gaussians(person.id, Controls(), hair=BALD), session.deform(person.id, Controls())
    on_face = np.isin(read_tensors(WEIGHTS)[0]["model/anchor.face"], groups["face"])
    opacity = float(np.median(drawn.opacities[on_face]))

    z = drawn.means @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
    z = (z - z.mean()) * 1e3  # millimetres around the head's middle, so that single precision is enough for squares
    fields = (drawn.means, drawn.quats, drawn.scales, drawn.opacities, drawn.colors, np.stack([z, z * z], 1))
    out = rasterize(Gaussians(*(torch.from_numpy(np.array(field, np.float32)) for field in fields)), camera)
    alpha = out.alpha.numpy()
    mean, square = np.moveaxis(out.features.numpy() / np.maximum(alpha, 1e-3)[..., None], -1, 0)
    face = region_pixels(head, groups, mesh.vertices, camera, alpha, None)["face"]
    spread = float(np.median(np.sqrt(np.maximum(square - mean**2, 0.0))[face]))

    print(f"\n{avatar}: opacity {opacity:.3f}, depth spread {spread:.2f} mm")
    least, most = FOG[avatar]
    assert face.sum() > 10_000
    assert drawn.colors.min() >= 0.0  # other renderers clip what is beyond
    assert drawn.colors.max() <= 1.0
    assert opacity > least * (1.0 - QUALITY_SHARE)
    assert spread < most * (1.0 + QUALITY_SHARE)


# Gaussians that the rules blend at a pixel of the head, 512 pixels; weights of fog had 72 to 81.
BLENDED = {"default": 31.4, "afro": 32.4}


@pytest.mark.parametrize("avatar", BLENDED)
def test_few_gaussians_are_blended_at_a_pixel(avatar, session):
    camera = Camera.orbit(512, 512, distance=1.1, fov=18.0, target=(0.0, 0.008, 0.03))
    drawn = session.gaussians(session.open(f"library:{avatar}").id, Controls(), hair=BALD)
    fields = (np.ascontiguousarray(getattr(drawn, name), np.float32) for name in GaussianArrays._fields)
    picture, drawing = draw(GaussianArrays(*fields).prepared(), np.zeros((1, 1, 3), np.float32), View.of(camera), True)
    blended = count_work(drawing, 512, 512).needed / np.count_nonzero(picture.alpha > 0.5)
    print(f"\n{avatar}: {blended:.1f} blended at a pixel")
    assert 10.0 < blended < BLENDED[avatar] * (1.0 + QUALITY_SHARE)


@pytest.mark.slow
def test_a_photo_is_fitted_as_closely_as_ever(photo_file, tmp_path):
    found = evaluate_photo(photo_file("astronaut"), Scene(WEIGHTS), None, tmp_path, "fast")
    print(f"\nphoto: RMSE {found['rmse']:.4f}, landmarks {found['landmark_error']:.4f}, hair {found['hair_overlap']:.3f}")
    assert found["rmse"] < PHOTO_RMSE * (1.0 + QUALITY_SHARE)
    assert found["landmark_error"] < PHOTO_LANDMARKS * (1.0 + QUALITY_SHARE)
    assert found["hair_overlap"] > PHOTO_HAIR * (1.0 - QUALITY_SHARE)
