"""The protocols: which views are drawn of whom, and what is measured.

``reconstruction``  training views of training people (the setting of the paper's residual ablation)
``novel-view``      cameras that were held out, training people
``expression``      expressions that were held out, training people
``person``          people whom the weights do not know, fitted from one view, on all their other views
``transfer``        the same fits driven with other expressions than the photo's
``monocular``       the photo itself (the paper's table 3): tracked, fitted and measured in one view

Used by the command line.
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from torch import Tensor

from ..data.dataset import CaptureDataset
from ..data.types import HELD_OUT_CAMERA, HELD_OUT_EXPRESSION, TRAIN, Shot, View
from ..errors import ConfigError, NoFaceError
from ..jobs.progress import Share, nobody, within
from ..pictures.images import quantize
from .haired import Haired, turned_degrees
from .metrics import MASK_LEVEL, Distance, Errors, errors_of
from .person_fit import CODES, fit_person, fit_photo, track_shot
from .regions import HAIR, region_pixels, triangle_groups
from .samples import LoadedView, Sample, limited, load, samples, source_view
from .scene import FULL, DrawnPerson, Scene

_FITTING_SHARE = 0.7  # of the time of a protocol that fits people, for the progress

logger = logging.getLogger(__name__)

RECONSTRUCTION, NOVEL_VIEW, EXPRESSION = "reconstruction", "novel-view", "expression"
PERSON, TRANSFER, MONOCULAR = "person", "transfer", "monocular"
SPLIT_OF = {RECONSTRUCTION: TRAIN, NOVEL_VIEW: HELD_OUT_CAMERA, EXPRESSION: HELD_OUT_EXPRESSION}
FITTED = (PERSON, TRANSFER, MONOCULAR)
KEPT_PICTURES = 100  # of a protocol, for its sheet: all of a large capture would fill the memory
PROTOCOLS = (RECONSTRUCTION, NOVEL_VIEW, EXPRESSION, PERSON, TRANSFER, MONOCULAR)


@dataclass
class Settings:
    """How to evaluate.

    Attributes:
        limit: Views of a protocol; 0 for all.
        people: Held-out people who are fitted; 0 for all.
        size: Longer side of the pictures in pixels; 0 keeps them.
        method: How people are fitted, see `fit.METHODS`.
        ablations: Also draw with residual codes switched off.
        regions: Also measure by region.
        distances: Perceptual networks by name.
        hair: Draw people in the strands that their captures recorded, on the views that show hair; people are fitted from
            views without, where the weights have none.
        seed: Of the choice of views.
        features: Of a picture, for FID (`fid.InceptionFeatures`); None leaves it out.
    """

    limit: int = 60
    people: int = 0
    size: int = 0
    method: str = CODES
    ablations: bool = True
    regions: bool = True
    distances: Mapping[str, Distance] = field(default_factory=dict)
    hair: bool = False
    seed: int = 0
    features: Callable[[Tensor], np.ndarray] | None = None


@dataclass
class Row:
    """One view's figures.

    Attributes:
        sample: The view.
        person: Who was drawn.
        errors: Of the refined picture.
        raw: Of the splatted picture; the same without a refinement network.
        variants: Errors of the refined picture by form of the residuals.
        ablation: Errors of the second model's refined picture, or None.
        pictures: Truth, refined and splatted picture, each [H, W, 3] uint8.
        features: Of truth and refined picture, for FID.
    """

    sample: Sample
    person: DrawnPerson
    errors: Errors
    raw: Errors
    variants: dict[str, Errors] = field(default_factory=dict)
    ablation: Errors | None = None
    pictures: tuple[np.ndarray, ...] = ()
    features: tuple[np.ndarray, ...] = ()


@dataclass
class Result:
    """What a protocol gave.

    Attributes:
        name: Of `PROTOCOLS`.
        rows: One a view.
        source: Fitted person to the view that they were fitted from.
        failures: Photos that could not be used, with the reason.
    """

    name: str
    rows: list[Row]
    source: dict[str, Sample] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)


class Evaluation:
    """Runs protocols on one model; people who were fitted are kept.

    Args:
        scene: Model.
        datasets: Captures of the same head model.
        settings: How.
        ablation: A second model that draws the same views, trained without residuals (eq. 21) for the paper's ablation.

    Raises:
        ConfigError: A capture belongs to another head model.
    """

    def __init__(
        self,
        scene: Scene,
        datasets: Sequence[CaptureDataset],
        settings: Settings,
        ablation: Scene | None = None,
    ) -> None:
        from .scene import check_heads

        check_heads(scene, {str(dataset.folder): dataset.manifest.head for dataset in datasets})
        self.scene, self.datasets, self.settings, self.ablation = scene, tuple(datasets), settings, ablation
        self._haired = Haired(scene, self.datasets) if settings.hair else None
        self._report: Share = nobody
        self._groups = triangle_groups(scene.head)
        self._fitted: dict[tuple[int, str], DrawnPerson] = {}
        self._photos: dict[str, Sample] = {}

    def run(self, protocol: str, report: Share = nobody) -> Result:
        """Run one protocol.

        Args:
            protocol: One of `PROTOCOLS`.
            report: Hears how much is done.

        Raises:
            ConfigError: There is no such protocol, or the captures hold no views for it.
            FileAccessError, FileFormatError: A picture cannot be used; it is named.
        """
        if protocol not in PROTOCOLS:
            raise ConfigError(f"There is no protocol {protocol!r}; use {', '.join(PROTOCOLS)}.")
        self._report = report
        if protocol == MONOCULAR and self.settings.method != CODES:
            return self._tracked_photos()
        self._photos = {}
        chosen, source = self._fitted_views(protocol) if protocol in FITTED else (self._trained_views(protocol), {})
        rows: list[Row] = []
        rest = within(report, _FITTING_SHARE if protocol in FITTED else 0.0, 1.0)
        for number, (sample, person) in enumerate(chosen):
            rows.append(self.measure(sample, person))
            if number % max(1, len(chosen) // KEPT_PICTURES):
                rows[-1].pictures = ()
            rest((number + 1) / len(chosen), f"{protocol} {sample.name}")
        return Result(protocol, rows, source)

    def measure(self, sample: Sample, person: DrawnPerson, view: LoadedView | None = None, photo: bool = False) -> Row:
        """Draw one view and compare it with the truth.

        Args:
            sample: The view.
            person: Whom to draw.
            view: Its picture; loaded when None.
            photo: It is the photo that the person was fitted to.
        """
        view = load(sample, self.settings.size) if view is None else view
        truth, mask = self.scene.tensor(view.image), self.scene.tensor(view.mask)
        if self._haired is not None:
            return self._measure_haired(self._haired, sample, person, view)
        rendering = self.scene.draw(person, sample.shot, view.camera, photo=photo)
        own = person.shape if photo else None  # what the tracking found
        regions = self._regions(sample, view, own) if self.settings.regions else {}
        distances = self.settings.distances
        errors = errors_of(rendering.image, truth, mask, regions, distances)
        refined = self.scene.model.refinement is not None
        raw = errors_of(rendering.raw, truth, mask, regions, distances) if refined else errors
        pictures = tuple(quantize(picture.cpu().numpy()) for picture in (truth, rendering.image, rendering.raw))
        row = Row(sample, person, errors, raw, pictures=pictures, features=self._features(truth, rendering.image))
        if self.settings.ablations:
            for variant in self.scene.variants:
                if variant != FULL:
                    image = self.scene.draw(person, sample.shot, view.camera, variant).image
                    row.variants[variant] = errors_of(image, truth, mask, distances=distances)
        other = self._other(sample)
        if self.ablation is not None and other is not None:
            image = self.ablation.draw(other, sample.shot, view.camera).image
            row.ablation = errors_of(image, truth, mask, distances=distances)
        return row

    def _measure_haired(self, haired: Haired, sample: Sample, person: DrawnPerson, view: LoadedView) -> Row:
        photo = self._photos.get(sample.shot.subject)

        def seen(shot: Shot, shown: View) -> bool:
            if photo is None:
                return shown.split == TRAIN
            return shot is photo.shot and shown.name == photo.view.name

        image = haired.draw(person, sample.shot, view.camera, seen)
        hair = sample.hair(self.settings.size)
        hair = np.zeros_like(view.mask) if hair is None else hair
        regions = self._regions(sample, view) | {HAIR: hair > MASK_LEVEL} if self.settings.regions else {}
        drawn, truth, mask = (self.scene.tensor(array) for array in (image, view.image, view.mask))
        errors = errors_of(drawn, truth, mask, regions, self.settings.distances)
        errors.turned = turned_degrees(image, view.image, hair)
        pictures = tuple(quantize(picture) for picture in (view.image, image, image))
        return Row(sample, person, errors, errors, pictures=pictures, features=self._features(truth, drawn))

    def _features(self, *pictures: Tensor) -> tuple[np.ndarray, ...]:
        features = self.settings.features
        return () if features is None else tuple(features(picture) for picture in pictures)

    def _tracked_photos(self) -> Result:
        """The monocular protocol with the project's own tracking."""
        result = Result(MONOCULAR, [])
        people = self._people_to_fit(MONOCULAR)
        for number, (place, name) in enumerate(people):
            photo = source_view(list(self._views_of(place, name, self._fits_bare)))
            view = load(photo, self.settings.size)
            report = within(self._report, number / len(people), (number + 1) / len(people))
            report(0.0, f"fitting {name} from the photo alone")
            try:
                person, track = fit_photo(self.scene, photo, view, self.settings.method, report)
            except NoFaceError as error:
                logger.warning("%s: %s", photo.name, error)
                result.failures.append(f"{photo.name}: {error}")
                continue
            shot = track_shot(photo, track, self.scene.head)
            alpha = track.mask[..., None]
            tracked = LoadedView(track.camera, track.image * alpha, track.mask, None)
            row = self.measure(dataclasses.replace(photo, shot=shot), person, tracked, photo=True)
            result.rows.append(row)
            result.source[name] = photo
        if not result.rows:
            raise ConfigError("No face was found in any held-out person's picture; choose a larger --size.")
        return result

    def fitted(self, place: int, name: str, report: Share = nobody) -> tuple[DrawnPerson, Sample]:
        """The held-out person `name` of the capture number `place`, fitted once, and the view used."""
        dataset = self.datasets[place]
        source = source_view(list(self._views_of(place, name, self._fits_bare)))
        if (place, name) not in self._fitted:
            view = load(source, self.settings.size)
            self._fitted[place, name] = fit_person(
                self.scene, source, view, dataset.shape(name), self.settings.method,
                report,
            )  # fmt: skip
        return self._fitted[place, name], source

    def held_out(self) -> list[tuple[int, str]]:
        """People whom the weights do not know, as capture number and name; at most `settings.people`, spread over all.

        Those whom the capture held out, and everybody in a capture of another seed.
        """
        people = [
            (place, name)
            for place, dataset in enumerate(self.datasets)
            for name in dataset.subjects
            if not self.scene.knows(name)
        ]
        limit = self.settings.people
        if limit and len(people) > limit:
            people = [people[i] for i in np.linspace(0, len(people) - 1, limit).round().astype(int)]
        return people

    def _trained_views(self, protocol: str) -> list[tuple[Sample, DrawnPerson]]:
        known: list[tuple[Sample, DrawnPerson]] = []
        for dataset in self.datasets:
            people = {name: self.scene.person(dataset, name) for name in dataset.subjects}
            for sample in samples((dataset,), SPLIT_OF[protocol], bare=self._bare):
                person = people[sample.shot.subject]
                if person is not None:
                    known.append((sample, person))
        if not known:
            raise ConfigError(
                f"The data holds no views for the protocol {protocol} of people whom these weights know; "
                "give the data that the weights were trained on."
            )
        picked = limited([sample for sample, _ in known], self.settings.limit, self.settings.seed)
        persons = {id(sample): person for sample, person in known}
        return [(sample, persons[id(sample)]) for sample in picked]

    def _fitted_views(self, protocol: str) -> tuple[list[tuple[Sample, DrawnPerson]], dict[str, Sample]]:
        people = self._people_to_fit(protocol)
        persons: dict[tuple[int, str], DrawnPerson] = {}
        source: dict[str, Sample] = {}
        candidates: list[Sample] = []
        places: dict[int, tuple[int, str]] = {}
        for number, (place, name) in enumerate(people):
            begin, end = (_FITTING_SHARE * count / len(people) for count in (number, number + 1))
            self._report(begin, f"fitting {name}")
            persons[place, name], source[name] = self.fitted(place, name, within(self._report, begin, end))
            photo = source[name]
            for sample in self._views_of(place, name, self._bare):
                same = sample.shot is photo.shot and sample.view.name == photo.view.name
                fits = same if protocol == MONOCULAR else not same
                if protocol == TRANSFER:
                    fits = sample.shot is not photo.shot and not sample.neutral
                if fits:
                    candidates.append(sample)
                    places[id(sample)] = (place, name)
        if not candidates:
            raise ConfigError(f"The held-out people have no views for the protocol {protocol}; capture more views of them.")
        self._photos = source
        picked = limited(candidates, self.settings.limit, self.settings.seed)
        return [(sample, persons[places[id(sample)]]) for sample in picked], source

    def _people_to_fit(self, protocol: str) -> list[tuple[int, str]]:
        people = self.held_out()
        if not people:
            raise ConfigError(
                f"The data holds no held-out people for the protocol {protocol}; capture with more people or another seed."
            )
        return people

    @property
    def _fits_bare(self) -> bool:
        """Whether people are fitted from pictures without hair."""
        return self.scene.model.config.hairless

    @property
    def _bare(self) -> bool:
        """Whether people are drawn and compared without hair."""
        return self._fits_bare and not self.settings.hair

    def _views_of(self, place: int, name: str, bare: bool) -> Iterator[Sample]:
        yield from (s for s in samples((self.datasets[place],), bare=bare) if s.shot.subject == name)

    def _regions(self, sample: Sample, view: LoadedView, shape: np.ndarray | None = None) -> dict[str, np.ndarray]:
        shape = sample.dataset.shape(sample.shot.subject) if shape is None else shape
        vertices = self.scene.head.vertices(shape, sample.shot.expression, sample.shot.pose)
        return region_pixels(self.scene.head, self._groups, vertices, view.camera, view.mask, view.depth)

    def _other(self, sample: Sample) -> DrawnPerson | None:
        """The person of a view in the second model: trained, or for one without residuals any, by the shape."""
        if self.ablation is None:
            return None
        known = self.ablation.person(sample.dataset, sample.shot.subject)
        if known is None and not self.ablation.residuals:
            shape = sample.dataset.shape(sample.shot.subject)
            known = self.ablation.made(sample.shot.subject, shape, shape)
        return known
