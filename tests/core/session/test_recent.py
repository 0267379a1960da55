"""`compute.recent`: what was made of the same contents is not made again, and what depends on more than these is."""

from __future__ import annotations

import dataclasses

import numpy as np

from grmm_core.compute.recent import Recent
from grmm_core.hair.packaged import library_groom
from grmm_core.hair.ready import ready
from grmm_core.head import load_open_head
from grmm_core.light.materials import materials_of
from grmm_core.light.resting import RestLight, Texels


def test_contents_say_what_is_the_same():
    made = []
    kept: Recent[int] = Recent(2)

    def get(*given: object) -> int:
        return kept.get(given, lambda: made.append(given) or len(made))

    rows = np.arange(6, dtype=np.float32)
    first = get("a", rows, (rows, None))
    assert get("a", rows.copy(), (rows[::-1][::-1], None)) == first
    others = [
        ("b", rows, (rows, None)), ("a", rows + 1, (rows, None)), ("a", rows, (rows, 0)), ("a", rows, (rows + 1, None)),
        ("a", rows.reshape(2, 3), (rows, None)), ("a", rows.view(np.int32), (rows, None)),
    ]  # fmt: skip
    assert len({get(*given) for given in others} | {first}) == len(others) + 1
    assert len(made) == len(others) + 1


def test_the_oldest_is_forgotten_and_what_is_asked_for_is_not_old():
    made: list[int] = []
    kept: Recent[int] = Recent(2)
    for number in (1, 2, 1, 3, 1, 2):
        kept.get((number,), lambda number=number: made.append(number) or number)
    assert made == [1, 2, 3, 2]


def test_light_at_rest_that_is_known_is_that_of_the_colors_that_are_asked_for():
    """What does not depend on colors is kept; what does is made for each, and changes nothing that is kept."""
    head = load_open_head()
    some = np.arange(0, len(head.faces), 7)
    texels = Texels.of(head, some, np.full((len(some), 3), 1.0 / 3.0, np.float32))
    materials = materials_of(head, *texels[:2])

    def light(grey: float, taller: float) -> RestLight:
        vertices = head.v_template.astype(np.float64) * [1.0, taller, 1.0]
        return RestLight.of(head, texels, materials, vertices, np.full((len(some), 3), grey))

    first, dark, again, other = light(0.6, 1.0), light(0.2, 1.0), light(0.6, 1.0), light(0.6, 1.1)
    assert dark.transfer is first.transfer
    assert dark.albedo.max() < 0.5 * first.albedo.min()
    for name, value in first._asdict().items():
        np.testing.assert_array_equal(getattr(again, name), value, err_msg=name)
    assert np.abs(other.transfer - first.transfer).max() > 1e-3


def test_a_groom_is_made_ready_once_for_its_contents():
    head, groom = load_open_head(), library_groom("bob").level(0.1)
    first = ready(groom, head)
    assert ready(dataclasses.replace(groom, points=groom.points.copy()), head) is first
    wider = ready(dataclasses.replace(groom, widths=2.0 * groom.widths), head)
    assert wider[0].widths.max() > 1.5 * first[0].widths.max()
