"""The hair of a captured person: the strands that the capture recorded, in colors that make them look as in its pictures.

Weights that were trained on bare heads have no hair of their own; this is what an avatar of one person wears instead.
Called by `grmm train person`. Imports torch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np

from ..avatar import Hair
from ..data.dataset import CaptureDataset
from ..data.layers import PART_LAYER, PARTS
from ..data.types import Shot, View
from ..hair.coloring import HairView, with_colors
from ..hair.roots import BEARD, BROWS, GROUPS, SCALP
from ..hair.settings import HairSettings

if TYPE_CHECKING:
    from ..head import HeadModel

_LOOSE = 2.0  # brows and beards cover little more than half of the skin where they are densest

SeenIn = Callable[[Shot, View], bool]


def captured_hair(
    datasets: Iterable[CaptureDataset], person: str, head: HeadModel, seen: SeenIn = lambda shot, view: True,
    *, even: bool = False,
) -> Hair | None:  # fmt: skip
    """Return what a person wears; None where no capture has recorded it.

    Colors are sought where a view shows the person with hair and says where it is, else they are the settings' own.

    Args:
        datasets: Captures; the strands are those of the first that has them, and the views of all tell the colors.
        person: Name.
        head: Of the captures.
        seen: Which views may tell the colors.
        even: Grey is one tone for all hairs of the scalp, as the studio's is, and no white hairs among dark ones.

    Raises:
        FileAccessError, FileFormatError: A file is missing or damaged.
    """
    folders = list(datasets)
    for recorded in folders:
        groom = recorded.groom(person)
        if groom is None:
            continue
        views = [
            (dataset, shot, view)
            for dataset in folders for shot in dataset.shots if shot.subject == person
            for view in shot.shown(bare=False) if PART_LAYER in view.layers and seen(shot, view)
        ]  # fmt: skip
        settings, parts = HairSettings(), {}
        for group in (SCALP, BROWS, BEARD):
            some = groom.select(groom.groups == group) if group else groom
            shown = [_hair_view(*view, head, GROUPS[group]) for view in views] if len(some) else []
            if shown:
                clearest = max(shown, key=lambda view: float(view.hair.sum()))
                before = settings.for_part(group).changed(sheen=settings.sheen)  # the studio's brows glint as its scalp hair
                colored = with_colors(before, some, [clearest], head, even=even and group == SCALP)
                if group == SCALP:
                    settings = colored
                else:
                    parts[GROUPS[group]] = colored.changed(dye=settings.dye)  # pigment alone, so that its sliders act
        return Hair(groom, settings, parts)
    return None


def _hair_view(dataset: CaptureDataset, shot: Shot, view: View, head: HeadModel, part: str) -> HairView:
    """A view and where it shows scalp hair, brows or beard; of the last two, skin between the hairs belongs to them."""
    picture = dataset.picture(shot, view)
    vertices = np.asarray(head.vertices(dataset.shape(shot.subject), shot.expression, shot.pose), np.float64)
    if shot.displacement is not None:
        vertices = vertices + shot.displacement
    hair = dataset.layer(shot, view, PART_LAYER)[PARTS.index("hair" if part == GROUPS[SCALP] else part)]
    if part != GROUPS[SCALP]:
        hair = np.clip(hair * _LOOSE, 0.0, 1.0)
    return HairView(view.camera, vertices, picture.over(0.0), hair, np.ones_like(hair))
