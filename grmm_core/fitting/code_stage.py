"""Stage 1 (eq. 19): the codes z_id and z_exp with the decoders fixed.

z_id is sought in the Gaussian of the training people's codes, z_id = mean + sum_k w_k s_k u_k, and L_z is the squared length
of w: what no photo shows then is what people of the training set have. z_exp of a photo is the code of its tracked expression
plus an offset that all photos share (the avatar's own) plus a small one of the photo. Several starts: the training people
whose recolored pictures come nearest, and the mean.

Called by `invert`. Imports torch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..model.grmm import GRMM, Attributes, Picture
from ..model.inputs import ModelInputs
from ..model.weights_file import WeightsInfo
from ..training.losses import Perceptual
from .adam import Adam
from .objective import FIT_WEIGHTS, decode, draw, fit_loss, photo_inputs, relit
from .photo_targets import FitView
from .presets import CodeSettings
from .recoloring import PhotoLight, recolor, solve_maps, unchanged
from .surface import Surface

OUTLINE_WEIGHT, START_OUTLINE_WEIGHT = 1.0, 2.0  # of the coverage: codes decide how much hair there is, and how long
CODE_WEIGHT = 4e-4  # of |w|^2 (standard deviations); eq. 17 has 0.001 for codes without such a scale
EXPRESSION_WEIGHT = 0.02  # of the squared offsets of z_exp
PHOTO_WEIGHT = 0.05  # of the squared offsets of single photos
CODE_WEIGHTS = replace(FIT_WEIGHTS, alpha=OUTLINE_WEIGHT)
RATE, EXPRESSION_RATE = 0.12, 0.02
RECOLOR_EVERY = 6
WARM = 0.25  # the rates grow over this share of the steps

Tick = Callable[[float, "Picture | None"], None]
"""Called with the share done and sometimes a picture; raises `CancelledError` to stop."""


@dataclass(frozen=True)
class CodePrior:
    """Gaussian of the training people's codes.

    Attributes:
        mean: [Z].
        directions: Principal directions times their standard deviation, [R, Z].
        people: The training people in it, [P, R].
    """

    mean: Tensor
    directions: Tensor
    people: Tensor

    def code(self, w: Tensor) -> Tensor:
        """z_id [Z] of a person who is w [R] standard deviations along the principal directions."""
        return self.mean + w @ self.directions

    def deviations(self, z_id: Tensor) -> Tensor:
        """The nearest w [R] of a code [Z]."""
        return (z_id - self.mean) @ torch.linalg.pinv(self.directions)


def code_prior(info: WeightsInfo, model: GRMM) -> CodePrior:
    """Fit the Gaussian; of fewer than two people it is a point, the default avatar's code."""
    table = torch.tensor(info.z_id, dtype=model.dtype, device=model.device)
    if len(table) < 2:
        mean = torch.tensor(info.default_z_id, dtype=model.dtype, device=model.device)
        return CodePrior(mean, mean.new_zeros((0, len(mean))), mean.new_zeros((1, 0)))
    mean = table.mean(0)
    _, singular, right = torch.linalg.svd(table - mean, full_matrices=False)
    keep = singular > singular[0] * 1e-3
    scale = singular[keep] / (len(table) - 1) ** 0.5
    directions = right[keep] * scale[:, None]
    return CodePrior(mean, directions, (table - mean) @ (right[keep] / scale[:, None]).T)


@dataclass(frozen=True)
class Codes:
    """Result of stage 1.

    Attributes:
        z_id: [Z].
        z_exp: Offset that all photos share, [Y].
        photo_z_exp: Further offset of each photo, [P, Y].
        maps: Color maps of the groups, [3, 4, 3].
    """

    z_id: Tensor
    z_exp: Tensor
    photo_z_exp: Tensor
    maps: Tensor

    def inputs(self, model: GRMM, view: FitView) -> ModelInputs[Tensor]:
        """The model's inputs for a photo: its tracked frame with the shared identity code and its own expression code."""
        return photo_inputs(model, view, self.z_id, self.z_exp + self.photo_z_exp[view.index])


def fit_codes(
    model: GRMM, prior: CodePrior, views: Sequence[FitView], small: Sequence[FitView], surface: Surface,
    light: PhotoLight, settings: CodeSettings, tick: Tick, perceptual: Perceptual | None = None, begun: Tensor | None = None,
) -> Codes:  # fmt: skip
    """Minimise eq. 19.

    Args:
        model: Frozen.
        prior: Of z_id.
        views: Photos.
        small: The same at a lower resolution, for choosing the start.
        surface: Texels' groups.
        light: Of the photos.
        settings: Steps.
        tick: Progress.
        perceptual: Distance of two pictures, or None.
        begun: A z_id that was found before, [Z]; taken by settings that go on from one.
    """
    if not model.config.residuals:  # eq. 21: the tracked coefficients are the codes
        z_exp = prior.mean.new_zeros(model.z_exp_size)
        search = _Search(model, prior, views, surface, light, perceptual, fixed=views[0].shape)
        search.color()
        return Codes(views[0].shape, z_exp, z_exp.new_zeros((len(views), len(z_exp))), search.maps)
    share = 0.3 if settings.candidates else 0.0
    if begun is not None and settings.goes_on:
        share, settings = 0.0, replace(settings, starts=1, trial_steps=0)
        starts = [prior.deviations(begun)]
    else:
        starts = _starts(model, prior, small, surface, light, settings, lambda f: tick(share * f, None))
    total = settings.starts * settings.trial_steps + settings.steps
    done = 0
    searches = []
    for start in starts:
        search = _Search(model, prior, views, surface, light, perceptual, start)
        for step in range(settings.trial_steps):
            search.step(step, settings.trial_steps)
            done += 1
            tick(share + (1 - share) * done / total, None)
        searches.append((search.recent, search))
    best = min(searches, key=lambda item: item[0])[1]
    best.restart()
    for step in range(settings.steps):
        drawn = best.step(step, settings.steps)
        done += 1
        tick(share + (1 - share) * min(1.0, done / total), drawn if step % RECOLOR_EVERY == 0 else None)
    return best.codes()


def _starts(
    model: GRMM, prior: CodePrior, views: Sequence[FitView], surface: Surface, light: PhotoLight, settings: CodeSettings,
    report: Callable[[float], None],
) -> list[Tensor]:  # fmt: skip
    """The mean and the people whose recolored pictures of the first photo come nearest, each [R]."""
    people = prior.people
    if settings.candidates < len(people):
        people = people[torch.linspace(0, len(people) - 1, settings.candidates).round().long()]
    view, scored = views[0], []
    start_weights = replace(FIT_WEIGHTS, alpha=START_OUTLINE_WEIGHT)
    with torch.no_grad():
        for number, w in enumerate(people):
            vertices, decoded = _Search(model, prior, [view], surface, light, None, w).decoded(view)
            here = light.picture(model, view, vertices, decoded)
            maps = solve_maps(model, [view], [vertices], [decoded], surface, [here], torch.ones_like(light.trust[:1]))
            drawn = draw(model, view.camera, vertices, decoded.recolored(recolor(decoded.colors, maps, surface)))
            drawn = relit(drawn, here)
            scored.append((float(fit_loss(drawn, view, background(0, view), start_weights, None)), number))
            report((number + 1) / len(people))
    nearest = [people[number] for _, number in sorted(scored)]
    return [*nearest[: max(1, settings.starts - 1)], people.new_zeros(people.shape[1])][: settings.starts]


class _Search:
    """One optimisation from one start."""

    def __init__(
        self, model: GRMM, prior: CodePrior, views: Sequence[FitView], surface: Surface, light: PhotoLight,
        perceptual: Perceptual | None, start: Tensor | None = None, fixed: Tensor | None = None,
    ) -> None:  # fmt: skip
        self.model, self.prior, self.views, self.surface = model, prior, list(views), surface
        self.light, self.perceptual, self.fixed = light, perceptual, fixed
        self.maps = unchanged(prior.mean)
        self.w = (prior.mean.new_zeros(len(prior.directions)) if start is None else start).clone().requires_grad_()
        self.z_exp = prior.mean.new_zeros(model.z_exp_size).requires_grad_()
        self.photo = prior.mean.new_zeros((len(views), model.z_exp_size)).requires_grad_()
        self.lit: list[Tensor] = []  # by photo
        self.recent = float("inf")
        self.restart()

    def restart(self) -> None:
        """Forget the optimiser's moments."""
        groups = [{"params": [self.w], "peak": RATE}, {"params": [self.z_exp, self.photo], "peak": EXPRESSION_RATE}]
        self.optimiser = Adam(({**group, "lr": group["peak"]} for group in groups), betas=(0.9, 0.95))

    def decoded(self, view: FitView) -> tuple[Tensor, Attributes]:
        """Posed vertices [V, 3] and attributes for a photo, not recolored."""
        z_id = self.prior.code(self.w) if self.fixed is None else self.fixed
        inputs = photo_inputs(self.model, view, z_id, self.z_exp + self.photo[view.index])
        return self.model.mesh(inputs).vertices, decode(self.model, inputs, view.camera)

    @torch.no_grad()
    def color(self) -> None:
        """Solve the color maps for the present codes."""
        pairs = [self.decoded(view) for view in self.views]
        meshes, decoded = [vertices for vertices, _ in pairs], [attributes for _, attributes in pairs]
        self.lit = [self.light.picture(self.model, view, *pair) for view, pair in zip(self.views, pairs, strict=True)]
        self.maps = solve_maps(self.model, self.views, meshes, decoded, self.surface, self.lit, self.light.trust)

    def recolored(self, attributes: Attributes) -> Attributes:
        """Attributes with the colors that the maps give."""
        return attributes.recolored(recolor(attributes.colors, self.maps, self.surface))

    def loss(self, view: FitView, step: int = 0) -> tuple[Tensor, Picture]:
        """Eq. 19 of one photo."""
        vertices, attributes = self.decoded(view)
        drawn = draw(self.model, view.camera, vertices, self.recolored(attributes))
        drawn = relit(drawn, self.lit[view.index])
        value = fit_loss(drawn, view, background(step, view), CODE_WEIGHTS, self.perceptual) * self.light.trust[view.index]
        value = value + CODE_WEIGHT * self.w.square().sum() + EXPRESSION_WEIGHT * self.z_exp.square().sum()
        return value + PHOTO_WEIGHT * self.photo.square().sum(), drawn

    def step(self, step: int, steps: int) -> Picture:
        """One step on one photo, in turn. Returns the picture."""
        if step % RECOLOR_EVERY == 0:
            self.color()
        for group in self.optimiser.param_groups:
            group["lr"] = group["peak"] * min(1.0, (step + 1) / max(1.0, WARM * steps)) * min(1.0, 2.0 * (1.0 - step / steps))
        self.optimiser.zero_grad()
        loss, drawn = self.loss(self.views[step % len(self.views)], step)
        loss.backward()
        self.optimiser.step()
        value = float(loss.detach())
        self.recent = value if self.recent == float("inf") else 0.7 * self.recent + 0.3 * value
        return drawn

    def codes(self) -> Codes:
        """The result."""
        self.color()
        photo = self.photo.detach()
        # what all photos share belongs to the person
        shared = photo.mean(0) if len(photo) > 1 else torch.zeros_like(photo[0])
        return Codes(self.prior.code(self.w).detach(), (self.z_exp + shared).detach(), photo - shared, self.maps.detach())


def background(step: int, view: FitView) -> Tensor:
    """Color behind avatar and photo in a step, [3]: changing, so that coverage matters."""
    generator = torch.Generator().manual_seed(step)
    return torch.rand(3, generator=generator).to(view.image)
