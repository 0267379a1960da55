"""The prior over hairstyles: codes of known grooms give them back, draws are hair, controls do what they say."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.errors import ConfigError, ShapeError
from grmm_core.hair import library_groom
from grmm_core.hair.body import Body
from grmm_core.hair.prior import CROPPED_POINTS, PRIOR_FILE, HairPrior, hair_prior, random_groom


@pytest.fixture(scope="module")
def prior() -> HairPrior:
    return hair_prior()


def on_head(prior, groom) -> np.ndarray:
    template = np.asarray(prior.head.v_template, float)
    return groom.posed(groom.frames(template, prior.head.faces), template)


def lengths(groom) -> np.ndarray:
    return np.linalg.norm(np.diff(groom.points.reshape(len(groom), -1, 3), axis=1), axis=2).sum(1)


def test_the_file_is_small(prior):
    assert PRIOR_FILE.stat().st_size < 2 << 20
    assert prior.basis.shape == (prior.size, len(prior.mean))
    np.testing.assert_allclose(prior.codes.std(0), 1.0, atol=0.25)


def test_a_code_gives_back_what_it_was_made_from(prior):
    """A known style is nearer to its own code's guides than half of the mean style's, in centimetres and in kind."""
    for name, limit in (("bob", 0.02), ("crop", 0.008), ("afro", 0.015)):
        groom = library_groom(name).level(0.3)
        known = prior.described(on_head(prior, groom.resampled(32)).reshape(len(groom), 32, 3))
        sure = known.density > 0.5
        found = prior.describe(prior.code(groom))
        off = np.linalg.norm(found.guides - known.guides, axis=2)[sure].mean()
        mean = np.linalg.norm(prior.describe(np.zeros(prior.size)).guides - known.guides, axis=2)[sure].mean()
        assert off < limit
        assert off < 0.5 * mean


def test_a_code_survives_its_groom(prior):
    code = prior.draw(5)
    again = prior.code(prior.groom(code))
    assert np.linalg.norm(again - code) < 0.6 * np.linalg.norm(code)


def test_draws_differ_and_are_the_same_for_a_seed(prior):
    np.testing.assert_array_equal(prior.draw(3), prior.draw(3))
    assert np.abs(prior.draw(3) - prior.draw(4)).max() > 0.3
    for seed in (1, 2, 3):
        groom = prior.groom(prior.draw(seed))
        assert len(groom) > 2000
        heights = on_head(prior, groom)
        assert np.isfinite(heights).all()
        assert np.abs(heights).max() < 0.6
        assert 0.001 < np.median(lengths(groom)) < 0.5


@pytest.mark.parametrize("seed", [4, 1003, 1004, 1009])
def test_no_hair_stands_before_the_forehead_as_a_visor(prior, seed):
    """These draws lie halfway from hair combed forward to hair that stands up."""
    tips = on_head(prior, prior.groom(prior.draw(seed))).reshape(-1, CROPPED_POINTS, 3)[:, -1]
    before = tips[(tips[:, 2] > 0.06) & (np.abs(tips[:, 0]) < 0.06) & (tips[:, 1] < 0.12)]
    assert len(before) > 100
    heights, _ = Body.of(prior.head, np.asarray(prior.head.v_template, float)).heights(before)
    assert np.quantile(heights, 0.95) < 0.025


def test_controls_do_what_they_say(prior):
    code = prior.code(library_groom("bob").level(0.3))
    plain = prior.groom(code)
    assert 0.4 < np.median(lengths(prior.groom(code, length=0.5))) / np.median(lengths(plain)) < 0.65
    assert len(prior.groom(code, density=0.4)) < 0.6 * len(plain)
    wide, narrow = (np.abs(on_head(prior, prior.groom(code, volume=volume))[:, 0]).mean() for volume in (1.8, 0.5))
    assert wide > narrow + 0.002
    wound = prior.code(library_groom("ringlets").level(0.3))
    rough, straight = (np.linalg.norm(np.diff(prior.groom(wound, curl=curl).points, 2, axis=0), axis=1) for curl in (1.0, 0.0))
    assert np.median(rough) > 1.2 * np.median(straight)


def test_what_is_no_code_is_said(prior):
    with pytest.raises(ShapeError, match="hair code"):
        prior.groom(np.zeros(3))
    with pytest.raises(ShapeError, match="no scalp hair"):
        prior.code(library_groom("natural", part="brows"))
    with pytest.raises(ConfigError, match="random:7"):
        random_groom("seven")
    with pytest.raises(ShapeError, match="is for the head"):
        random_groom("1", "flame2020")
