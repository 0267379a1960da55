"""Stage 2 (eq. 20): the decoders are tuned to the photos while the codes stay, near the pretrained solution.

What is tuned: full-resolution maps of color, opacity, position and scale, added to the decoders' outputs (an avatar's own
mean maps), and in the larger presets the decoders' networks as well. The maps can show every texel that a photo shows; the
networks change all texels together. The refinement network stays.

What keeps the rest intact:

- `Locality`, the paper's L_loc after PTI (Roich et al. 2022): at random codes at a fixed distance from the fitted ones the
  tuned networks must decode what the frozen ones do.
- The maps are pulled to zero, more for skin than for hair, and at the end they are spread from texels that a photo shows to
  the others along the surface and across the plane of symmetry (`inpainting`): no border runs where the photo's view ends.

Called by `invert`. Imports torch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from ..geometry.libraries import present
from ..light.relight import unlit
from ..model.grmm import GRMM, Attributes, Picture
from ..model.parameters import EXPRESSION_MAPS
from ..training.losses import Perceptual
from .adam import Adam
from .agreement import agreement
from .code_stage import CodePrior, Codes, Tick, background
from .creases import Folding, bringing, crease_colors, folds_brought, own_colors, plain_skin, soft_folds
from .even_tint import even_tint
from .eye_colors import even_lash_line, eye_angles, plain_eyes
from .fold_light import FoldShade
from .inpainting import amid_own, corners_of, facing, fill_colors, gone_on, known_of, unclipped, uncut
from .lids import lash_line, lid_exposure, lid_share, plain_lids
from .locality import LOCALITY_WEIGHT, Locality, tunable_copy
from .objective import FIT_WEIGHTS, contributions, decode, draw, fit_loss, relit, spread_to_colors
from .photo_targets import FitView
from .presets import DecoderSettings
from .recoloring import PhotoLight, recolor
from .surface import INNER, SCALP, SKIN, Surface

NETWORKS = ("transform", "opacity", "appearance")
SURFACE_NETWORKS = ("appearance",)  # of a model without hair: its skin is a closed surface, and stays one
RATES = {"color": 0.012, "opacity": 0.06, "position": 0.012, "scale": 0.02, "networks": 3e-4}
END_RATE = 0.15
PULL = {  # of squared maps in skin, scalp, inner parts; positions in 10 mm
    "color": (0.02, 0.02, 0.05), "opacity": (0.05, 0.002, 0.02), "position": (4.0, 0.02, 8.0), "scale": (0.2, 0.02, 0.4),
}  # fmt: skip
BLENDS = {"color": 1, "opacity": 2, "position": 3, "scale": 2}
"""How often a map is averaged with its neighbours before it is added. Several Gaussians make a pixel: without this, colors
that cancel out in the photo would be found, and come out as speckles where another expression moves the Gaussians."""
SHARPNESS = 0.5  # share of the colors' map that is added as it is: averaged alone it could not hold fine detail
POSITION_MM = 10.0  # that a map of 1 moves a Gaussian
SCALP_STRIDE = 8.0  # positions of hair go so much faster than those of skin: hair stands centimetres off
VARIANTS, VARIANT_SHARE = 2, 0.5  # other expressions' codes in every second step, and how far towards them
TRUSTED = ("color", "opacity")  # maps that texels of the skin take from photos that face them only
WIDTHS = {"color": 3, "opacity": 1, "position": 3, "scale": 3}
DETAIL_TEXELS = 5.0  # length below which colors are detail
CUT = (0.3, 0.7)  # share of a texel's pixels that are targets: below the first it counts as not seen, above the second wholly
HALF_SEEN_PIXELS = 0.5  # contribution, in pixels, at which a texel counts as half seen
HALF_SEEN_FINE = 0.08  # likewise of eyes, lids, mouth and lips, which have several texels a pixel
SHAPE_REST = 0.05  # pulls unseen shapes back to the prior faster than colors
REFINED_EVERY = 3  # steps of which one has the refined picture's term of eq. 20, the others the splatted one's
LOCALITY_EVERY = 2  # steps of which one has L_loc, with that much more weight: decoding at another code is a third of a step
COLOR_ROUNDS, LAST_ROUNDS = 3, 6  # of `Tuner.match_colors` at the beginning of each level, and at the end
_NEVER_SEEN = 1e-3  # so little texels count as seen that no photo shows
OWN_ROUNDS, AGREEING_ROUNDS = 8, 4  # of `Tuner.differences`: at the end, and to find out which photos are believed where


def start_colors(colors: Tensor, codes: Codes, surface: Surface) -> Tensor:
    """Stage 1's colors with the skin smoothed: freckles are the training people's, and this person's come from the photo.

    Freckles that were only painted over would come out where an expression moves the Gaussians, since several make a pixel.
    """
    recolored = recolor(colors, codes.maps, surface)
    even = surface.smooth(recolored, DETAIL_TEXELS)
    return torch.where((surface.group == SKIN)[:, None], even, recolored)


class Tuner:
    """The optimisation of stage 2; its state can be saved at any step.

    Args:
        model: Frozen.
        prior: For the locality's random codes.
        codes: Result of stage 1.
        levels: The photos at each level's size.
        surface: Texels.
        light: Of the photos.
        settings: Steps, and whether networks are tuned.
        locality: Factor of L_loc; 0 leaves it out (the ablation).
        perceptual: Distance of two pictures, or None.
    """

    def __init__(
        self, model: GRMM, prior: CodePrior, codes: Codes, levels: Sequence[Sequence[FitView]], surface: Surface,
        light: PhotoLight, settings: DecoderSettings, locality: float = LOCALITY_WEIGHT, perceptual: Perceptual | None = None,
    ) -> None:  # fmt: skip
        self.model, self.codes, self.surface, self.light, self.settings = model, codes, surface, light, settings
        self.levels, self.perceptual, self.locality_weight = [list(level) for level in levels], perceptual, locality
        self.networks = SURFACE_NETWORKS if model.config.hairless else NETWORKS
        self.tuned = tunable_copy(model, self.networks) if settings.networks else model
        self.step_count = 0
        self._lit: dict[tuple[int, int], Tensor] = {}
        self.last_drawn = (0, 0)  # level and photo
        first = self.levels[0]
        with torch.no_grad():
            self.inputs = [codes.inputs(model, view) for view in first]
            self.meshes = [model.mesh(inputs).vertices for inputs in self.inputs]
            self.decoded = [decode(model, inputs, view.camera) for inputs, view in zip(self.inputs, first, strict=True)]
            mean_person = replace(self.inputs[0], z_id=prior.mean, z_exp=torch.zeros_like(self.inputs[0].z_exp))
            self.mean_person = decode(model, mean_person, first[0].camera).colors
            self.tint = start_colors(self.decoded[0].colors, codes, surface) - self.decoded[0].colors  # [N, 3]
        count = model.gaussian_count
        self.maps = {
            name: torch.zeros(count, width, dtype=model.dtype, device=model.device, requires_grad=True)
            for name, width in WIDTHS.items()
        }
        strides = torch.where(surface.group == SCALP, SCALP_STRIDE, 1.0) * (POSITION_MM / model.config.position_unit_mm)
        self.strides = strides.to(self.tint)[:, None]
        self.variants = self._variants(prior.mean)
        pulls = {name: torch.tensor([PULL[name][g] for g in (SKIN, SCALP, INNER)]).to(self.tint) for name in WIDTHS}
        self.pulls = {name: pull[surface.group][:, None] for name, pull in pulls.items()}  # [N, 1]
        rates = {**RATES, "opacity": 0.0} if model.config.hairless else RATES
        groups = [{"params": [value], "peak": rates[name]} for name, value in self.maps.items()]
        if settings.networks:
            groups.append({"params": self.network_parameters(), "peak": RATES["networks"]})
            self.locality = Locality(model, prior, codes, first[0]) if locality else None
        else:
            self.locality = None
        self.optimiser = Adam(({**g, "lr": g["peak"]} for g in groups), betas=(0.9, 0.98), eps=1e-12)
        zeros = torch.zeros(count, dtype=model.dtype, device=model.device)
        self.parts = (surface.group == INNER) | surface.lips
        lids = torch.as_tensor(model.head_model.marked("lids")[corners_of(model)].all(1)).to(self.parts)
        offsets = torch.stack([inputs.z_exp for inputs in self.inputs]) - codes.z_exp
        self.folding = Folding(model, surface, first, self.parts, codes.z_id, offsets)
        self.half_seen = torch.where(self.parts | lids, HALF_SEEN_FINE, HALF_SEEN_PIXELS).to(zeros)
        self.seen, self.seen_rim, self.seen_shape, self.seen_by = zeros, zeros, zeros, [zeros] * len(first)
        self.frontal_by = [torch.ones_like(zeros)] * len(first)
        self.believed = torch.ones(len(first), count).to(zeros)  # `agreement`

    @property
    def total(self) -> int:
        """Steps of all resolutions together; `step_count` ends there."""
        return sum(steps for _, steps in self.settings.levels)

    def network_parameters(self) -> list[Tensor]:
        """Parameters of those decoders that may change; the others stay as they were trained."""
        return [p for name in self.networks for p in getattr(self.tuned.decoders, name).parameters()]

    def _variants(self, like: Tensor) -> list[list[tuple[Tensor, Tensor]]]:
        """For each photo expression codes other than its own, and the offsets that they give.

        They are drawn on the photo's mesh: skin must look the same however an expression moves the Gaussians a little.
        The first is that of the neutral face.
        """
        generator = torch.Generator().manual_seed(1)
        variants = []
        for inputs in self.inputs:
            own = inputs.z_exp
            others = [self.codes.z_exp] if self.model.config.residuals else [torch.zeros_like(own)]
            for _ in range(VARIANTS - 1):
                if self.model.aligned_codes is None:
                    break
                pick = int(torch.randint(len(self.model.aligned_codes), (1,), generator=generator))
                others.append(own + VARIANT_SHARE * self.model.aligned_codes[pick].detach().to(like))
            variants.append([(code, self.model.offsets(inputs.z_id, code).detach()) for code in others])
        return variants

    def lit(self, level: int, index: int) -> Tensor:
        """A photo's light, [H, W, 3]."""
        if (level, index) not in self._lit:
            view = self.levels[level][index]
            self._lit[level, index] = self.light.picture(self.model, view, self.meshes[index], self.decoded[index])
        return self._lit[level, index]

    def attributes(self, index: int, variant: int | None = None) -> Attributes:
        """Attributes of a photo's expression, or of one of its variants, with the maps."""
        base, inputs = self.decoded[index], self.inputs[index]
        if variant is not None:
            code, offsets = self.variants[index][variant % len(self.variants[index])]
            base, inputs = replace(base, offsets=offsets), replace(inputs, z_exp=code)
        if self.settings.networks:
            base = decode(self.tuned, inputs, self.levels[0][index].camera)
        return self.changed(base)

    def blended(self) -> dict[str, Tensor]:
        """The maps as they are added to attributes, [N, C]: averaged over neighbours (`BLENDS`), positions in metres."""
        result = {**self.maps, "position": self.maps["position"] * self.strides}
        for turn in range(max(BLENDS.values())):
            names = [name for name in result if BLENDS[name] > turn]
            widths = [result[name].shape[1] for name in names]
            parts = self.surface.average(torch.cat([result[name] for name in names], 1)).split(widths, 1)
            result |= dict(zip(names, parts, strict=True))
        result["color"] = result["color"].lerp(self.maps["color"], SHARPNESS)
        return result

    def changed(self, base: Attributes) -> Attributes:
        """Decoded attributes plus the maps, so that what the photos show follows every expression."""
        maps = self.blended()
        zero = torch.zeros_like(base.offsets[:, 3:7])
        return Attributes(
            base.offsets + torch.cat([maps["position"], zero, maps["scale"]], 1), base.logits + maps["opacity"][:, 0],
            base.colors + self.tint + maps["color"], base.features,
        )  # fmt: skip

    def run(self, tick: Tick) -> None:
        """Do the steps that are left; `tick` may raise `CancelledError`."""
        while self.step_count < self.total:
            level, start = self._level()
            if self.step_count == start:
                self.look_around(level)
                if level == 0 and len(self.inputs) > 1:
                    self.compare_photos(level)
                self.match_colors(level, COLOR_ROUNDS)
            drawn = self.step(level)
            tick(self.step_count / self.total, drawn if self.step_count % 8 == 1 else None)
        self.look_around(len(self.levels) - 1)
        self.match_colors(len(self.levels) - 1, LAST_ROUNDS)

    def _level(self) -> tuple[int, int]:
        start = 0
        for number, (_, steps) in enumerate(self.settings.levels):
            if self.step_count < start + steps:
                return number, start
            start += steps
        return len(self.settings.levels) - 1, start

    def step(self, level: int) -> Picture:
        """One step on one photo, in turn. Returns the picture."""
        progress = self.step_count / self.total
        factor = min(1.0, (self.step_count + 1) / 4) * (END_RATE + (1 - END_RATE) * (1 - progress))
        for group in self.optimiser.param_groups:
            group["lr"] = group["peak"] * factor
        index = self.step_count % len(self.inputs)
        self.last_drawn = (level, index)
        turn = self.step_count // len(self.inputs)
        refined = turn % REFINED_EVERY == REFINED_EVERY - 1
        variant = turn // 2 if turn % 2 else None
        view = self.levels[level][index]
        self.optimiser.zero_grad()
        drawn = draw(self.model, view.camera, self.meshes[index], self.attributes(index, variant), refined)
        drawn = relit(drawn, self.lit(level, index))
        pictures = ("image",) if refined else ("raw",)
        loss = fit_loss(drawn, view, background(self.step_count, view), FIT_WEIGHTS, self.perceptual, pictures)
        if self.locality is not None and self.step_count % LOCALITY_EVERY == 0:
            loss = loss + self.locality_weight * LOCALITY_EVERY * self.locality(self.tuned, self.step_count // LOCALITY_EVERY)
        loss.backward()
        with torch.no_grad():
            for name, value in self.maps.items():
                gradient = present(value.grad)
                if name in TRUSTED:  # a grazing view of skin shows what is behind it as well
                    gradient *= self.frontal_by[index][:, None]
                if name == "color":
                    gradient *= (self.folding.calm[index] * self._beside(index))[:, None]
                gradient.addcmul_(self.pulls[name], value, value=2.0 / len(value))  # of the mean of pull * value^2
        self.optimiser.step()
        self.step_count += 1
        return drawn.detached()

    def _beside(self, index: int) -> Tensor:
        """How much a photo tells of the texels' colors beside the one that tells most, 0..1, [N]; 1 where none does."""
        shares = self._shares(torch.stack(self.seen_by) + _NEVER_SEEN)
        return shares[index] / shares.amax(0)

    @torch.no_grad()
    def match_colors(self, level: int, rounds: int) -> None:
        """Bring every shown Gaussian's color nearer to the photos at once (see `spread_to_colors`)."""
        every = torch.stack(self.seen_by) * self.folding.calm  # [P, N]
        told, shares = every.amax(0)[:, None], self._shares(every)
        for turn in range(rounds):
            variant = turn if turn < rounds - 1 else None
            change = torch.zeros_like(self.tint)
            for index in range(len(self.levels[level])):
                change += shares[index, :, None] * self._color_step(level, index, self.attributes(index, variant))
            self.maps["color"] += told * change

    @torch.no_grad()
    def compare_photos(self, level: int) -> None:
        """Find out which photos to believe where (`agreement`), on skin: lips and eyes move too much between photos."""
        self.match_colors(level, COLOR_ROUNDS)
        shared = self.blended()["color"]
        alone = torch.stack([shared + own for own in self.differences(level, AGREEING_ROUNDS)])
        self.believed = torch.where(self.parts, 1.0, agreement(self.surface, alone, torch.stack(self.seen_by)))
        self.maps["color"].zero_()
        self.look_around(level)

    def _shares(self, told: Tensor) -> Tensor:
        """Shares of the photos in the texels' colors, by what each tells and the variance of its light, both [P, N]."""
        counted = told * self.light.trust[:, None].square()
        shares: Tensor = counted / counted.sum(0).clamp(min=1e-9)
        return shares

    def _color_step(self, level: int, index: int, attributes: Attributes) -> Tensor:
        """Change of the colors that brings a picture nearer to its photo, [N, 3]."""
        view, light = self.levels[level][index], self.lit(level, index)
        drawn = draw(self.model, view.camera, self.meshes[index], attributes)
        shown = 0.5 * (drawn.image + drawn.raw)
        excess = view.excess(relit(drawn, light).image)
        both = torch.where(excess > 0.0, 0.0, unlit(view.image, light) * drawn.alpha[..., None] - shown)
        return spread_to_colors(self.model, view, self.meshes[index], attributes, both * view.inside[..., None])

    def differences(self, level: int = -1, rounds: int = OWN_ROUNDS) -> list[Tensor]:
        """What each photo shows at a level otherwise than the colors that all share, [N, 3]."""
        level, found = range(len(self.levels))[level], []
        for index in range(len(self.inputs)):
            base, own = self.attributes(index), torch.zeros_like(self.tint)
            for _ in range(rounds):
                step = self._color_step(level, index, base.recolored(base.colors + own))
                own = own + self.seen_by[index][:, None] * step
            found.append(own)
        return found

    @torch.no_grad()
    def look_around(self, level: int) -> None:
        """Find out what each photo shows now; what was shown once stays known."""
        for index, view in enumerate(self.levels[level]):
            attributes = self.attributes(index)
            shown = contributions(self.model, view, self.meshes[index], attributes, view.inside)
            hair = contributions(self.model, view, self.meshes[index], attributes, view.inner)
            shown = torch.where(self.surface.group == SCALP, hair, shown)
            tested = contributions(self.model, view, self.meshes[index], attributes, view.weight)
            every = contributions(self.model, view, self.meshes[index], attributes, torch.ones_like(view.weight))
            # what a photo's edge or a mask cuts through was moved by its few pixels as far as the rest by many
            share = (shown / every.clamp(min=1e-6)) * uncut(self.model, view, self.meshes[index])
            share_amid = share * amid_own(self.model, view, self.meshes[index], attributes, self.surface, every)
            frontal = facing(self.model, view, self.meshes[index], self.surface)
            if len(self.inputs) > 1:
                frontal = frontal * unclipped(self.model, view, self.meshes[index], attributes)
            self.frontal_by[index] = frontal
            told = frontal * self.light.tells(index)
            loose, sure = (shown * ((part - CUT[0]) / (CUT[1] - CUT[0])).clamp(0, 1) for part in (share, share_amid))
            rim = told * loose / (loose + self.half_seen)
            self.seen_by[index] = rim * self.believed[index]
            self.seen = torch.maximum(self.seen, told * sure / (sure + self.half_seen))
            self.seen_rim = torch.maximum(self.seen_rim, rim)
            self.seen_shape = torch.maximum(self.seen_shape, tested / (tested + self.half_seen))

    @torch.no_grad()
    def changes(self, fill: bool = True) -> dict[str, Tensor]:
        """Changes of the weights by parameter name, in the parameters' shapes, with what no photo shows filled in."""
        maps = self.blended()
        shown = maps["color"]
        angles = eye_angles(self.model)
        if fill:
            decoded = self.decoded[0].colors
            prior, start = recolor(decoded, self.codes.maps, self.surface), decoded + self.tint
            folded = torch.stack([lid_exposure(self.model, view) for view in self.levels[0]]).amin(0)
            maps["color"] = fill_colors(self.surface, prior, start, maps["color"], self.seen, folded, self._hairy())
            share = lid_share(self.model, self.levels[0][0])
            known = known_of(self.seen)
            colors = even_tint(self.surface, start + maps["color"], self.mean_person, known)
            colors = plain_lids(self.surface, colors, prior, share, known)
            colors = even_lash_line(*lash_line(self.model), colors, prior, known)
            maps["color"] = plain_eyes(angles, colors, decoded, known_of(self.seen_rim), known) - start
            maps["opacity"] = self.surface.fill(maps["opacity"], self.seen_shape, rest=SHAPE_REST)
            for name in ("position", "scale"):
                maps[name] = self.surface.fill(maps[name], self.seen_shape, mirrored=False, rest=SHAPE_REST)
        # what a photo shows of eyes beyond their tone is its light: it would come with every smile
        beside = torch.where(self.parts & ~torch.isfinite(angles), 1.0, self.surface.lip_rim)
        rim = (shown - maps["color"]) * (known_of(self.seen_rim) * beside)[:, None]
        creases = self._creases(maps, rim) if fill else None
        features, rotation = (torch.zeros(len(self.tint), width).to(self.tint) for width in (self.model.config.features, 4))
        deltas = {
            "decoders.transform_mean": torch.cat([maps["position"], rotation, maps["scale"]], 1),
            "decoders.opacity_mean": maps["opacity"],
            "decoders.appearance_mean": torch.cat([self.tint + maps["color"], features], 1),
        }
        deltas |= {} if creases is None else {EXPRESSION_MAPS: creases}
        if self.settings.networks:
            pairs = zip(self.tuned.named_parameters(), self.model.parameters(), strict=True)
            deltas |= {name: (value - frozen).detach() for (name, value), frozen in pairs if value is not frozen}
        return deltas

    def _creases(self, maps: dict[str, Tensor], rim: Tensor) -> Tensor | None:
        """Take folds and furrows out of the map of colors; returns the change that brings them with the photos' expression.

        So does what they show at the rim of lips, eyes and mouth, [N, 3], where tracking is never exact: at rest it would be a
        line of the wrong color. As far as light makes their shade it is taken out altogether (`fold_light`).
        """
        trained, table, folding = self.model.decoders.expression, self.model.aligned_codes, self.folding
        colors = self.decoded[0].colors + self.tint + maps["color"]
        found = colors
        colors = soft_folds(self.surface, colors, folding.strains.amin(0), folding.features)
        shade = self._shade(colors)
        even = shade.without(colors)
        maps["color"] = maps["color"] + even - found
        if trained is None or table is None:
            maps["color"] = maps["color"] + rim
            return None
        # where one photo shows the skin unstrained, what all show is the person's
        folds = crease_colors(self.surface, colors, folding.strains.amin(0), folding.features)
        shared = even - shade.without(colors - folds) + rim
        shown = [inputs.z_exp for inputs in self.inputs]
        brought = bringing(trained, self.codes.z_id, self.codes.z_exp, shown, table)
        if brought is None:  # the photos' expression is the face at rest
            maps["color"] = maps["color"] + rim
            return None
        creases = shared.expand(len(self.inputs), -1, -1)
        if len(self.inputs) > 1:
            every = zip(self.differences(), folding.strains, brought.shares, self.light.trust, strict=True)
            own = [
                share * own_colors(self.surface, found, strain, folding.parts, trust) for found, strain, share, trust in every
            ]
            creases = creases + torch.stack(own)
        prior = self._prior_folds()
        change = brought.maps(creases - prior)
        at_rest = trained.weights(self.codes.z_exp) * (1.0 + trained.gains(self.codes.z_id))
        maps["color"] = maps["color"] + rim - shared + prior - (at_rest @ change).view_as(shared)
        return change

    def _prior_folds(self) -> Tensor:
        """Folds that the trained expression maps bring in the photos' expressions, where these tell the skin's colors, [N, 3].

        The photos have their own, and the maps of colors have made up for these: left as they are they would come out at rest,
        as light lines beside the mouth.
        """
        maps, shown = self.model.decoders.expression, [inputs.z_exp for inputs in self.inputs]
        assert maps is not None
        brought = folds_brought(self.surface, maps, self.codes.z_id, self.codes.z_exp, shown, self.folding.features)
        shares = self._shares(torch.stack(self.seen_by) * self.folding.calm)
        folds = gone_on(self.surface, (shares[..., None] * brought).sum(0), known_of(self.seen))
        return folds * plain_skin(self.surface, self.folding.features)

    def _shade(self, colors: Tensor) -> FoldShade:
        """What of the colors [N, 3] is shade in narrow folds; none on weights that do not tell skin from the rest."""
        head = self.model.head_model
        face = torch.as_tensor(head.marked("face")[corners_of(self.model)].all(1), device=colors.device)
        plain = face & (self.surface.group == SKIN) & ~self.folding.features
        return FoldShade.of(self.surface, colors, recolor(self.decoded[0].colors, self.codes.maps, self.surface), plain)

    def _hairy(self) -> Tensor:
        """Share of the pixels that skin texels contribute to which show hair before the face, over all photos, [N]."""
        hair, every = torch.zeros_like(self.seen), torch.full_like(self.seen, HALF_SEEN_PIXELS)
        for index, view in enumerate(self.levels[-1]):
            if bool(view.hair.any()):
                attributes = self.attributes(index)
                hair += contributions(self.model, view, self.meshes[index], attributes, view.inside * view.hair)
                every += contributions(self.model, view, self.meshes[index], attributes, view.inside)
        return torch.where(self.surface.group == SKIN, hair / every, torch.zeros_like(hair))

    def state(self) -> dict[str, Tensor]:
        """Step, what the photos show, parameters and moments of the optimiser, by name: what `restore` takes."""
        tensors = {"step": torch.tensor([self.step_count]), "seen": self.seen}
        tensors |= {"seen_rim": self.seen_rim, "seen_shape": self.seen_shape}
        tensors |= {"seen_by": torch.stack(self.seen_by), "frontal_by": torch.stack(self.frontal_by), "believed": self.believed}
        for number, parameter in enumerate(self._parameters()):
            tensors[f"{number}.value"] = parameter.detach()
            for name, value in self.optimiser.state.get(parameter, {}).items():
                tensors[f"{number}.{name}"] = value
        return tensors

    @torch.no_grad()
    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Go on from `state`; KeyError or RuntimeError where it is of another model."""
        self.believed = tensors["believed"].clone()
        for number, parameter in enumerate(self._parameters()):
            parameter.copy_(tensors[f"{number}.value"])
            names = ("step", "exp_avg", "exp_avg_sq")
            if f"{number}.exp_avg" in tensors:
                self.optimiser.state[parameter] = {name: tensors[f"{number}.{name}"].clone() for name in names}
        self.seen, self.seen_rim, self.seen_shape = (tensors[name].clone() for name in ("seen", "seen_rim", "seen_shape"))
        self.seen_by, self.frontal_by = list(tensors["seen_by"].clone()), list(tensors["frontal_by"].clone())
        self.step_count = int(tensors["step"][0])

    def _parameters(self) -> list[Tensor]:
        return [parameter for group in self.optimiser.param_groups for parameter in group["params"]]
