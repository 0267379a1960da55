"""Requests for fits: their way to arguments and JSON and back, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from grmm_core.cli import build_parser
from grmm_core.errors import ConfigError, FileAccessError
from grmm_core.fitting.folder import REQUEST_FILE, Job, interrupted_request, prepare
from grmm_core.fitting.request import FacesRequest, FitRequest, faces_by_photo

PHOTOS = (Path("-strange name.jpg"), Path("фото é/b.png"))
REQUESTS = (
    FitRequest((Path("a.jpg"),), Path("a.grmm")),
    FitRequest(PHOTOS, Path("-out ü.grmm"), "high", (1, 0), (Path("-m.png"), Path("n.png"))),
    FitRequest(PHOTOS, Path("/x/b.grmm"), "fast", (4,), weights="-w.safetensors", head="flame.pkl", device="cpu", threads=3),
    FitRequest((Path("a.jpg"),), Path("a.grmm"), work=Path("-state"), resume=True, name="Ada, -- Countess"),
)


def parse(arguments: list[str]):
    return build_parser()[0].parse_args(["fit", *arguments])


@pytest.mark.parametrize("request_", REQUESTS, ids=["plain", "outlines", "model", "state"])
def test_a_request_is_the_same_after_arguments_and_after_json(request_: FitRequest):
    assert FitRequest.from_arguments(parse(request_.arguments())) == request_
    assert FitRequest.from_json(json.loads(json.dumps(request_.to_json()))) == request_


def test_a_request_for_faces_is_the_same_after_arguments():
    for wanted in (FacesRequest(PHOTOS, Path("-out")), FacesRequest(PHOTOS, Path("out"), (2,), (Path("m"), Path("n")))):
        assert FacesRequest.from_arguments(parse(wanted.arguments())) == wanted
    assert parse(["a.jpg", "--look", "out"]).find_faces == Path("out")  # as it was called before


def test_paths_may_be_text_and_several_a_list():
    loose = FitRequest(["a.jpg"], "a.grmm", faces=[2], masks=["m.png"], weights=Path("w"), work="state")
    strict = FitRequest((Path("a.jpg"),), Path("a.grmm"), faces=(2,), masks=(Path("m.png"),), weights="w", work=Path("state"))
    assert loose == strict


def test_faces_are_one_for_all_or_one_each():
    assert faces_by_photo(FacesRequest(PHOTOS, "out")) == (0, 0)
    assert faces_by_photo(FacesRequest(PHOTOS, "out", [3])) == (3, 3)
    assert faces_by_photo(FacesRequest(PHOTOS, "out", [3, 1])) == (3, 1)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"photos": []}, "at least one"),
        ({"photos": ["a.jpg"] * 17}, "at most 16"),
        ({"preset": "best"}, "preset"),
        ({"masks": ["m", "n"]}, "2 masks"),
        ({"faces": [0, 1]}, "2 faces"),
        ({"faces": [-1]}, "no face 0"),
        ({"output": "a.png"}, "does not end in .grmm"),
        ({"device": "toaster"}, "no device 'toaster'"),
        ({"threads": -1}, "threads"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_place(changes, words):
    values = {"photos": ["a.jpg"], "output": "a.grmm"} | changes
    with pytest.raises(ConfigError, match=words):
        FitRequest(**values)
    with pytest.raises(ConfigError):
        FitRequest.from_json(values)


def test_json_of_something_else_is_refused():
    for values in ({}, {"photos": ["a.jpg"]}, {"photos": 3, "output": "a.grmm"}, {**REQUESTS[0].to_json(), "wings": 2}):
        with pytest.raises(ConfigError):
            FitRequest.from_json(values)
    with pytest.raises(ConfigError, match="add -o"):
        FitRequest.from_arguments(parse(["a.jpg"]))


def test_an_output_that_cannot_become_a_file_is_refused(tmp_path):
    FitRequest(["a.jpg"], tmp_path / "a.grmm").check_output()
    with pytest.raises(FileAccessError, match="does not exist"):
        FitRequest(["a.jpg"], tmp_path / "none" / "a.grmm").check_output()
    (tmp_path / "b.grmm").mkdir()
    with pytest.raises(FileAccessError, match="is a folder"):
        FitRequest(["a.jpg"], tmp_path / "b.grmm").check_output()


def test_an_interrupted_fit_goes_on_without_naming_the_photos(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    asked = FitRequest(["a.jpg"], "a.grmm", "fast", [1], name="Ada", threads=2)
    folder = prepare(Job((), (), ()), asked)
    monkeypatch.chdir("/")
    again = interrupted_request(tmp_path / "a.grmm", None)
    assert again == FitRequest([tmp_path / "a.jpg"], tmp_path / "a.grmm", "fast", [1], name="Ada", threads=2, resume=True)
    (tmp_path / folder / REQUEST_FILE).write_text("{")
    for output in ("a.grmm", "other.grmm"):
        with pytest.raises(ConfigError, match=r"holds no interrupted fit"):
            interrupted_request(tmp_path / output, None)
