"""The rasteriser's rules by hand-computed pictures on every backend that runs here, and every backend against the reference."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from splat_scenes import OUTPUTS, SCENES, assert_parity, leaves_of, orbit, pulled, scene

from grmm_core.errors import BackendError, ShapeError
from grmm_core.geometry.camera import Camera
from grmm_core.splat import Gaussians, available_backends, rasterize
from grmm_core.splat.compensation import FINEST, compensation, filtered, unresolved
from grmm_core.splat.rules import NEAR, View

BACKENDS = [info.name for info in available_backends() if info.available and info.name != "cuda"]
each_backend = pytest.mark.parametrize("backend", BACKENDS)
each_fast_backend = pytest.mark.parametrize("backend", [name for name in BACKENDS if name != "torch"])
CAMERA = Camera(np.eye(4), 100.0, 100.0, 8.5, 6.5, 17, 13)  # looks along +z; the centre of pixel [6, 8] is on the axis


def ball(z=1.0, x=0.0, y=0.0, size=0.02, opacity=0.8, color=(1.0, 0.5, 0.25), features=None):
    return Gaussians(
        torch.tensor([[x, y, z]]),
        torch.tensor([[1.0, 0, 0, 0]]),
        torch.full((1, 3), size),
        torch.tensor([opacity]),
        torch.tensor([color]),
        None if features is None else torch.tensor([features]),
    )


@each_backend
def test_one_gaussian_is_a_dilated_normal_density(backend):
    out = rasterize(ball(z=2.0, features=[3.0, -1.0]), CAMERA, background=(0.1, 0.2, 0.3), backend=backend)
    variance = (100.0 * 0.02 / 2.0) ** 2 + 0.3
    x, y = np.meshgrid(np.arange(17) - 8.0, np.arange(13) - 6.0)
    alpha = 0.8 * np.exp(-(x * x + y * y) / (2 * variance))
    alpha[alpha < 1 / 255] = 0
    np.testing.assert_allclose(out.alpha.numpy(), alpha, atol=2e-6)
    expected = alpha[..., None] * [1.0, 0.5, 0.25] + (1 - alpha)[..., None] * [0.1, 0.2, 0.3]
    np.testing.assert_allclose(out.rgb.numpy(), expected, atol=3e-6)
    np.testing.assert_allclose(out.depth.numpy(), np.where(alpha > 0, 2.0, 0.0), atol=1e-4)
    np.testing.assert_allclose(out.features.numpy(), alpha[..., None] * [3.0, -1.0], atol=1e-5)


@each_backend
def test_the_nearer_gaussian_covers_the_farther_one(backend):
    both = Gaussians.concatenate([ball(z=2.0, color=(0.0, 1.0, 0.0), size=0.2), ball(z=1.0, color=(1.0, 0.0, 0.0), size=0.2)])
    out = rasterize(both, CAMERA, backend=backend)
    torch.testing.assert_close(out.rgb[6, 8], torch.tensor([0.8, 0.16, 0.0]), atol=1e-5, rtol=0)
    assert out.alpha[6, 8].item() == pytest.approx(0.96, abs=1e-5)
    assert out.depth[6, 8].item() == pytest.approx((0.8 * 1 + 0.16 * 2) / 0.96, abs=1e-5)


@each_backend
@pytest.mark.parametrize("first", [0, 1])
def test_equal_depths_keep_the_order_of_their_index(backend, first):
    colors = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]
    balls = Gaussians.concatenate([ball(color=colors[first]), ball(color=colors[1 - first])])
    out = rasterize(balls, CAMERA, backend=backend)
    assert out.rgb[6, 8, first].item() == pytest.approx(0.8, abs=1e-5)
    assert out.rgb[6, 8, 1 - first].item() == pytest.approx(0.16, abs=1e-5)


@each_backend
def test_many_equal_depths_keep_the_order_of_their_index(backend):
    # More than the short lists that are sorted by insertion; alternating depths so that the sort has something to move.
    near, far = ball(z=1.0, opacity=0.05, features=[0.0]), ball(z=1.5, opacity=0.05, features=[0.0])
    many = Gaussians.concatenate([far, near] * 40)
    many.features = torch.arange(80.0)[:, None]
    out = rasterize(many, CAMERA, backend=backend)
    order = list(range(1, 80, 2)) + list(range(0, 80, 2))
    weight, expected = 1.0, 0.0
    for index in order:
        expected += 0.05 * weight * index
        weight *= 0.95
    assert out.features[6, 8, 0].item() == pytest.approx(expected, rel=1e-4)


@each_backend
def test_the_gaussian_that_ends_a_pixel_covers_what_is_left(backend):
    red, green, blue = np.eye(3).tolist()
    parts = [ball(z=1.0 + 0.1 * k, opacity=o, color=c) for k, (o, c) in enumerate([(0.9, red), (0.97, green), (1.0, blue)])]
    out = rasterize(Gaussians.concatenate(parts), CAMERA, background=(1.0, 1.0, 1.0), backend=backend)
    # The first leaves 0.1; the second would leave 0.003 < 1/255, so that neither the third nor the background is seen.
    torch.testing.assert_close(out.rgb[6, 8], torch.tensor([0.9, 0.1, 0.0]), atol=1e-6, rtol=0)
    assert out.alpha[6, 8].item() == 1
    assert out.depth[6, 8].item() == pytest.approx(1.01, abs=1e-5)


@each_backend
def test_the_gaussian_that_ends_a_pixel_has_no_gradient_of_opacity_there_and_those_before_it_do(backend):
    opacities = torch.tensor([0.9, 0.97], requires_grad=True)
    both = Gaussians.concatenate([ball(z=1.0, color=(1.0, 0.0, 0.0)), ball(z=1.1, color=(0.0, 1.0, 0.0))])
    out = rasterize(dataclasses.replace(both, opacities=opacities), CAMERA, backend=backend)
    out.rgb[6, 8].sum().backward(retain_graph=True)
    torch.testing.assert_close(opacities.grad, torch.zeros(2), atol=1e-5, rtol=0)  # whatever they are, they cover the pixel
    opacities.grad = None
    out.rgb[6, 8, 0].backward()
    torch.testing.assert_close(opacities.grad, torch.tensor([1.0, 0.0]), atol=1e-5, rtol=0)


@each_backend
def test_a_gaussian_that_covers_less_than_the_threshold_is_skipped(backend):
    assert rasterize(ball(opacity=0.9 / 255), CAMERA, backend=backend).alpha.max().item() == 0
    assert rasterize(ball(opacity=1.1 / 255), CAMERA, backend=backend).alpha.max().item() == pytest.approx(1.1 / 255, rel=1e-4)


@each_backend
@pytest.mark.parametrize("z", [0.009, 0.0, -1.0])
def test_nothing_before_the_near_plane_is_drawn(backend, z):
    assert rasterize(ball(z=z), CAMERA, backend=backend).alpha.max().item() == 0


@each_backend
def test_an_orthographic_picture_does_not_depend_on_depth(backend):
    camera = Camera(np.eye(4), 100.0, 100.0, 8.5, 6.5, 17, 13, orthographic=True)
    near, far = (rasterize(ball(z=z, x=0.03), camera, backend=backend) for z in (0.5, 5.0))
    torch.testing.assert_close(near.rgb, far.rgb)
    assert near.alpha.argmax().item() == 6 * 17 + 11
    assert far.depth[6, 11].item() == pytest.approx(5.0, abs=1e-4)


@each_backend
def test_antialiasing_keeps_the_light_of_a_small_gaussian(backend):
    small = ball(size=0.0005)  # 0.05 px
    plain = rasterize(small, CAMERA, backend=backend).alpha.sum().item()
    kept = rasterize(small, CAMERA, backend=backend, antialiased=True).alpha[6, 8].item()
    assert kept == pytest.approx(0.8 * 0.05**2 / (0.05**2 + 0.3), rel=1e-3)
    assert plain > 50 * kept


@pytest.mark.parametrize("name", SCENES)
def test_opacities_compensated_beforehand_draw_the_antialiased_picture(name):
    make, camera = SCENES[name]
    gaussians = make()
    gaussians.opacities = gaussians.opacities.clamp(max=1.0)
    kept = compensation(gaussians.means, gaussians.quats, gaussians.scales, camera)
    arrays = compensation(*(part.numpy() for part in (gaussians.means, gaussians.quats, gaussians.scales)), camera)
    seen = View.of(camera)
    front = (gaussians.means.numpy() @ seen.rotation.T + seen.translation)[:, 2] >= NEAR  # others are not drawn
    np.testing.assert_allclose(arrays[front], kept.numpy()[front], rtol=2e-3, atol=1e-5)
    drawn = rasterize(dataclasses.replace(gaussians, opacities=gaussians.opacities * kept), camera)
    expected = rasterize(gaussians, camera, antialiased=True)
    torch.testing.assert_close(drawn.rgb, expected.rgb, rtol=0, atol=2e-3)
    torch.testing.assert_close(drawn.alpha, expected.alpha, rtol=0, atol=2e-3)


def sheet(library):
    """A surface of small Gaussians 0.4 mm apart, a metre before the camera, that training pictures saw as closed."""
    x, y = np.meshgrid(np.arange(-20, 21) * 4e-4, np.arange(-20, 21) * 4e-4)
    count = x.size
    parts = (
        np.stack([x.ravel(), y.ravel(), np.ones(count)], 1), np.tile([1.0, 0, 0, 0], (count, 1)),
        np.tile([1e-4, 1e-4, 1e-5], (count, 1)), np.full(count, 0.9), np.full((count, 3), 0.5),
    )  # fmt: skip
    return Gaussians(*(library(part.astype(np.float32)) for part in parts))


def test_a_close_up_has_no_gaps_between_what_training_pictures_saw_closed():
    middle = np.array([0.0, 0.0, 1.0])

    def alpha(pixel, prepare):
        camera = Camera(np.eye(4), 1 / pixel, 1 / pixel, 32, 32, 64, 64)
        return rasterize(prepare(sheet(torch.from_numpy), camera), camera).alpha[28:36, 28:36]

    def plain(gaussians, camera):
        kept = compensation(gaussians.means, gaussians.quats, gaussians.scales, camera)
        return dataclasses.replace(gaussians, opacities=gaussians.opacities * kept)

    def near(gaussians, camera):
        return filtered(gaussians, camera, middle)

    torch.testing.assert_close(alpha(FINEST, near), alpha(FINEST, plain), rtol=0, atol=0)
    torch.testing.assert_close(alpha(1.5 * FINEST, near), alpha(1.5 * FINEST, plain), rtol=0, atol=0)
    seen, gap, closed = alpha(FINEST, plain).mean(), alpha(0.1 * FINEST, plain).min(), alpha(0.1 * FINEST, near).min()
    assert gap < 0.6 * seen
    assert closed > 0.85 * seen


@pytest.mark.parametrize("orthographic", [False, True])
def test_a_close_up_is_the_same_for_arrays_and_tensors(orthographic):
    camera = Camera(np.eye(4), 9000.0, 9000.0, 32, 32, 64, 64, orthographic=orthographic)
    arrays, tensors = (filtered(sheet(kind), camera, np.array([0.0, 0.0, 1.0])) for kind in (np.asarray, torch.from_numpy))
    for name in ("scales", "opacities"):
        np.testing.assert_allclose(getattr(arrays, name), getattr(tensors, name).numpy(), rtol=2e-3, atol=1e-9)
    assert (arrays.scales[:, :2] > 1.1e-4).all()
    np.testing.assert_array_equal(arrays.scales[:, 2], sheet(np.asarray).scales[:, 2])


def test_a_scaled_model_is_near_where_its_own_pixels_are_fine():
    middle, camera = np.array([0.0, 0.0, 1.0]), Camera(np.eye(4), 9000.0, 9000.0, 32, 32, 64, 64)
    here = unresolved(camera, middle)
    assert here > 0
    for scale in (0.1, 10.0):
        assert unresolved(camera.transformed(np.diag([scale, scale, scale, 1.0])), middle) == pytest.approx(here)
    assert unresolved(Camera(np.eye(4), 2000.0, 2000.0, 32, 32, 64, 64), middle) == 0


@each_backend
def test_no_gaussians_leave_the_background(backend):
    empty = scene(0, channels=2)
    ground = torch.rand(13, 17, 3, generator=torch.Generator().manual_seed(1))
    out = rasterize(empty, CAMERA, background=ground, backend=backend)
    torch.testing.assert_close(out.rgb, ground)
    assert out.features.shape == (13, 17, 2)
    for tensor in (out.alpha, out.depth, out.features):
        assert tensor.abs().max().item() == 0


@each_backend
@pytest.mark.parametrize("field", ["means", "quats", "scales", "opacities", "colors", "features"])
@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_a_gaussian_with_a_non_finite_number_is_not_drawn(backend, field, number):
    good = scene(40, seed=3)
    bad = dataclasses.replace(scene(41, seed=3))
    for name in ("means", "quats", "scales", "opacities", "colors", "features"):
        values = torch.cat([getattr(good, name)[:20], getattr(bad, name)[40:], getattr(good, name)[20:]])
        if name == field:
            values.view(41, -1)[20, -1] = number
        setattr(bad, name, values.requires_grad_())
    out = rasterize(bad, orbit(), backend=backend)
    expected = rasterize(good, orbit(), backend=backend)
    torch.testing.assert_close(out.rgb, expected.rgb)
    torch.testing.assert_close(out.features, expected.features)
    (out.rgb.sum() + out.depth.sum() + out.features.sum()).backward()
    for name in ("means", "quats", "scales", "opacities", "colors", "features"):
        gradient = getattr(bad, name).grad
        assert gradient.isfinite().all()
        assert gradient[20].abs().max().item() == 0


@each_backend
def test_a_zero_quaternion_is_not_drawn(backend):
    one = ball()
    one.quats = torch.zeros(1, 4)
    assert rasterize(one, CAMERA, backend=backend).alpha.max().item() == 0


@each_backend
@pytest.mark.parametrize("options", [{}, {"antialiased": True}])
def test_a_crop_equals_its_region_of_the_whole_picture(backend, options):
    whole, x, y = orbit(64, 48), 19, 7
    many = scene(200, size=0.03, spread=0.2)
    full = rasterize(many, whole, backend=backend, **options)
    part = rasterize(many, whole.crop(x, y, 30, 35), backend=backend, frame=whole, **options)
    for name in ("rgb", "alpha", "depth", "features"):
        torch.testing.assert_close(getattr(part, name), getattr(full, name)[y : y + 35, x : x + 30], atol=2e-4, rtol=1e-3)


@each_backend
def test_an_empty_picture_can_be_differentiated(backend):
    away = scene(10)
    away.means[:] -= torch.tensor(orbit().forward, dtype=torch.float32) * 5.0
    away.means.requires_grad_()
    out = rasterize(away, orbit(), backend=backend)
    (out.rgb.sum() + out.depth.sum()).backward()
    assert not away.means.grad.any()


@each_backend
def test_background_gradients_are_what_shines_through(backend):
    vector = torch.tensor([0.1, 0.2, 0.3], requires_grad=True)
    out = rasterize(ball(), CAMERA, background=vector, backend=backend)
    out.rgb.sum().backward()
    torch.testing.assert_close(vector.grad, (1 - out.alpha).sum().expand(3), rtol=1e-5, atol=1e-4)
    image = torch.zeros(13, 17, 3, requires_grad=True)
    out = rasterize(ball(), CAMERA, background=image, backend=backend)
    out.rgb.sum().backward()
    torch.testing.assert_close(image.grad, (1 - out.alpha)[..., None].expand(13, 17, 3), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("field", "shape"),
    [("means", (5, 2)), ("quats", (5, 3)), ("scales", (4, 3)), ("opacities", (5, 1)), ("colors", (5, 4)), ("features", (4, 2))],
)
def test_a_wrong_shape_is_named(field, shape):
    gaussians = scene(5)
    setattr(gaussians, field, torch.zeros(shape))
    with pytest.raises(ShapeError, match=rf"{field} has the shape \[{', '.join(map(str, shape))}\]"):
        rasterize(gaussians, CAMERA)


def test_wrong_types_backgrounds_and_backends_are_named():
    integers = scene(5)
    integers.colors = torch.zeros(5, 3, dtype=torch.int64)
    with pytest.raises(ShapeError, match="colors holds"):
        rasterize(integers, CAMERA)
    with pytest.raises(ShapeError, match="background"):
        rasterize(scene(5), CAMERA, background=torch.zeros(4))
    with pytest.raises(BackendError, match="vulkan"):
        rasterize(scene(5), CAMERA, backend="vulkan")
    with pytest.raises(ShapeError, match="features"):
        Gaussians.concatenate([scene(2, channels=3), scene(2, channels=0)])


def draw(gaussians, camera, backend, dtype, antialiased, background):
    leaves = leaves_of(gaussians, dtype)
    return pulled(rasterize(Gaussians(*leaves), camera, background, backend, antialiased), leaves)


@each_fast_backend
@pytest.mark.parametrize("antialiased", [False, True], ids=["plain", "antialiased"])
@pytest.mark.parametrize("name", SCENES)
def test_pictures_and_gradients_equal_the_reference(backend, name, antialiased):
    make, camera = SCENES[name]
    expected = draw(make(), camera, "torch", torch.float64, antialiased, (0.2, 0.5, 0.7))
    assert expected[0][1].max() > 0, "the scene must show something"
    assert_parity(draw(make(), camera, backend, torch.float32, antialiased, (0.2, 0.5, 0.7)), expected)


@each_fast_backend
def test_gradients_of_one_output_alone_equal_the_reference(backend):
    camera = orbit(30, 30)
    for output in OUTPUTS:
        gradients = []
        for name, dtype in (("torch", torch.float64), (backend, torch.float32)):
            many = scene(60, seed=21, dtype=dtype)
            many.means.requires_grad_()
            picture = getattr(rasterize(many, camera, backend=name), output)
            weights = torch.linspace(-1, 1, picture.numel(), dtype=dtype).reshape(picture.shape)
            gradients.append(torch.autograd.grad((picture * weights).sum(), many.means)[0].double())
        torch.testing.assert_close(gradients[1], gradients[0], rtol=1e-3, atol=2e-4 * gradients[0].abs().max().item())


def test_available_backends_name_all_and_say_why():
    infos = {info.name: info for info in available_backends()}
    assert {"torch", "cpu", "cuda"} <= set(infos)
    assert infos["torch"].available
    assert all(info.detail for info in infos.values())


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("antialiased", [False, True])
def test_reference_gradients_equal_finite_differences(orthographic, antialiased):
    # Few, wide and faint: no pixel is near a threshold, so that the picture is smooth where it is probed.
    base = scene(3, channels=1, seed=11, dtype=torch.float64, spread=0.03, size=0.15)
    base.opacities = 0.2 + 0.4 * base.opacities
    focal = 18.0 if orthographic else 14.0
    camera = dataclasses.replace(orbit(4, 3), fx=focal, fy=1.1 * focal, orthographic=orthographic)

    def picture(means, quats, scales, opacities, colors, features, background):
        out = rasterize(Gaussians(means, quats, scales, opacities, colors, features), camera, background, "torch", antialiased)
        return out.rgb, out.alpha, out.depth, out.features

    inputs = (base.means, base.quats, base.scales, base.opacities, base.colors, base.features)
    inputs = tuple(tensor.clone().requires_grad_() for tensor in (*inputs, torch.tensor([0.3, 0.6, 0.9], dtype=torch.float64)))
    assert picture(*inputs)[1].min().item() > 0.1
    assert torch.autograd.gradcheck(picture, inputs, eps=1e-6, atol=1e-6, rtol=1e-4)


@each_backend
@pytest.mark.parametrize("orthographic", [False, True])
def test_a_motion_is_a_moved_camera(backend, orthographic):
    camera = dataclasses.replace(orbit(), orthographic=orthographic, fx=90.0, fy=80.0)
    turn, shift = np.array([0.1, -0.2, 0.05]), np.array([0.01, -0.02, 0.03])
    x, y, z = turn
    matrix = np.eye(4)
    matrix[:3, :3] = torch.linalg.matrix_exp(torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]])).numpy()
    matrix[:3, 3] = shift
    scaled = camera.transformed(np.diag([2.0, 2.0, 2.0, 1.0]))
    for start in (camera, scaled):
        there = dataclasses.replace(start, world_to_camera=matrix @ start.world_to_camera)
        expected = rasterize(scene(100), there, None, backend)
        out = rasterize(scene(100), start, None, backend, motion=torch.from_numpy(np.concatenate([turn, shift])))
        assert expected.alpha.max() > 0.2
        for name in ("rgb", "alpha", "depth", "features"):
            torch.testing.assert_close(getattr(out, name), getattr(expected, name), atol=2e-3, rtol=2e-3)
    with pytest.raises(ShapeError, match="motion"):
        rasterize(scene(3), camera, motion=torch.zeros(3))


@each_backend
@pytest.mark.parametrize("start", [0.0, 0.02])
def test_gradients_of_the_camera_against_finite_differences(backend, start):
    def loss(motion, name, dtype):
        out = rasterize(scene(60, dtype=dtype, size=0.03), orbit(24, 20), (0.5, 0.2, 0.1), name, motion=motion)
        return (out.rgb * torch.linspace(-1, 1, 24)[:, None]).sum() + out.depth.mean() + out.features.square().mean()

    motion = torch.full((6,), start, dtype=torch.float64, requires_grad=True)
    dtype = torch.float64 if backend == "torch" else torch.float32
    got = torch.autograd.grad(loss(motion, backend, dtype), motion)[0]
    step = 1e-6
    for k in range(6):
        delta = torch.zeros(6, dtype=torch.float64)
        delta[k] = step
        above, below = (loss(motion.detach() + sign * delta, "torch", torch.float64) for sign in (1, -1))
        expected = ((above - below) / (2 * step)).item()
        assert got[k].item() == pytest.approx(expected, rel=2e-3, abs=2e-3 * got.abs().max().item())


def test_the_cuda_backend_says_what_it_needs():
    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device")
    with pytest.raises(BackendError, match="CUDA"):
        rasterize(scene(2), CAMERA, backend="cuda")
