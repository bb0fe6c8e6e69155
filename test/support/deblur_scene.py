"""PSFs and frames that the tests of deblurring share, each made once."""

from functools import cache

import numpy as np
from scipy import ndimage, signal

from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.deblur.psf_basis import PsfBasis
from coded_aperture_ros.optics import Mask, PsfStack, render_psf, render_psf_stack

NOISE = 0.002


@cache
def levin_stack() -> PsfStack:
    """Blur sizes of 1 to 11 px."""
    return render_psf_stack(Mask.named("levin"), np.linspace(1.0, 11.0, 11))


@cache
def levin_basis() -> PsfBasis:
    """The kernels of `levin_stack`."""
    return PsfBasis.from_stack(levin_stack())


@cache
def deblurrer(**options) -> Deblurrer:
    """A deblurrer for `levin_stack` that several tests use: no frames of a video."""
    assert "temporal_frames" not in options
    return Deblurrer(levin_stack(), DeblurConfig(**options))


def edges_and_texture(cells, cell_px, seed=0):
    """Squares of random brightness with fine texture."""
    random = np.random.default_rng(seed)
    image = np.kron(random.random(cells), np.ones((cell_px, cell_px)))
    texture = ndimage.gaussian_filter(random.random(image.shape), 1.5)
    return (0.5 * image + 0.2 * texture).astype(np.float32)


def blurred(image, size_px, noise=NOISE, seed=1):
    """A plane behind levin's mask, whose border goes on beyond the frame."""
    psf = render_psf(Mask.named("levin"), size_px)
    padded = np.pad(image, len(psf) // 2, mode="edge")
    coded = signal.fftconvolve(padded, psf, mode="valid")
    return (coded + np.random.default_rng(seed).normal(0, noise, image.shape)).astype(np.float32)


def relief(shape):
    """Blur sizes of a slant with a square in front of it."""
    blur = np.broadcast_to(np.linspace(5, 11, shape[1], dtype=np.float32), shape).copy()
    blur[30:70, 40:80] = 2.5
    return blur


def assert_adjoint(operator, seed=1):
    """The dot-product test of a `BlurOperator`, with a relative error."""
    random = np.random.default_rng(seed)
    planes = 1 if operator.hidden is None else 2
    scene = random.normal(size=(planes, *operator.scene_shape)).astype(np.float32)
    frame = random.normal(size=operator.shape).astype(np.float32)
    blurred_scene = operator.forward(scene)
    spread_frame = operator.adjoint(frame)
    forward = np.vdot(blurred_scene.astype(np.float64), frame)
    back = np.vdot(scene.astype(np.float64), spread_frame)
    scale = float(np.linalg.norm(blurred_scene) * np.linalg.norm(frame))
    assert abs(forward - back) < 1e-5 * scale
