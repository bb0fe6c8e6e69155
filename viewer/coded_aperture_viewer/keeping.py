"""What users keep: the recording that runs, and snapshots of the newest complete frame."""

import logging
import threading
from contextlib import suppress
from pathlib import Path

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Camera
from coded_aperture_viewer.live import Shown
from coded_aperture_viewer.picture_recording import PictureRecording
from coded_aperture_viewer.recording import Recording, new_path, write_snapshot
from coded_aperture_viewer.settings import LookConfig

_NO_FRAME = "no frame has come yet: wait for the first one"


class Keeping:
    """Snapshots and recordings in a folder; frames and requests come from different threads.

    Parameters
    ----------
    output : Path
    camera : Camera
    mosaic : str
        Colour filter array of grey frames whose source states none.
    """

    def __init__(self, output: Path, camera: Camera, mosaic: str) -> None:
        self._output = output
        self._camera = camera
        self._mosaic = mosaic
        self._lock = threading.Lock()
        self._complete: Shown | None = None
        self._recording: Recording | PictureRecording | None = None
        self._is_ended = False

    @property
    def recorded(self) -> int | None:
        """Number of frames in the recording; None if none runs."""
        recording = self._recording
        return None if recording is None else recording.count

    def add(self, shown: Shown, is_complete: bool) -> None:
        """Add a frame to the recording, and keep it for snapshots if it is complete."""
        if shown.frame is None:
            return
        with self._lock:
            if is_complete or self._complete is None:
                self._complete = shown
            if self._recording is None or shown.capture is None or shown.settings.run.paused:
                return
            try:
                self._recording.add(shown.capture)
            except (InputError, OSError) as error:
                logging.error("recording stopped: %s", error)
                with suppress(InputError, OSError):  # the bag cannot be finished either
                    self._end_recording()

    def snapshot(self, look: LookConfig) -> str:
        """Write the newest complete frame, with a page's picture of it; return the folder."""
        with self._lock:
            shown = self._complete
        if shown is None:
            raise InputError(_NO_FRAME)
        picture = shown.pictures.get(look.made_from)
        return str(write_snapshot(self._output, shown, picture, self._camera))

    def toggle_recording(self, form: str = "bag") -> str:
        """Start a recording, a bag or a folder of PNG (`png`), or end the one that runs.

        Returns
        -------
        str
            A line for the page.
        """
        with self._lock:
            if self._recording is not None:
                return self._end_recording()
            if self._complete is None:
                raise InputError(_NO_FRAME)
            if self._is_ended:
                raise InputError("the viewer ends: nothing is recorded")
            self._output.mkdir(parents=True, exist_ok=True)
            path = new_path(self._output, "recording")
            if form == "png":
                self._recording = PictureRecording(path)
            else:
                self._recording = Recording(path, self._camera, self._mosaic)
            return f"recording to {self._recording.path}"

    def end(self) -> None:
        """Finish the recording, if one runs; none is started after this."""
        with self._lock:
            self._is_ended = True
            try:
                finished = self._end_recording()
            except (InputError, OSError) as error:
                logging.error("recording not finished: %s", error)
                return
        if finished:
            logging.warning("recorded %s", finished)

    def _end_recording(self) -> str:
        recording, self._recording = self._recording, None
        if recording is None:
            return ""
        recording.close()
        return f"{recording.path}: {recording.count} frames"
