import os
from collections.abc import Iterator
from types import TracebackType
from typing import Literal, final

import numpy as np
import numpy.typing as npt

__all__ = [
    "Bake",
    "Camera",
    "Comparison",
    "Error",
    "Frame",
    "Path",
    "Reference",
    "Replay",
    "Walk",
    "__version__",
    "bake",
    "compare",
    "open",
    "reference",
    "replay",
]

__version__: str

_File = str | os.PathLike[str]
_Three = tuple[float, float, float]
_Picture = npt.NDArray[np.uint8] | npt.NDArray[np.float32] | _File

class Error(Exception):
    """What the program would say and end with: a file that cannot be used, a limit that cannot be met, a replay that
    diverges. What makes no sense as an argument is a ValueError, a file that is not there a FileNotFoundError."""

@final
class Camera:
    """A pinhole camera; equal where every number is."""

    def __new__(cls, eye: _Three, target: _Three, up: _Three = ..., fov_y: float = 60.0) -> Camera:
        """Looks from `eye` to `target`; `fov_y` is the vertical field of view in degrees."""
    @property
    def eye(self) -> _Three: ...
    @property
    def target(self) -> _Three: ...
    @property
    def up(self) -> _Three: ...
    @property
    def fov_y(self) -> float:
        """Vertical field of view, degrees."""
    def moved(self, right: float = 0.0, up: float = 0.0, forward: float = 0.0) -> Camera:
        """The same camera elsewhere: so many units of the scene to the right, upwards in the picture, and ahead."""
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class Path:
    """A path that a camera goes along, as the scene's files name it."""

    @property
    def name(self) -> str: ...
    @property
    def duration(self) -> float:
        """Seconds."""
    def at(self, seconds: float) -> Camera:
        """Where the camera is; before the first key and after the last it stands."""

@final
class Frame:
    """A frame as it was shown. Arrays are made when they are asked for, each time anew."""

    @property
    def index(self) -> int:
        """Its number, from 0."""
    @property
    def view(self) -> int:
        """Which view it is of: a camera that moves begins one with each frame."""
    @property
    def camera(self) -> Camera | None:
        """Where it is seen from."""
    @property
    def picture(self) -> npt.NDArray[np.uint8]:
        """Rows × columns × 3: what was shown, sRGB."""
    @property
    def depth(self) -> npt.NDArray[np.float32]:
        """Rows × columns: depth along the view axis, units of the scene; infinite where nothing is."""
    @property
    def ids(self) -> npt.NDArray[np.uint32]:
        """Rows × columns: which object is corrected by samples here, an index into `objects` of the walk; 0 where nothing
        has to be, as on diffuse surfaces."""
    @property
    def error(self) -> npt.NDArray[np.float32]:
        """Rows × columns: visible error that each object shows still, just noticeable differences, as the allocator
        estimates it from how far its samples were from what was shown (Dumont 2003, Eq. (1)). 0 where nothing is left to
        trace, NaN where nothing is known yet."""
    @property
    def noise(self) -> npt.NDArray[np.float32]:
        """Rows × columns: where the view is refined (`refine`), the standard error of displayed values in its tile, 0 to
        1; NaN elsewhere."""
    @property
    def quality(self) -> float | None:
        """−1 × the mean visible error of all pixels; 0 where the view has converged, None while nothing is known."""
    @property
    def standing(self) -> Literal["growing", "converged", "refined"]:
        """How far the view has come. A converged one shows each pixel's own ray, bit for bit `reference`."""
    @property
    def traced(self) -> int:
        """Fresh samples since the frame before; 0 in a replay, which counts none."""
    @property
    def reused(self) -> int:
        """Reprojected samples that painted something; 0 in a replay."""
    @property
    def expired(self) -> int:
        """Samples that no longer held for this view; 0 in a replay."""
    @property
    def stages(self) -> dict[str, float]:
        """Seconds that its stages took; empty in a replay."""
    @property
    def events(self) -> list[str]:
        """What happened since the frame before, in words."""
    @property
    def seconds(self) -> float | None:
        """From its beginning until it was shown; None in a replay."""
    @property
    def hash(self) -> int:
        """Hash of the picture, as recordings hold it."""

@final
class Walk:
    """A walk at work, on threads of its own. Any Python thread may ask it; whoever waits lets the others go on."""

    @property
    def title(self) -> str: ...
    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
    @property
    def cameras(self) -> dict[str, Camera]:
        """The scene's cameras; the first is where a walk begins."""
    @property
    def paths(self) -> dict[str, Path]: ...
    @property
    def objects(self) -> list[str]:
        """Names of objects, by the ids of `Frame.ids`."""
    @property
    def warnings(self) -> list[str]:
        """What went wrong without stopping anything."""
    def frame(self, camera: Camera, deadline: float = 0.1) -> Frame:
        """A frame seen from `camera`, shown after `deadline` seconds with what has come until then."""
    def converge(self, camera: Camera, timeout: float = 600.0) -> Frame:
        """The frame that a still view ends with: converged, or refined where `refine` was asked for, under its final light."""
    def radiance(self) -> npt.NDArray[np.float32]:
        """Rows × columns × 3: linear radiance of the view as it is now."""
    def close(self) -> None:
        """Ends the walk; its recording, if any, is whole then. Also at the end of a `with` block."""
    def __enter__(self) -> Walk: ...
    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None, /
    ) -> None: ...

def open(
    scene: _File,
    *,
    size: tuple[int, int] = ...,
    tracers: int | None = None,
    policy: Literal["attention", "coverage", "uniform", "random", "utility"] = "utility",
    seed: int = 0,
    fps: float | None = None,
    baked: bool = False,
    quick: bool = False,
    bake: _File | None = None,
    cache: _File | None = None,
    variant: str | None = None,
    texture_budget: int | None = None,
    refine: float | None = None,
    refine_samples: int = 256,
    record: _File | None = None,
) -> Walk:
    """Opens an OBJ or glTF file or a sidecar, and starts a walk in it.

    size: columns and rows. tracers: None is one for each core. policy: which samples come first. fps: what a recording says
    the frames were to come at. baked: bake first, instead of while one walks; quick: stay with the first estimate of the
    light; bake: take it from this file. cache: folder of kept bakes, else FOVEAL_CACHE or that of the user. variant: of
    glTF's materials. texture_budget: most bytes of textures. refine: go on after a view has converged, until the standard
    error of displayed values is below this, with at most refine_samples in a pixel. record: record the walk into this file,
    for `replay` and `foveal replay`.
    """

@final
class Bake:
    """Light that was made, and where it is kept."""

    @property
    def file(self) -> str | os.PathLike[str]: ...
    @property
    def error(self) -> float:
        """Relative error of irradiance, as points that the map was not made of tell it, a share."""
    @property
    def complete(self) -> bool:
        """Whether the error that was asked for was met."""
    @property
    def cached(self) -> bool:
        """Whether it was there before."""
    @property
    def texels(self) -> int: ...
    @property
    def seconds(self) -> float: ...
    @property
    def warnings(self) -> list[str]: ...

def bake(
    scene: _File,
    *,
    error: float = 0.02,
    time: float | None = None,
    texels: int | None = None,
    seed: int = 1,
    out: _File | None = None,
    cache: _File | None = None,
    again: bool = False,
) -> Bake:
    """Makes the light that diffuse surfaces receive, or finds it where it is kept.

    error: share at which it ends; time: seconds after which it ends. out: a file for it, else the cache, where walks find
    it. again: also where a kept one meets all that.
    """

@final
class Reference:
    """A picture without a budget."""

    @property
    def radiance(self) -> npt.NDArray[np.float32]:
        """Rows × columns × 3, linear."""
    @property
    def picture(self) -> npt.NDArray[np.uint8]:
        """Rows × columns × 3: as the scene's display shows it, sRGB."""
    @property
    def samples(self) -> int:
        """Of each pixel."""
    @property
    def error(self) -> float | None:
        """Path and truth: mean relative standard error of 8 × 8 blocks, where the number of samples is a multiple of 16.
        Traced with more than one sample: below this, 95 % certain."""
    @property
    def seconds(self) -> float: ...
    @property
    def kind(self) -> Literal["traced", "path", "truth"]: ...

def reference(
    scene: _File,
    camera: str | Camera | None = None,
    *,
    kind: Literal["traced", "path", "truth"] = "traced",
    samples: int = 1,
    size: tuple[int, int] = ...,
    seed: int = 0,
    until_error: float | None = None,
    time: float | None = None,
    quick: bool = False,
    bake: _File | None = None,
    cache: _File | None = None,
) -> Reference:
    """A picture to hold walks against.

    kind: `traced` is what a still view converges to (and, with more samples, is refined to), `path` an unbiased path tracer,
    `truth` finds all light by bidirectional paths. until_error, time: path and truth go on until their 8 × 8 blocks are that
    sure, or so many seconds are over. camera: a name, any Camera, or None for the scene's first.
    """

@final
class Comparison:
    """How far two pictures are apart."""

    @property
    def flip(self) -> float:
        """Mean FLIP, 0 to 1 (Andersson et al. 2020)."""
    @property
    def flip_map(self) -> npt.NDArray[np.float32]:
        """Rows × columns."""
    @property
    def psnr(self) -> float | None:
        """dB; None where both are shown alike."""
    @property
    def mse(self) -> float: ...
    @property
    def relmse(self) -> float:
        """Mean squared error relative to the reference, of linear values."""
    @property
    def delta_e(self) -> float: ...
    @property
    def max_abs(self) -> float: ...
    @property
    def identical(self) -> bool:
        """Whether every value is the same to the last bit."""

def compare(test: _Picture, reference: _Picture, *, exposure: float = 1.0) -> Comparison:
    """Compares arrays of rows, columns and 3 bands (uint8: sRGB, float32: linear) or files (PNG, JPEG, HDR, EXR)."""

@final
class Replay:
    """A recorded walk. Iterated, it gives each frame as it was shown, bit for bit; indexed, the frame of that number."""

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
    @property
    def objects(self) -> list[str]:
        """Names of objects, by the ids of `Frame.ids`."""
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[Frame]: ...
    def __getitem__(self, index: int, /) -> Frame: ...

def replay(
    recording: _File,
    *,
    threads: int | None = None,
    scene: _File | None = None,
    bake: _File | None = None,
    cache: _File | None = None,
) -> Replay:
    """Opens what `open(…, record=…)` or `foveal walk --record` left.

    threads: of the replay, None is one for each core; the frames are the same. scene, bake, cache: where these have moved.
    Raises Error where the replay diverges from the recording.
    """
