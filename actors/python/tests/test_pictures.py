"""Light, references, comparisons; and what makes no sense."""

import numpy as np
import pytest

import foveal


def test_a_bake_is_kept_and_found(box, tmp_path):
    made = foveal.bake(box, error=0.5, texels=2048, cache=tmp_path)
    assert not made.cached and made.texels > 1000 and made.error > 0
    again = foveal.bake(box, error=0.5, texels=2048, cache=tmp_path)
    assert again.cached and again.file == made.file


def test_paths_are_sure_to_what_they_say(box):
    few = foveal.reference(box, kind="path", samples=16, size=(32, 24))
    more = foveal.reference(box, kind="path", samples=64, size=(32, 24))
    assert (few.samples, more.samples) == (16, 64)
    assert 0 < more.error < few.error
    assert few.radiance.shape == (24, 32, 3) and (few.radiance >= 0).all()


def test_a_reference_from_anywhere(box):
    with foveal.open(box, size=(32, 24), quick=True) as walk:
        (name, camera), *_ = walk.cameras.items()
        here = foveal.reference(box, name, size=(32, 24), quick=True)
        assert np.array_equal(foveal.reference(box, camera, size=(32, 24), quick=True).radiance, here.radiance)
        aside = foveal.reference(box, camera.moved(right=0.2), size=(32, 24), quick=True)
    assert foveal.compare(aside.radiance, here.radiance).flip > 0.01


def test_comparisons_of_arrays():
    grey = np.full((16, 24, 3), 128, np.uint8)
    same = foveal.compare(grey, grey)
    assert same.identical and same.flip == 0 and same.psnr is None and same.flip_map.shape == (16, 24)
    other = grey.copy()
    other[:, 12:] = 160
    apart = foveal.compare(other, grey)
    assert not apart.identical and 0 < apart.flip < 1
    assert apart.flip_map[:, 18:].mean() > 10 * apart.flip_map[:, :6].mean()
    # PSNR of 32 steps in half of all pixels.
    assert apart.psnr == pytest.approx(-10 * np.log10(0.5 * (32 / 255) ** 2), abs=0.01)
    linear = ((grey / 255 + 0.055) / 1.055) ** 2.4
    assert foveal.compare(linear.astype(np.float32), grey).max_abs < 1e-6


def test_a_camera_says_what_it_is():
    camera = foveal.Camera((0, 0, 2), (0, 0, 0), fov_y=40)
    assert camera.eye == (0, 0, 2) and camera.fov_y == pytest.approx(40)
    assert camera.moved(right=1).eye == pytest.approx((1, 0, 2))
    assert camera.moved(up=1, forward=1).eye == pytest.approx((0, 1, 1))
    assert camera == foveal.Camera((0, 0, 2), (0, 0, 0), fov_y=40) and camera != camera.moved(right=1)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda box: foveal.Camera((0, 0, 0), (0, 0, 0)),
        lambda box: foveal.Camera((0, 1, 0), (0, 0, 0)),
        lambda box: foveal.Camera((0, float("nan"), 0), (0, 0, 1)),
        lambda box: foveal.Camera((0, 0, 0), (0, 0, 1), fov_y=180),
        lambda box: foveal.open(box, size=(0, 24)),
        lambda box: foveal.open(box, size=(1 << 14, 1 << 14)),
        lambda box: foveal.open(box, policy="best"),
        lambda box: foveal.open(box, tracers=0),
        lambda box: foveal.open(box, fps=0),
        lambda box: foveal.open(box, refine=2),
        lambda box: foveal.bake(box, error=0),
        lambda box: foveal.reference(box, kind="true"),
        lambda box: foveal.reference(box, "nowhere", size=(8, 8), quick=True),
        lambda box: foveal.reference(box, until_error=0.1),
        lambda box: foveal.compare(np.zeros((4, 4, 3), np.uint8), np.zeros((4, 5, 3), np.uint8)),
        lambda box: foveal.compare(np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4, 4), np.uint8)),
    ],
)
def test_what_makes_no_sense_is_a_value_error(box, wrong):
    with pytest.raises(ValueError):
        wrong(box)


def test_files_that_cannot_be_used_say_so(box, tmp_path):
    with pytest.raises(FileNotFoundError, match="no-such"):
        foveal.open(tmp_path / "no-such.toml")
    odd = tmp_path / "odd.obj"
    odd.write_text("f 1 2 9\n")
    with pytest.raises(foveal.Error, match="odd.obj"):
        foveal.open(odd)
    with pytest.raises(foveal.Error):
        foveal.replay(odd)
    with pytest.raises(foveal.Error, match="picture"):
        foveal.compare(odd, odd)
    with pytest.raises(TypeError):
        foveal.compare(np.zeros((4, 4, 3)), np.zeros((4, 4, 3)))
    with pytest.raises(foveal.Error):
        foveal.open(box, size=(8, 8), bake=odd)
