"""What a frame looks like if each blur size were everywhere: the input of the network."""

import dataclasses
import math

import torch
from torch.nn import functional

# Beyond the frame pictures go on mirrored, fading to their mean.
_PAD_PX = 32
# Local mean and contrast are of squares of this side.
_AROUND_PX = 33
# The power of natural pictures falls with the square of frequency, above this one, cycles/px.
_LOWEST_FREQUENCY = 1 / 64
# How much of the light no PSF explains: slants, edges, errors of the optics.
_MODEL_ERROR = 0.01


@dataclasses.dataclass(frozen=True, eq=False)
class Evidence:
    """Inputs of the network, for a batch of frames of one camera.

    Attributes
    ----------
    sharpened : Tensor [batch, levels, rows, columns]
        The frame through the Wiener filter of each level's PSF, less its local mean, in units of
        its local contrast.
    frame : Tensor [batch, 3, rows, columns]
        The frame in the same units.
    contrast : Tensor [batch, 1, rows, columns]
        Logarithm of local contrast over noise.
    """

    sharpened: torch.Tensor
    frame: torch.Tensor
    contrast: torch.Tensor


def transfer_functions(psfs: torch.Tensor, shape: tuple[int, int]) -> torch.Tensor:
    """Fourier transforms [levels, rows, columns // 2 + 1] of PSFs [levels, k, k], centred."""
    rows, columns = (length + 2 * _PAD_PX for length in shape)
    side = psfs.shape[-1]
    whole = psfs.new_zeros(len(psfs), rows, columns)
    whole[:, :side, :side] = psfs
    return torch.fft.rfft2(torch.roll(whole, (-(side // 2),) * 2, (1, 2)))


def evidence(frames: torch.Tensor, noise: torch.Tensor, transfer: torch.Tensor) -> Evidence:
    """Evidence of frames [batch, 3, rows, columns] with a noise [batch] of known deviation.

    `transfer` is of `transfer_functions` for the frames' shape.
    """
    grey = frames.mean(1)
    # Of the mean of three channels with noise of their own.
    noise_grey = noise.view(-1, 1, 1) / math.sqrt(3)
    mean, contrast = _local(grey, noise_grey)
    sharpened = _wiener(grey - mean[:, 0], noise_grey, transfer)
    return Evidence(
        sharpened / contrast,
        (frames - mean) / contrast,
        torch.log(contrast / noise.view(-1, 1, 1, 1).clamp(min=1e-4)),
    )


def _local(grey: torch.Tensor, noise: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Local mean and deviation [batch, 1, rows, columns]; the latter at least that of the noise."""

    def averaged(values: torch.Tensor) -> torch.Tensor:
        reach = _AROUND_PX // 2
        for _ in range(2):
            values = functional.pad(values, (reach,) * 4, "reflect")
            values = functional.avg_pool2d(values, _AROUND_PX, 1)
        return values

    mean = averaged(grey[:, None])
    variance = averaged((grey[:, None] - mean) ** 2)
    return mean, torch.sqrt(variance + 4 * noise[:, None] ** 2 + 1e-8)


def _wiener(grey: torch.Tensor, noise: torch.Tensor, transfer: torch.Tensor) -> torch.Tensor:
    """Frames [batch, rows, columns] through the Wiener filter of each level."""
    rows, columns = grey.shape[-2:]
    spectrum = torch.fft.rfft2(_faded(grey))
    size = [rows + 2 * _PAD_PX, columns + 2 * _PAD_PX]
    down = torch.fft.fftfreq(size[0], device=grey.device)[:, None]
    right = torch.fft.rfftfreq(size[1], device=grey.device)
    squared = (down**2 + right**2).clamp(min=_LOWEST_FREQUENCY**2)
    # Power of natural pictures with the variance of the frame.
    share = 1 / squared
    whole = share.mean() * (grey.shape[-1] // 2 + 1) / len(right)
    variance = grey.var((1, 2)).view(-1, 1, 1) + 1e-8
    power = variance * share / whole
    missing = (noise**2 + _MODEL_ERROR**2 * variance) / power
    inverse = transfer.conj() / (transfer.abs() ** 2 + missing[:, None])
    sharpened = torch.fft.irfft2(spectrum[:, None] * inverse, s=size)
    return sharpened[:, :, _PAD_PX:-_PAD_PX, _PAD_PX:-_PAD_PX]


def _faded(grey: torch.Tensor) -> torch.Tensor:
    """Frames with mirrored borders that fade to zero, [batch, rows + 2 pad, columns + 2 pad]."""
    padded = functional.pad(grey[:, None], (_PAD_PX,) * 4, "reflect")[:, 0]
    ramp = torch.linspace(0, math.pi, _PAD_PX, device=grey.device)
    rise = 0.5 - 0.5 * ramp.cos()

    def window(length: int) -> torch.Tensor:
        return torch.cat([rise, torch.ones(length, device=grey.device), rise.flip(0)])

    rows, columns = grey.shape[-2:]
    return padded * window(rows)[:, None] * window(columns)
