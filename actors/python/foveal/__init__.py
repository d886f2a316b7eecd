"""Walks through lit scenes, their light, references and replays, as numpy arrays.

    import foveal

    with foveal.open("scenes/box/box.toml", size=(320, 240)) as walk:
        camera = walk.cameras["main"]
        frame = walk.frame(camera, deadline=0.1)
        print(frame.traced, "samples,", frame.standing)
        frame.picture  # uint8, rows × columns × 3, sRGB
        frame.depth, frame.ids, frame.error

All arrays have the picture's first row first. Times are seconds, angles degrees.
"""

from ._foveal import (
    Bake,
    Camera,
    Comparison,
    Error,
    Frame,
    Path,
    Reference,
    Replay,
    Walk,
    __version__,
    bake,
    compare,
    open,
    reference,
    replay,
)

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
