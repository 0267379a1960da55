"""Tracked photos to an avatar: stage 1 (`code_stage`), stage 2 (`decoder_stage`), their progress, cancelling and resuming.

Called by `api` and the evaluation. Imports torch.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..avatar import Avatar
from ..controls.names import ALIGNED_NAMES
from ..errors import ConfigError, SessionError
from ..files.access import atomic_write_bytes
from ..geometry.libraries import to_numpy
from ..head import HeadModel
from ..jobs.progress import Reporter
from ..jobs.stages import FIT
from ..light.relight import to_linear
from ..light.resting import Texels, mouth_rows
from ..model.grmm import GRMM, Picture
from ..model.inputs import ModelInputs
from ..model.weights_file import WeightsInfo
from ..pictures.images import encode_png, quantize
from ..pictures.sampling import bilinear
from ..training.losses import Perceptual
from .checkpoint import codes_key, decoders_key, load_codes, resume_tuner, save_codes, save_tuner
from .code_stage import Codes, code_prior, fit_codes
from .decoder_stage import Tuner, start_colors
from .folder import PREVIEW_FILE
from .local_light import local_lights
from .locality import LOCALITY_WEIGHT
from .objective import decode, draw, relit
from .person_lights import found_lights, kept_lights, trust_in
from .photo_light import FACING, Light, Seen, Shown, seen_texels
from .photo_targets import FitView, aligned_weights, bare_pixels, fit_view
from .presets import Preset, preset_named
from .recoloring import PhotoLight, recolor
from .result import LIGHT, make_avatar, photo_light
from .surface import Surface, texel_surface
from .types import PhotoTrack

CODES, DECODERS = "codes", "decoders"  # stages of `jobs.stages.FIT`
SAVE_SECONDS = 20.0
PREVIEW_SECONDS = 2.0
MEASURED_SIDE = 512
_GREY = 0.5

logger = logging.getLogger(__name__)


def invert(
    tracks: Sequence[PhotoTrack],
    model: GRMM,
    head: HeadModel,
    preset: str | Preset = "standard",
    *,
    info: WeightsInfo | None = None,
    name: str = "Person",
    work: Path | None = None,
    report: Reporter | None = None,
    second_stage: bool = True,
    locality: float = LOCALITY_WEIGHT,
    perceptual: Perceptual | None = None,
    on_codes: Callable[[Avatar], None] | None = None,
) -> Avatar:
    """Fit codes and decoders to tracked photos of one person.

    Args:
        tracks: Photos, the one whose light the avatar shall have first.
        model: Trained model on any device; it is not changed.
        head: The model's head.
        preset: "fast", "standard", "high", or settings.
        info: What the weights file says; its training people are the prior of z_id.
        name: Display name of the avatar.
        work: Folder for the state, from which the same call goes on; None keeps none.
        report: Hears of the stages "codes" and "decoders", with pictures where there is a work folder; on its wish to stop
            the work ends with the state saved.
        second_stage: False stops after eq. 19 (the ablation).
        locality: lambda_loc of eq. 20; 0 leaves it out (the ablation).
        perceptual: Network of eq. 16's L_perc, or None to leave it out.
        on_codes: Called between the stages with the avatar of the first, in the photos' lights.

    Raises:
        ConfigError: No photo, no such preset, or the weights' information is missing.
        CancelledError: `report` wanted to stop.
        SessionError: Out of memory.
        FileAccessError: The work folder cannot be written.
    """
    if not tracks or info is None:
        raise ConfigError("An avatar is made from at least one tracked photo and trained weights; give both.")
    if head is not model.head_model and head.name != model.head_model.name:
        raise ConfigError(f"The photos were tracked with the head {head.name!r}, the weights belong to another; use theirs.")
    settings = preset_named(preset) if isinstance(preset, str) else preset
    try:
        with torch.enable_grad():
            return _Inversion(
                tracks, model, settings, info, name, work, report or Reporter(FIT), second_stage, locality, perceptual, on_codes
            ).run()
    except (MemoryError, torch.OutOfMemoryError) as error:
        raise _out_of_memory() from error
    except RuntimeError as error:  # torch reports a failed allocation on the CPU as a plain RuntimeError
        if "alloc" not in str(error):
            raise
        raise _out_of_memory() from error


def _out_of_memory() -> SessionError:
    return SessionError("Fitting ran out of memory; choose the preset fast, fewer photos, or close other programs.")


class _Inversion:
    """One run of `invert`."""

    def __init__(
        self, tracks: Sequence[PhotoTrack], model: GRMM, preset: Preset, info: WeightsInfo, name: str, work: Path | None,
        report: Reporter, second_stage: bool, locality: float, perceptual: Perceptual | None,
        on_codes: Callable[[Avatar], None] | None,
    ) -> None:  # fmt: skip
        self.tracks, self.model, self.preset, self.info, self.name = tracks, model, preset, info, name
        self.work, self.second_stage, self.locality, self.perceptual = work, second_stage, locality, perceptual
        self.on_codes = on_codes
        self.codes_key = codes_key(tracks, info, preset)
        self.decoders_key = decoders_key(self.codes_key, preset, locality)
        self.report, self.shown = report, 0.0  # when a picture was made last
        self.saved = time.monotonic()

    def run(self) -> Avatar:
        """Do what is left of the job."""
        was = [parameter.requires_grad for parameter in self.model.parameters()]
        self.model.requires_grad_(False)
        try:
            surface = texel_surface(self.model)
            views = self.views(self.preset.decoders.levels[0][0])
            pictures = [(view.camera, view.image.cpu().numpy(), bare_pixels(view)) for view in views]
            lights, ratios, doubt = found_lights(self.model.head_model, self.model.layout, self.tracks, pictures)
            codes = self._codes(surface, PhotoLight.of(self.model, ratios, trust_in(doubt)))
            light, lights = self._light(codes, surface, lights, doubt)
            if self.on_codes is not None or not self.second_stage:
                tinted = self._avatar(codes, self._tint_only(codes, surface), lights)
            if self.on_codes is not None:
                self.on_codes(tinted)
            if not self.second_stage:
                self.report(DECODERS, 1.0)
                return tinted
            avatar = self._avatar(codes, self._decoders(codes, surface, light), lights)
            self.report(DECODERS, 1.0)
            return avatar
        finally:
            for parameter, needed in zip(self.model.parameters(), was, strict=True):
                parameter.requires_grad_(needed)

    def views(self, side: int) -> list[FitView]:
        """The photos at a size."""
        return photo_views(self.model, self.tracks, side)

    def _codes(self, surface: Surface, light: PhotoLight) -> Codes:
        like = self.model.anchor.barycentric
        known = None if self.work is None else load_codes(self.work, self.codes_key, like)
        if known is not None:
            logger.info("the codes are known from before")
            return known
        settings = self.preset.codes
        views = [view.through_lenses() for view in self.views(settings.side)]
        small = [view.through_lenses() for view in self.views(settings.small_side)]

        def tick(share: float, drawn: Picture | None) -> None:
            self._tell(CODES, share, views[0], drawn)
            self.report.check()

        identity = self.tracks[0].identity
        begun = None if identity is None else torch.as_tensor(np.array(identity)).to(like)
        codes = fit_codes(
            self.model, code_prior(self.info, self.model), views, small, surface, light, settings,
            tick, self.perceptual, begun,
        )  # fmt: skip
        if self.work is not None:
            save_codes(self.work, self.codes_key, codes)
        return codes

    def _light(
        self, codes: Codes, surface: Surface, lights: Sequence[Light], doubt: np.ndarray
    ) -> tuple[PhotoLight, list[Light]]:  # fmt: skip
        """The photos' lights on the person of the codes, as a session has them there, and with what lies on the skin."""
        model, views = self.model, self.views(self.preset.decoders.levels[0][0])
        with torch.no_grad():
            posed = [codes.inputs(model, view) for view in views]
            frontal = _frontal(model, codes.z_id)
            colors = recolor(frontal, codes.maps, surface)
            light = _lights_on(model, self.tracks, lights, posed, codes.z_exp, colors, trust_in(doubt))
            if "face" not in model.head_model.regions:  # what is light and what is color cannot be told
                return light, list(lights)
            flat = to_linear(to_numpy(start_colors(frontal, codes, surface)).astype(np.float64))
            texels = model.lit_texels
            seen = [
                seen_in(model, texels, inputs, view).of_skin(model.head_model, texels)
                for inputs, view in zip(posed, views, strict=True)
            ]
        local, told = local_lights(model.head_model, texels, seen, list(light.ratios()), np.asarray(flat), doubt)
        lights = [one._replace(local=own) for one, own in zip(lights, local, strict=True)]
        factors, mouth = [texels.factor(own) for own in local], mouth_rows(model.head_model, texels.corners)
        return light.times(np.stack(factors), told, mouth, [one.known for one in lights]), lights

    def _decoders(self, codes: Codes, surface: Surface, light: PhotoLight) -> dict[str, Tensor]:
        settings = self.preset.decoders
        levels = [self.views(side) for side, _ in settings.levels]
        prior = code_prior(self.info, self.model)
        tuner = Tuner(self.model, prior, codes, levels, surface, light, settings, self.locality, self.perceptual)
        if self.work is not None and resume_tuner(self.work, self.decoders_key, tuner):
            logger.info("going on after step %d of %d", tuner.step_count, tuner.total)

        def tick(share: float, drawn: Picture | None) -> None:
            level, index = tuner.last_drawn
            self._tell(DECODERS, share, levels[level][index], drawn)
            if self.report.wants_to_stop or time.monotonic() - self.saved > SAVE_SECONDS:
                self._save(tuner)
            self.report.check()

        tuner.run(tick)
        self._save(tuner)
        return tuner.changes()

    def _save(self, tuner: Tuner) -> None:
        if self.work is not None:
            save_tuner(self.work, self.decoders_key, tuner)
        self.saved = time.monotonic()

    def _avatar(self, codes: Codes, deltas: dict[str, Tensor], lights: Sequence[Light]) -> Avatar:
        views = self.views(self.preset.decoders.levels[-1][0])
        tracking = {"aligned": torch.stack([view.aligned for view in views]), "z_exp": codes.photo_z_exp}
        arrays = {name: value.cpu().numpy() for name, value in tracking.items()}
        light = {name: np.stack([getattr(light, name) for light in lights]) for name in Light._fields}
        arrays |= {LIGHT + name: values for name, values in light.items() if values.size}
        return make_avatar(
            self.name, self.tracks, self.info, codes.z_id.cpu().numpy(), codes.z_exp.cpu().numpy(),
            {name: value.cpu().numpy() for name, value in deltas.items()}, arrays,
        )  # fmt: skip

    def _tint_only(self, codes: Codes, surface: Surface) -> dict[str, Tensor]:
        """Changes that make an avatar of stage 1: the color maps alone."""
        model, view = self.model, self.views(self.preset.codes.side)[0]
        with torch.no_grad():
            colors = decode(model, codes.inputs(model, view), view.camera).colors
            tint = recolor(colors, codes.maps, surface) - colors
            return {"decoders.appearance_mean": torch.cat([tint, tint.new_zeros(len(tint), model.config.features)], 1)}

    def _tell(self, stage: str, share: float, view: FitView, drawn: Picture | None) -> None:
        """Report, every few seconds with the photo and the avatar beside it."""
        picture, now = "", time.monotonic()
        if drawn is not None and self.work is not None and self.report.has_listener and now - self.shown > PREVIEW_SECONDS:
            path = self.work / PREVIEW_FILE
            atomic_write_bytes(path, encode_png(preview(view, drawn)))
            picture, self.shown = str(path), now
        self.report(stage, share, picture=picture)


def photo_views(model: GRMM, tracks: Sequence[PhotoTrack], side: int = MEASURED_SIDE) -> list[FitView]:
    """Tracked photos as targets for a model, with so many pixels along the longer side."""
    kind = len(ALIGNED_NAMES), model.dtype, model.device, model.config.hairless
    return [fit_view(track, model.head_model, index, side, *kind) for index, track in enumerate(tracks)]


def seen_in(
    model: GRMM, texels: Texels, inputs: ModelInputs[Tensor], view: FitView, picture: np.ndarray | None = None,
    counts: np.ndarray | float = 1.0, least: float = FACING,
) -> Seen:  # fmt: skip
    """What a photo, or another picture of its view, shows of the head that no hair covers: skin, lips and eyes.

    Args:
        model: Model.
        texels: `GRMM.lit_texels`.
        inputs: As the photo shows the person.
        view: The photo.
        picture: Display sRGB, [H, W, 3]; None: the photo's.
        counts: How much pixels count besides, [H, W].
        least: As of `seen_texels`.
    """
    mesh, shown = to_numpy(model.mesh(inputs).vertices), view.image.cpu().numpy() if picture is None else picture
    pixels, weights = seen_texels(model.head_model, texels, mesh, view.camera, bare_pixels(view) * counts, least)
    return Seen(bilinear(shown, pixels), weights)


def photo_model_inputs(
    model: GRMM, avatar: Avatar, track: PhotoTrack, index: int = 0
) -> tuple[ModelInputs[Tensor], ModelInputs[Tensor]]:  # fmt: skip
    """Inputs that draw an avatar as one of its photos shows it, and those of the person at rest."""

    def tensor(values: np.ndarray) -> Tensor:
        return torch.as_tensor(np.array(values), device=model.device, dtype=model.dtype)

    z_id, shared, own = (tensor(part) for part in (avatar.z_id, avatar.z_exp, avatar.tracking["z_exp"][index]))
    turned = model.head_model.pose_of(track.expression, track.pose)
    expression, pose, shape = (tensor(part) for part in (track.expression, turned, track.shape))
    aligned = tensor(aligned_weights(track.expression, model.head_model, len(ALIGNED_NAMES)))
    posed = model.performed(z_id, shape, expression, pose, aligned, shared + own)
    return posed, _resting(model, posed, shared)


def _resting(model: GRMM, posed: ModelInputs[Tensor], shared: Tensor) -> ModelInputs[Tensor]:
    """Inputs of the person of a photo at rest, with what all photos add to the expression code, [Y]."""
    expression, pose = torch.zeros_like(posed.expression), torch.zeros_like(posed.pose)
    nothing = torch.zeros(len(ALIGNED_NAMES)).to(expression)
    return model.performed(posed.z_id, posed.shape, expression, pose, nothing, shared)


def _frontal(model: GRMM, z_id: Tensor) -> Tensor:
    """Colors as they look from the front, which say what skin throws back, [N, 3]."""
    return model.appearance(z_id, torch.tensor([0.0, 0.0, 1.0]).to(z_id))[0]


def _lights_on(
    model: GRMM, tracks: Sequence[PhotoTrack], lights: Sequence[Light], posed: Sequence[ModelInputs[Tensor]], shared: Tensor,
    colors: Tensor, trust: np.ndarray | None = None,
) -> PhotoLight:  # fmt: skip
    """Lights of photos on the person whom a model draws.

    Args:
        model: Model.
        tracks: Photos.
        lights: Of each.
        posed: Inputs of each.
        shared: What all photos add to the expression code, [Y].
        colors: Of the person, [N, 3].
        trust: As `PhotoLight` has it; None: photos are drawn only.
    """

    def mesh(inputs: ModelInputs[Tensor]) -> np.ndarray:
        return to_numpy(model.mesh(inputs).vertices).astype(np.float64)

    shown = [Shown(mesh(_resting(model, inputs, shared)), mesh(inputs)) for inputs in posed]
    spread = kept_lights(model.head_model, model.layout, tracks, lights, shown, to_numpy(colors))
    return PhotoLight.of(model, spread, np.ones(len(tracks)) if trust is None else trust)


def photo_pictures(
    model: GRMM, avatar: Avatar, tracks: Sequence[PhotoTrack], side: int = MEASURED_SIDE, *, lit: bool = True
) -> list[tuple[FitView, Picture]]:
    """An avatar drawn as each of its photos shows it, in that photo's light.

    Args:
        model: With the avatar's own changes (`model.torch_loader.with_deltas`).
        avatar: Fitted to these photos.
        tracks: Photos.
        side: Longer side of the picture.
        lit: False: in the studio's light.
    """
    pictures: list[tuple[FitView, Picture]] = []
    known = [photo_light(avatar, index) for index in range(len(tracks))]
    shared = torch.as_tensor(np.array(avatar.z_exp)).to(model.anchor.barycentric)
    with torch.no_grad():
        posed = [photo_model_inputs(model, avatar, track, index)[0] for index, track in enumerate(tracks)]
        lights = _lights_on(model, tracks, known, posed, shared, _frontal(model, posed[0].z_id)) if lit else None
        for view, inputs in zip(photo_views(model, tracks, side), posed, strict=True):
            vertices, decoded = model.mesh(inputs).vertices, decode(model, inputs, view.camera)
            drawn = draw(model, view.camera, vertices, decoded)
            pictures.append((view, drawn if lights is None else relit(drawn, lights.picture(model, view, vertices, decoded))))
    return pictures


def photo_error(view: FitView, drawn: Picture) -> float:
    """RMSE of a person drawn in a photo's view, on head and bare neck (`FitView.measured`)."""
    grey = torch.full((3,), _GREY).to(drawn.image)
    error = (drawn.over(grey).image.clamp(0, 1) - view.target(grey)).square().mean(-1) * view.measured
    return float((error.sum() / view.measured.sum().clamp(min=1.0)).sqrt())


def preview(view: FitView, drawn: Picture) -> np.ndarray:
    """The photo and, beside it, the avatar in its place, [H, 2 W, 3] uint8."""
    behind = (1.0 - drawn.alpha)[..., None] * view.image
    both = torch.cat([view.image, drawn.image + behind], 1)
    return quantize(both.detach().cpu().numpy())
