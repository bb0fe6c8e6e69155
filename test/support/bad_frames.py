"""Files that are no usable frames."""

import cv2
import numpy as np


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def write_frames(folder):
    """Write frames that cannot be used, and return what is said about each."""
    (folder / "empty.png").write_bytes(b"")
    (folder / "text.png").write_text("no picture")
    (folder / "text.npy").write_text("no array")
    (folder / "video.avi").write_text("no video")
    (folder / "folder").mkdir()
    np.save(folder / "small.npy", np.full((30, 200), 0.5, np.float32))
    np.save(folder / "four.npy", np.ones((90, 90, 4), np.float32))
    np.save(folder / "stack.npy", np.ones((2, 90, 90, 3), np.float32))
    np.save(folder / "line.npy", np.ones(90, np.float32))
    np.save(folder / "nothing.npy", np.ones((0, 90), np.float32))
    np.save(folder / "int64.npy", np.ones((90, 90), np.int64))
    np.save(folder / "complex.npy", np.ones((90, 90), np.complex64))
    np.save(folder / "objects.npy", np.array([{}, None]))
    whole = cv2.imencode(".png", np.random.default_rng(0).integers(0, 255, (90, 90)))[1].tobytes()
    (folder / "cut.png").write_bytes(whole[: len(whole) // 2])
