"""Walks by Python, held bit for bit against the program's."""

import threading

import numpy as np
import pytest

import foveal

SIZE = (96, 72)


def read_png(file) -> np.ndarray:
    """What a PNG of the program holds, decoded by nothing of ours."""
    import struct
    import zlib

    data = file.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, packed = 8, b""
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        body = data[at + 8 : at + 8 + length]
        if kind == b"IHDR":
            width, height, depth, colour = struct.unpack(">IIBB", body[:10])
            assert (depth, colour) == (8, 2)
        if kind == b"IDAT":
            packed += body
        at += 12 + length
    rows = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(height, 1 + 3 * width).astype(int)
    out = np.zeros((height, 3 * width), int)
    for y in range(height):
        kind, row = rows[y, 0], rows[y, 1:]
        for x in range(3 * width):
            a = out[y, x - 3] if x > 2 else 0
            b = out[y - 1, x] if y else 0
            c = out[y - 1, x - 3] if y and x > 2 else 0
            p = a + b - c
            nearest = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
            out[y, x] = (row[x] + [0, a, b, (a + b) // 2, nearest][kind]) & 255
    return out.astype(np.uint8).reshape(height, width, 3)


def test_a_frame_is_arrays(box):
    with foveal.open(box, size=SIZE, quick=True) as walk:
        assert walk.size == SIZE
        camera = next(iter(walk.cameras.values()))
        frame = walk.frame(camera, deadline=0.1)
        shape = SIZE[::-1]
        assert frame.picture.shape == (*shape, 3) and frame.picture.dtype == np.uint8
        assert frame.depth.shape == shape and frame.depth.dtype == np.float32
        assert frame.ids.shape == shape and frame.ids.dtype == np.uint32
        assert frame.error.shape == shape and frame.error.dtype == np.float32
        assert frame.picture.max() > 100 and np.isfinite(frame.depth).any()
        assert (frame.depth > 0).all()
        # A mirror ball and a glass ball.
        shown = {walk.objects[i] for i in np.unique(frame.ids) if i}
        assert len(shown) >= 2
        assert (frame.error[frame.ids == 0] == 0).all()
        assert frame.camera == camera and frame.standing in ("growing", "converged")
        assert 0.05 < frame.seconds < 5.0
        assert walk.radiance().shape == (*shape, 3)


def test_errors_fall_to_nothing(box):
    with foveal.open(box, size=SIZE, quick=True, tracers=1) as walk:
        camera = next(iter(walk.cameras.values()))
        walk.frame(camera, deadline=0.02)
        end = walk.converge(camera)
        assert end.standing == "converged" and end.quality == 0
        assert (end.error == 0).all() and np.isnan(end.noise).all()


@pytest.mark.parametrize("tracers", [1, 3])
def test_a_converged_view_is_that_of_the_program(box, program, tmp_path, tracers):
    size = f"{SIZE[0]}x{SIZE[1]}"
    program("walk", box, "--quick", "--size", size, "--frames", 1, "--until-converged", "--out", tmp_path)
    program("reference", box, "--quick", "--size", size, "--out", tmp_path / "traced.exr")
    with foveal.open(box, size=SIZE, quick=True, tracers=tracers) as walk:
        frame = walk.converge(next(iter(walk.cameras.values())))
        radiance = walk.radiance()
    assert np.array_equal(frame.picture, read_png(tmp_path / "frame-0000.png"))
    assert foveal.compare(radiance, tmp_path / "last.exr").identical
    assert foveal.compare(radiance, tmp_path / "traced.exr").identical
    reference = foveal.reference(box, size=SIZE, quick=True)
    assert np.array_equal(reference.radiance, radiance) and np.array_equal(reference.picture, frame.picture)


def test_a_walk_of_the_program_is_replayed_bit_for_bit(box, program, tmp_path):
    recording = tmp_path / "walk.fvl"
    program(
        "walk", box, "--quick", "--size", f"{SIZE[0]}x{SIZE[1]}", "--frames", 6, "--fps", 20,
        "--record", recording, "--out", tmp_path,
    )  # fmt: skip
    replay = foveal.replay(recording)
    assert len(replay) == 6 and replay.size == SIZE
    frames = list(replay)
    assert [frame.index for frame in frames] == list(range(6))
    for frame in frames:
        assert np.array_equal(frame.picture, read_png(tmp_path / f"frame-{frame.index:04}.png")), frame
    # Any frame, on any number of threads, with the same depth, ids and errors.
    again = foveal.replay(recording, threads=0)
    for index in (3, 1, -1):
        frame, other = again[index], frames[index]
        assert frame.hash == other.hash and np.array_equal(frame.picture, other.picture)
        assert np.array_equal(frame.ids, other.ids) and np.array_equal(frame.depth, other.depth)
        assert frame.camera == other.camera
    with pytest.raises(IndexError):
        again[6]


def test_a_walk_of_python_is_replayed_by_the_program(box, program, tmp_path):
    recording, shown = tmp_path / "walk.fvl", []
    with foveal.open(box, size=SIZE, quick=True, record=recording) as walk:
        camera = next(iter(walk.cameras.values()))
        for step in range(5):
            shown.append(walk.frame(camera.moved(right=0.02 * step), deadline=0.05))
    assert "each as recorded" in program("replay", recording, "--verify")
    for frame in shown:
        out = tmp_path / "frame.png"
        program("replay", recording, "--show", frame.index, "--out", out)
        assert np.array_equal(frame.picture, read_png(out))
    for live, replayed in zip(shown, foveal.replay(recording), strict=True):
        assert live.hash == replayed.hash and live.camera == replayed.camera
        assert np.array_equal(live.picture, replayed.picture)
        assert np.array_equal(live.ids, replayed.ids)


def test_paths_are_walked(box):
    with foveal.open(box, size=(32, 24), quick=True) as walk:
        for path in walk.paths.values():
            assert path.duration > 0 and path.at(0) != path.at(path.duration / 2)
            walk.frame(path.at(0.5 * path.duration), deadline=0.02)


def test_any_thread_may_ask(box):
    with foveal.open(box, size=(32, 24), quick=True) as walk:
        camera = next(iter(walk.cameras.values()))
        indices = []
        ask = lambda: indices.append(walk.frame(camera, deadline=0.02).index)  # noqa: E731
        threads = [threading.Thread(target=ask) for _ in range(4)]
        [thread.start() for thread in threads]
        [thread.join() for thread in threads]
        assert sorted(indices) == [0, 1, 2, 3]
    with pytest.raises(ValueError, match="closed"):
        walk.frame(camera)


def test_whoever_waits_lets_others_go_on(box):
    with foveal.open(box, size=(32, 24), quick=True) as walk:
        camera = next(iter(walk.cameras.values()))
        walk.converge(camera)
        counted, ends = [0], threading.Event()

        def count():
            while not ends.is_set():
                counted[0] += 1

        other = threading.Thread(target=count)
        other.start()
        before = counted[0]
        walk.frame(camera.moved(right=0.1), deadline=0.5)
        after = counted[0]
        ends.set()
        other.join()
        assert after - before > 1000


def test_ctrl_c_is_heard(box, tmp_path):
    """A bake without end is left a moment after the signal."""
    import signal
    import time

    timer = threading.Timer(0.3, lambda: signal.raise_signal(signal.SIGINT))
    started = time.monotonic()
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        foveal.bake(box, error=1e-6, cache=tmp_path)
    assert time.monotonic() - started < 60
    assert not list(tmp_path.iterdir())
