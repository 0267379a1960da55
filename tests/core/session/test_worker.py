"""The worker process: crashes, cancels, time-outs, other interpreters, and what the pipe may carry."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from worker_killer import WorkerKiller

from grmm_core.controls.frame import Controls
from grmm_core.errors import CancelledError, RuntimeMissingError, SessionError
from grmm_core.geometry.camera import Camera
from grmm_core.session import Instance, RenderOptions, create_session, process
from grmm_core.session.arena import SharedArena
from grmm_core.session.client import WorkerSession
from grmm_core.session.codec import digest, receive, send, unpack

CAMERA = Camera.orbit(64, 64)
LARGE = Camera.orbit(2200, 2200)  # long enough to be interrupted
ROOT = Path(__file__).resolve().parents[3]
SOON = 10.0  # seconds; on a machine with nothing else to do it takes less than two
SAME = 1e-5  # metres or display values: another process may add in another order
posix = pytest.mark.skipif(sys.platform == "win32", reason="sends POSIX signals")


@pytest.fixture(scope="module")
def session(weights):
    with create_session("worker", weights=weights, device="cpu", threads=1) as session:
        yield session


def wait_until(condition, seconds: float = 30.0) -> bool:
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


def wait_until_gone(pid: int) -> bool:
    def gone() -> bool:
        try:
            os.kill(pid, 0)
            # a zombie of another parent still answers
            return Path(f"/proc/{pid}/stat").exists() and Path(f"/proc/{pid}/stat").read_text().split(")")[1].split()[0] == "Z"
        except ProcessLookupError:
            return True

    return wait_until(gone)


def killed_at_a_question(session, pictures: int, number: int = 3):
    """A `should_cancel` that kills the workers of so many tries while they draw, when it is asked for that time."""
    asked: dict[int, int] = {}

    def should_cancel() -> bool:
        pid = session.status().pid
        asked[pid] = asked.get(pid, 0) + 1
        if asked[pid] == number and len(asked) <= pictures:
            os.kill(pid, signal.SIGKILL)
        return False

    return should_cancel


@posix
def test_a_worker_killed_in_the_middle_of_a_render(session):
    """Another one draws the picture."""
    info = session.open("default")
    camera = Camera.orbit(1000, 1000)
    before, restarts = session.render([Instance(info.id)], camera)["rgb"], session.status().restarts
    again = session.render([Instance(info.id)], camera, should_cancel=killed_at_a_question(session, 2))["rgb"]
    np.testing.assert_array_equal(again, before)
    assert session.status().restarts == restarts + 2


@posix
def test_a_picture_that_ends_three_workers_is_given_up(session):
    info = session.open("default")
    before = session.render([Instance(info.id)], CAMERA)["rgb"]
    with pytest.raises(SessionError, match=r"ended by signal 9.*3 times in a row") as caught:
        session.render([Instance(info.id)], LARGE, should_cancel=killed_at_a_question(session, 3, 1))
    assert "\n" not in str(caught.value)
    assert not session.status().alive
    again = session.render([Instance(info.id)], CAMERA)["rgb"]  # the same id still works
    np.testing.assert_array_equal(again, before)


@pytest.mark.parametrize("engine", ["torch", "plain"])
@pytest.mark.parametrize(("pictures", "kills"), [(20, 4), pytest.param(200, 50, marks=pytest.mark.slow)])
def test_workers_killed_at_random_moments_of_a_sequence(weights, monkeypatch, engine, pictures, kills):
    monkeypatch.setattr(process, "_launch", process._launch)  # put back afterwards
    with create_session("worker", weights=weights, device="cpu", threads=1, engine=engine) as session:
        info = session.open("default")

        def picture(number: int) -> np.ndarray:
            controls = Controls().set_named({"jawOpen": number / pictures})
            return session.render([Instance(info.id, controls)], CAMERA, RenderOptions(passes=("rgb", "alpha")))["rgb"]

        begin = time.monotonic()
        picture(0)
        start, begin = time.monotonic() - begin, time.monotonic()
        whole = [picture(number) for number in range(pictures)]
        draw = (time.monotonic() - begin) / pictures
        os.kill(session.status().pid, signal.SIGKILL)  # the next worker is one that the killer knows
        killer = WorkerKiller(process, pictures, kills, seed=pictures, draw=draw, start=start)
        for number, expected in enumerate(whole):
            killer.picture(number)
            np.testing.assert_array_equal(picture(number), expected)
        assert killer.done == kills
        assert session.status().restarts >= kills


@posix
def test_a_worker_killed_between_calls_is_replaced_silently(session, tmp_path):
    path = tmp_path / "a.grmm"
    session.save(session.sample(2).id, path)
    infos = [session.open("default"), session.sample(2), session.open(path)]
    before = [session.deform(info.id, Controls()).vertices for info in infos]
    pid = session.status().pid
    os.kill(pid, signal.SIGKILL)
    assert wait_until(lambda: not session.status().alive)
    for info, vertices in zip(infos, before, strict=True):
        np.testing.assert_allclose(session.deform(info.id, Controls()).vertices, vertices, atol=SAME)
    assert session.open(path).id == infos[2].id


def test_a_cancelled_render_returns_soon_and_the_next_call_waits_for_its_end(session):
    info = session.open("default")
    expected = session.render([Instance(info.id)], CAMERA)["rgb"]
    pid = session.status().pid
    questions = []

    def cancel_on_the_third_question() -> bool:
        questions.append(time.monotonic())
        return len(questions) == 3

    with pytest.raises(CancelledError):
        session.render([Instance(info.id)], LARGE, should_cancel=cancel_on_the_third_question)
    assert time.monotonic() - questions[2] < SOON
    np.testing.assert_allclose(session.render([Instance(info.id)], CAMERA)["rgb"], expected, atol=SAME)
    assert session.status().pid == pid


def test_a_render_is_cancelled_while_another_thread_has_the_session(session):
    info = session.open("default")
    has_it, done = threading.Event(), threading.Event()

    def keep() -> None:
        with session._lock:
            has_it.set()
            done.wait(60.0)

    other = threading.Thread(target=keep)
    other.start()
    assert has_it.wait(10.0)
    begin = time.monotonic()
    with pytest.raises(CancelledError):
        session.render([Instance(info.id)], CAMERA, should_cancel=lambda: time.monotonic() > begin + 0.1)
    assert other.is_alive()
    assert time.monotonic() - begin < SOON
    done.set()
    other.join()
    assert session.render([Instance(info.id)], CAMERA, should_cancel=lambda: False)["rgb"].any()


@posix
def test_a_hung_worker_is_ended_when_the_time_is_over(weights):
    with WorkerSession(sys.executable, weights, "cpu", 1) as session:
        info = session.open("default")
        pid = session.status().pid
        os.kill(pid, signal.SIGSTOP)
        session._timeout = 0.05  # too short for a new worker to start
        with pytest.raises(SessionError, match="longer than 0 seconds and was stopped, 3 times in a row"):
            session.deform(info.id, Controls())
        assert wait_until_gone(pid)
        session._timeout = 60.0
        assert session.deform(info.id, Controls()).vertices.shape == (info.vertex_count, 3)


def test_closing_ends_a_render_of_another_thread(weights):
    session = create_session("worker", weights=weights, device="cpu", threads=1)
    info = session.open("default")
    pid = session.status().pid
    started, errors = threading.Event(), []

    def draw() -> None:
        try:
            session.render([Instance(info.id)], LARGE, should_cancel=lambda: bool(started.set()))
        except SessionError as error:
            errors.append(str(error))

    thread = threading.Thread(target=draw)
    thread.start()
    assert started.wait(60)
    start = time.monotonic()
    session.close()
    assert time.monotonic() - start < SOON
    thread.join(30)
    assert not thread.is_alive()
    assert len(errors) == 1
    assert wait_until_gone(pid)


def test_calls_from_several_threads_do_not_mix(session):
    info = session.open("default")
    values = np.linspace(0.0, 1.0, 12)
    expected = [session.deform(info.id, Controls().set_named({"jawOpen": value})).vertices for value in values]
    found: dict[int, np.ndarray] = {}

    def work(k: int) -> None:
        found[k] = session.deform(info.id, Controls().set_named({"jawOpen": values[k]})).vertices

    threads = [threading.Thread(target=work, args=(k,)) for k in range(len(values))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    for k, vertices in enumerate(expected):
        np.testing.assert_allclose(found[k], vertices, atol=SAME)


def test_an_announced_picture_is_the_same_picture(session):
    info = session.open("default")
    frames = [[Instance(info.id, Controls().set_named({"jawOpen": value}))] for value in (0.2, 0.5, 0.8)]
    expected = [session.render(frame, CAMERA)["rgb"] for frame in frames]
    drawing, found = threading.Event(), []

    def draw() -> None:
        found.append(session.render(frames[0], CAMERA, should_cancel=lambda: drawing.set() or False)["rgb"])

    thread = threading.Thread(target=draw)
    thread.start()
    assert drawing.wait(30)
    session.prepare(frames[2], CAMERA, RenderOptions())
    session.prepare(frames[1], CAMERA, RenderOptions())
    thread.join(30)
    found += [session.render(frame, CAMERA)["rgb"] for frame in frames[1:]]
    for picture, same in zip(found, expected, strict=True):
        np.testing.assert_allclose(picture, same, atol=SAME)


def test_what_cannot_be_announced_is_left_to_render(session):
    info = session.open("default")
    for instance in (Instance(10_000), Instance(info.id, Controls(z_exp=np.full(3, np.nan)))):
        session.prepare([instance], CAMERA, RenderOptions())
    assert session.render([Instance(info.id)], CAMERA)["rgb"].max() > 0.1


def test_results_larger_than_the_arena(session):
    info = session.open("default")
    options = RenderOptions(refine=False, passes=("rgb", "alpha", "features"))
    large = session.render([Instance(info.id)], Camera.orbit(700, 700), options)
    assert sum(buffer.nbytes for buffer in large.values()) > 4 << 20
    assert large["alpha"].max() > 0.9


def run_parent(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)],
        capture_output=True, text=True, timeout=60, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip


@posix
def test_the_worker_ends_with_its_parent(weights):
    """Also when the parent has no chance to say goodbye; and nothing is left in shared memory."""
    shared = Path("/dev/shm")
    before = set(shared.iterdir()) if shared.is_dir() else set()
    result = run_parent(
        """
        import os, sys
        from grmm_core.session import create_session
        session = create_session("worker", weights=sys.argv[1])
        session.open("default")
        print(session.status().pid, flush=True)
        os._exit(1)
        """,
        weights,
    )
    assert wait_until_gone(int(result.stdout))
    assert result.stderr == ""
    assert (set(shared.iterdir()) if shared.is_dir() else set()) - before == set()


def test_the_parent_needs_no_torch(weights):
    """In Blender's Python there is numpy and nothing else."""
    result = run_parent(
        """
        import sys
        class Refuse:
            def find_spec(self, name, path=None, target=None):
                if name.partition(".")[0] in ("torch", "numba", "scipy", "PIL"):
                    raise ImportError(name)
        sys.meta_path.insert(0, Refuse())
        from grmm_core.geometry.camera import Camera
        from grmm_core.session import Instance, create_session
        with create_session("worker", python=sys.executable, weights=sys.argv[1]) as session:
            info = session.open("default")
            print(session.render([Instance(info.id)], Camera.orbit(32, 32))["alpha"].max())
        """,
        weights,
    )
    assert result.stderr == ""
    assert float(result.stdout) > 0.5


def test_people_of_the_library_open_in_a_worker():
    with create_session("worker", device="cpu", threads=1) as session:
        assert session.open("library:beard").source == "library:beard"


def test_a_dropped_session_ends_its_worker(weights):
    session = create_session("worker", weights=weights)
    session.open("default")
    pid = session.status().pid
    del session
    assert wait_until_gone(pid)


def test_warming_up_returns_at_once(weights):
    with create_session("worker", weights=weights) as session:
        with session.at_once(0.0) as free:
            assert not free
        session.warm_up()
        assert not session.status().torch  # it did not wait for the worker, which takes seconds to load torch
        assert session.open("default").id > 0
        assert session.status().alive


def test_an_interpreter_that_does_not_exist(weights, tmp_path):
    with (
        create_session("worker", python=tmp_path / "no python", weights=weights) as session,
        pytest.raises(SessionError, match="no python cannot be started"),
    ):
        session.open("default")


@posix
def test_a_program_that_is_no_python(weights, tmp_path):
    impostor = tmp_path / "python"
    impostor.write_text("#!/bin/sh\necho wrong program >&2\nexit 3\n")
    impostor.chmod(0o755)
    with (
        create_session("worker", python=impostor, weights=weights) as session,
        pytest.raises(SessionError, match=r"did not start with .*wrong program"),
    ):
        session.open("default")


@posix
def test_an_interpreter_without_torch(weights, tmp_path):
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nexport PYTHONPATH="{tmp_path}:$PYTHONPATH"\nexec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    (tmp_path / "torch.py").write_text("raise ModuleNotFoundError(\"No module named 'torch'\", name='torch')\n")
    with (
        create_session("worker", python=python, weights=weights) as session,
        pytest.raises(RuntimeMissingError, match=r"has no torch; install it there"),
    ):
        session.open("default")


# --- the pipe and the arena --------------------------------------------------------------------------------------------


def test_messages_keep_arrays_and_types():
    arena, stream = SharedArena(), io.BytesIO()
    controls = Controls().set_named({"jawOpen": 0.3, "z_exp.4": -1.0})
    rng = np.random.default_rng(0)
    message = {
        "id": 3,
        "arguments": {
            "instances": [Instance(1, controls, np.diag([2.0, 2, 2, 1]))],
            "camera": CAMERA,
            "big": rng.normal(size=(300, 1000)),
            "empty": np.zeros((0, 4), np.float32),
            "raw": b"\x00\xff",
        },
    }
    send(stream, message, arena)
    stream.seek(0)
    back = unpack(receive(stream), SharedArena.attach(arena.spec() | {"descriptor": os.dup(arena.descriptor)}))
    arguments = back["arguments"]
    np.testing.assert_array_equal(arguments["big"], message["arguments"]["big"])
    np.testing.assert_array_equal(arguments["instances"][0].controls.aligned, controls.aligned)
    np.testing.assert_array_equal(arguments["instances"][0].model_to_world, np.diag([2.0, 2, 2, 1]))
    np.testing.assert_array_equal(arguments["camera"].world_to_camera, CAMERA.world_to_camera)
    assert arguments["empty"].shape == (0, 4)
    assert arguments["raw"] == b"\x00\xff"
    assert receive(stream) is None
    arena.close()
    message["arguments"].pop("big")  # a message without the arena carries its arrays itself
    stream = io.BytesIO()
    send(stream, message)
    stream.seek(0)
    back = unpack(receive(stream), None)
    np.testing.assert_array_equal(back["arguments"]["instances"][0].controls.aligned, controls.aligned)
    assert digest(back) == digest(message) != digest({"id": 3})


def test_pictures_lie_as_blender_wants_them():
    arena, stream = SharedArena(), io.BytesIO()
    picture = np.random.default_rng(1).normal(size=(5, 7, 3)).astype(np.float32)
    send(stream, {"result": {"rgb": picture, "alpha": picture[..., :1], "count": np.array(3.0)}}, arena, turned=True)
    stream.seek(0)
    back = unpack(receive(stream), arena)["result"]
    np.testing.assert_array_equal(back["rgb"], picture)
    np.testing.assert_array_equal(back["alpha"], picture[..., :1])
    assert back["rgb"][::-1].flags.c_contiguous  # from the last row to the first
    assert back["count"] == 3.0
    arena.close()


@pytest.mark.parametrize(
    "data", [b"\xff\xff\xff\xff", b"\x04\x00\x00\x00nope", b"\x02\x00\x00\x00[]", b"\x03\x00\x00\x00\xff\xfe\xfd"]
)
def test_what_is_not_a_message_is_refused(data):
    with pytest.raises(SessionError, match="The model worker sent"):
        receive(io.BytesIO(data))


def test_unknown_types_are_not_built():
    with pytest.raises(SessionError, match="unknown type 'Popen'"):
        unpack({"x": {"$type": "Popen", "fields": {"args": ["true"]}}}, None)


def test_an_arena_grows_and_is_seen_by_the_other_side():
    arena = SharedArena()
    other = SharedArena.attach(arena.spec() | {"descriptor": os.dup(arena.descriptor)})
    big = np.arange(3_000_000, dtype=np.float32)
    offset = other.write([big])[0]
    arena.follow(other.spec() | {"descriptor": arena.descriptor})
    np.testing.assert_array_equal(arena.read("<f4", (3_000_000,), offset), big)
    with pytest.raises(SessionError, match="choose a smaller size"):
        arena.reserve(1 << 40)
    for side in (arena, other):
        side.close()
        side.close()


def test_an_idle_worker_gives_memory_back(monkeypatch):
    from grmm_core.session import worker

    class Silence(io.RawIOBase):
        def read(self, size: int = -1) -> bytes:
            threading.Event().wait()
            return b""

    given = []
    monkeypatch.setattr(worker, "IDLE_SECONDS", 0.05)
    monkeypatch.setattr(worker, "give_back", lambda: given.append(True))
    requests = worker._Requests(Silence())
    threading.Timer(0.5, lambda: requests._queue.put({"id": 1})).start()
    assert requests.next() == {"id": 1}
    assert given == [True]  # once, however long it waits
