"""The worked examples of `docs/extending.md`, each carried out on a copy of the packages."""

from __future__ import annotations

from pathlib import Path

import pytest
from blender_process import RunBlender
from worked_examples import Chapter, apply_diff, apply_diffs, chapters, copy_packages, run_outside_blender

CHAPTERS = chapters()
IN_BLENDER = [chapter for chapter in CHAPTERS if chapter.blender_blocks]
DOCUMENT = """# Title
```python
raise SystemExit
```
## First
text
```diff
+++ a.py
 one
-two
+three
@@
+four

 five
```
```console
$ grmm info
```
## Nothing to do
## Second
```diff
+++ b/new.py
+x = 1
```
"""
FILES = {
    "How to add a control": 2,
    "How to add an expression": 1,
    "How to add a file format": 2,
}  # the most that a chapter may change


@pytest.mark.parametrize("chapter", CHAPTERS, ids=str)
def test_chapter(chapter: Chapter, tmp_path: Path):
    assert len(chapter.files) <= FILES.get(chapter.title, len(chapter.files))
    copy_packages(tmp_path)
    apply_diffs(chapter, tmp_path)
    run_outside_blender(chapter, tmp_path)


@pytest.mark.blender
@pytest.mark.parametrize("chapter", IN_BLENDER, ids=str)
def test_chapter_in_blender(chapter: Chapter, run_blender: RunBlender, tmp_path: Path):
    script = tmp_path / "blocks.py"
    script.write_text("\n".join(chapter.blender_blocks), "utf-8")
    run_blender(script, edit=lambda extension: apply_diffs(chapter, extension))


def test_a_document_is_read_as_it_is_written(tmp_path: Path):
    document = tmp_path / "d.md"
    document.write_text(DOCUMENT, "utf-8")
    first, second = chapters(document)
    assert (first.title, first.files, second.files) == ("First", ["a.py"], ["b/new.py"])
    (tmp_path / "a.py").write_text("zero\none\ntwo\n\nfive\n")
    (tmp_path / "b").mkdir()
    apply_diffs(first, tmp_path)
    apply_diffs(second, tmp_path)
    assert (tmp_path / "a.py").read_text() == "zero\none\nthree\nfour\n\nfive\n"
    assert (tmp_path / "b" / "new.py").read_text() == "x = 1\n"


@pytest.mark.parametrize(
    ("diff", "message"),
    [
        ("+++ a.py\n-gone\n+here\n", "0 times"),
        ("+++ a.py\n twice\n+here\n", "2 times"),
        ("+++ none.py\n old\n+here\n", "does not exist"),
        ("--- a.py\n-one\n", "begins with"),
        ("+++ a.py\n*one\n", "not a line of a diff"),
    ],
)
def test_a_diff_that_does_not_fit_is_told(tmp_path: Path, diff: str, message: str):
    (tmp_path / "a.py").write_text("twice\none\ntwice\n")
    with pytest.raises(AssertionError, match=message):
        apply_diff(diff, tmp_path)
    assert (tmp_path / "a.py").read_text() == "twice\none\ntwice\n"


def test_blocks_that_fail_are_told(tmp_path: Path):
    copy_packages(tmp_path)
    good = Chapter("good", (("console", "$ grmm --help\nusage: grmm\n"), ("python", "import grmm_core\n")))
    run_outside_blender(good, tmp_path)
    for language, text, message in (
        ("python", "assert 1 == 2\n", "AssertionError"),
        ("console", "$ grmm info nothing.grmm\n", "does not exist"),
        ("console", "$ grmm --help\nno such line\n", "did not print"),
    ):
        with pytest.raises(AssertionError, match=message):
            run_outside_blender(Chapter("bad", ((language, text),)), tmp_path)
