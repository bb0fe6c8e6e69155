"""Deblurrers that work together: of the parts of an image, or of its colour channels."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.deblur.config import DeblurConfig
from coded_aperture_ros.deblur.deblurrer import Deblurrer
from coded_aperture_ros.deblur.uncertainty import Uncertainty
from coded_aperture_ros.optics import PsfStack


class SeveralDeblurrers:
    """What deblurrers that work together have in common; see `Deblurrer`."""

    def __init__(self, stack: PsfStack, deblurrers: Sequence[Deblurrer]) -> None:
        self.stack = stack
        self._deblurrers = tuple(deblurrers)

    @property
    def config(self) -> DeblurConfig:
        """Settings."""
        return self._deblurrers[0].config

    @property
    def removes_motion(self) -> bool:
        """Whether the method can remove motion blur too."""
        return self._deblurrers[0].removes_motion

    def prepare(self, shape: Shape) -> None:
        """Make the filters for frames of `shape` (rows, columns) before the first one."""
        for deblurrer in self._deblurrers:
            deblurrer.prepare(shape)

    def reset(self) -> None:
        """Forget the frames so far: the next one begins another video."""
        for deblurrer in self._deblurrers:
            deblurrer.reset()

    def reconfigure(self, config: DeblurConfig) -> None:
        """Use other settings from the next frame on."""
        for deblurrer in self._deblurrers:
            deblurrer.reconfigure(config)

    def close(self) -> None:
        """End the worker threads."""
        for deblurrer in self._deblurrers:
            deblurrer.close()

    def uncertainty(
        self,
        frame: FloatArray,
        sharp: FloatArray,
        blur_size_px: FloatArray,
        noise: float | None = None,
    ) -> Uncertainty:
        """Standard deviation of each pixel; see `Deblurrer.uncertainty`.

        Visibility through the aperture is computed with the PSFs of the `stack`.
        """
        whole = Deblurrer(self.stack, self.config)
        try:
            return whole.uncertainty(frame, sharp, blur_size_px, noise)
        finally:
            whole.close()


class ChannelDeblurrer(SeveralDeblurrers):
    """All-in-focus frames whose colour channels have PSFs of their own.

    Parameters and methods are those of `Deblurrer`; the stack has `channel_psfs`. A frame without
    colour is deblurred with the PSFs of the mean of the channels.
    """

    def __init__(
        self, stack: PsfStack, config: DeblurConfig | None = None, progress: Progress = iter
    ) -> None:
        if stack.channel_psfs is None:
            raise InputError("channel_psfs: the stack has none")
        psfs = (*stack.channel_psfs, stack.psfs)  # those of the mean are the last
        stacks = [dataclasses.replace(stack, psfs=one, channel_psfs=None) for one in psfs]
        super().__init__(stack, [Deblurrer(one, config, progress) for one in stacks])

    def deblur(
        self,
        frame: FloatArray,
        blur_size_px: FloatArray,
        noise: float | None = None,
        motion_px: FloatArray | None = None,
    ) -> FloatArray:
        """All-in-focus frame, float32, shape of `frame`; see `Deblurrer.deblur`."""
        *channels, grey = self._deblurrers
        if frame.ndim == 2 or frame.shape[2] != len(channels):
            return grey.deblur(frame, blur_size_px, noise, motion_px)
        sharp = [
            deblurrer.deblur(
                np.ascontiguousarray(frame[..., channel]), blur_size_px, noise, motion_px
            )
            for channel, deblurrer in enumerate(channels)
        ]
        return np.stack(sharp, axis=-1)
