"""Check of a camera, a bank and frames before they are used."""

import dataclasses
import math
from typing import Any

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import CAUSE_TEXTS, DepthConfig, DepthEstimate
from coded_aperture_ros.depth.decoders.network import unsupported_reason
from coded_aperture_ros.depth.quality import unchecked_reason
from coded_aperture_ros.design.setting import Setting, design_setting, resolutions_m
from coded_aperture_ros.frames import Frame
from coded_aperture_ros.likelihood.bank import FilterBank, check_frame_size, check_setting
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.optics.field_prior import unmeasured_defocus
from coded_aperture_ros.optics.nominal import grows_evenly
from coded_aperture_ros.optics.pupil import wider_mask_advice
from coded_aperture_ros.pipeline import FramePipeline

OK = "ok"
WARNING = "warning"
FAILED = "failed"
# A hole with less blur, px, codes nothing. The mean over the depth range counts: at the end that is
# nearer to the focus less is enough, because little blur is told from more by the whole mask.
_MIN_HOLE_BLUR_PX = 0.5
_MIN_LEVELS = 2.0
_FEW_LEVELS = 5.0
# Relative error of depth that the unmeasured field of a lens may leave.
_FIELD_RIGHT = 0.05
_MIN_OPEN_FRACTION = 0.15
_SATURATED_WARNING = 0.01
_SATURATED_FAILED = 0.1
_NOISE_FACTOR = 2.0
_MIN_KNOWN_SHARE = 0.2


@dataclasses.dataclass(frozen=True)
class Finding:
    """Result of one check."""

    about: str  # what, in a few words
    state: str  # `OK`, `WARNING` or `FAILED`
    text: str  # what was found
    remedy: str = ""  # what to do about it; empty if nothing
    numbers: dict[str, Any] = dataclasses.field(default_factory=dict)  # for machines


def camera_findings(camera: Camera, near_m: float, far_m: float) -> list[Finding]:
    """Findings about a camera over a depth range: resolution, blur, diffraction, light, field.

    Raises `InputError` if the range is not one of the camera's.
    """
    setting = design_setting(camera, near_m, far_m)
    return [
        _resolution(camera, setting, near_m, far_m),
        _blur(camera, setting),
        _diffraction(setting),
        _open_area(setting),
        _field(camera, near_m, far_m),
    ]


def _resolution(camera: Camera, setting: Setting, near_m: float, far_m: float) -> Finding:
    resolutions = resolutions_m(camera, near_m, far_m)
    steps = ", ".join(
        f"{step:.2g} m at {depth:.3g} m" if math.isfinite(step) else f"none beyond {depth:.3g} m"
        for depth, step in resolutions.values()
    )
    state = OK
    if setting.levels < _FEW_LEVELS:
        state = FAILED if setting.levels < _MIN_LEVELS else WARNING
    wider = wider_mask_advice(camera.mask, camera.mask_extent_mm, camera.pupil_mm)
    remedy = f"focus nearer to the scene, or use {wider}: see design"
    return Finding(
        "depth resolution",
        state,
        f"{setting.levels:.3g} depths can be told apart from {near_m:g} to {far_m:g} m, "
        f"steps of {steps}",
        "" if state == OK else remedy,
        {
            "levels": setting.levels,
            **{f"{name}_m": step for name, (_, step) in resolutions.items()},
        },
    )


def _blur(camera: Camera, setting: Setting) -> Finding:
    holes_px = setting.hole_blur_mean_px
    largest_px = max(setting.hole_blur_near_px, setting.hole_blur_far_px)
    state = OK
    if not holes_px > _MIN_HOLE_BLUR_PX:
        state = FAILED if largest_px < _MIN_HOLE_BLUR_PX else WARNING
    wider = wider_mask_advice(camera.mask, camera.mask_extent_mm, camera.pupil_mm)
    remedy = f"holes below half a pixel code nothing: use {wider}, or focus farther from the scene"
    return Finding(
        "blur",
        state,
        f"the mask blurs by {abs(setting.blur_size_near_px):.3g} px at the near end and "
        f"{abs(setting.blur_size_far_px):.3g} px at the far end, its smallest hole by "
        f"{holes_px:.2g} px in the mean",
        "" if state == OK else remedy,
        {"smallest_hole_px": holes_px},
    )


def _diffraction(setting: Setting) -> Finding:
    hidden = not setting.diffraction_is_negligible
    f_number = "" if setting.f_number is None else f"f/{setting.f_number:.2g} over the mask, "
    return Finding(
        "diffraction",
        WARNING if hidden else OK,
        f"{f_number}the smallest hole of {setting.hole_width_mm:.2g} mm has an Airy disc "
        f"{setting.airy_width_px:.2g} px wide",
        f"use holes of {setting.diffraction_limit_mm:.2g} mm or more" if hidden else "",
        {"airy_width_px": setting.airy_width_px, "f_number": setting.f_number},
    )


def _open_area(setting: Setting) -> Finding:
    light = setting.open_fraction
    dark = light < _MIN_OPEN_FRACTION
    return Finding(
        "light",
        WARNING if dark else OK,
        f"the mask passes {100 * light:.0f} % of the light of its open square, "
        f"{-math.log2(light):.1f} stops less",
        "expose longer, or use a mask with more open area" if dark else "",
        {"open_fraction": light},
    )


def _field(camera: Camera, near_m: float, far_m: float) -> Finding:
    remedy = "measure it: calibrate field, with planes that fill the picture"
    if camera.field_is_measured:
        return Finding("field", OK, "known away from the axis, too")
    defocus = unmeasured_defocus(camera, (camera.image_height, camera.image_width))
    if defocus is None:
        text = "not measured; without focal_length_mm it is trusted all over"
        return Finding("field", WARNING, text, remedy)
    middle_m = min(math.sqrt(near_m * far_m), 2 * near_m)
    corner_px = float(defocus.max()) * camera.blur_per_dioptre_px
    share = float((defocus <= _FIELD_RIGHT / middle_m).mean())
    return Finding(
        "field",
        WARNING if share < 1 else OK,
        f"not measured: blur may be {corner_px:.2g} px off in the corners; at {middle_m:.2g} m "
        f"depth is good to 5 % in {100 * share:.0f} % of the picture, and elsewhere doubted",
        remedy if share < 1 else "",
        {"corner_px": corner_px, "measurable_share": share},
    )


def bank_findings(bank: FilterBank) -> list[Finding]:
    """Findings about a bank by itself: its levels, and in one line what it does not cover."""
    stack = bank.stack
    depths_m = "depths unknown"
    if stack.depths_m is not None:
        near_m, far_m = sorted(stack.depths_m[[0, -1]].tolist())
        depths_m = f"{near_m:.3g} to {far_m:.3g} m"
    sizes = "without blur sizes"
    if stack.in_pixels:
        first_px, last_px = stack.blur_sizes_px[[0, -1]]
        sizes = f"blur of {first_px:.3g} to {last_px:.3g} px{' (nominal)' * stack.nominal}"
    of_channels = ", PSFs of each colour channel" if bank.channels else ""
    text = f"{bank.levels}, {sizes}, {depths_m}{of_channels}; from {bank.learned_from}"
    missing = _not_covered(bank)
    return [
        Finding("levels", OK, text, "", {"levels": bank.levels, "nominal": stack.nominal}),
        Finding(
            "not covered",
            WARNING if missing else OK,
            "; ".join(missing) or "nothing: refinement, check of fit, confidence and metres work",
            "learn the bank with sizes_px, or with --depths" if missing else "",
            {"count": len(missing)},
        ),
    ]


def _not_covered(bank: FilterBank) -> list[str]:
    stack = bank.stack
    uneven = stack.nominal and not grows_evenly(stack)
    reason, unchecked = unsupported_reason(bank, bank.stride_px), unchecked_reason(stack)
    return [
        text
        for text, applies in (
            (f"no refinement: {reason}", bool(reason)),
            (f"frames are not checked: {unchecked}", bool(unchecked)),
            ("confidence is that of masks", not (stack.in_pixels or bank.reliability)),
            ("levels in place of metres", stack.depths_m is None),
            ("sizes are not those of a mask: no views, no other focus", stack.nominal),
            ("PSFs do not grow evenly by level: occlusion at depth edges is not modelled", uneven),
            (
                "the check of fit knows masks only: learn the bank again",
                uneven and not bank.own_fit,
            ),
        )
        if applies
    ]


class FrameCheckup:
    """Checks of single frames, for use with a bank, and with a camera if there is one.

    Raises `InputError` if the bank is not for the camera.
    """

    def __init__(self, camera: Camera | None, bank: FilterBank) -> None:
        if camera is not None:
            check_setting(bank, camera)
        self._camera = camera
        self._bank = dataclasses.replace(bank, noise=0.0)
        self._pipeline: FramePipeline | None = None  # for frames of one size

    def findings(self, frame: Frame) -> list[Finding]:
        """Findings about a frame: size, saturation, noise, fit, share of known depth."""
        height, width = frame.shape
        try:
            check_frame_size(self._bank, *frame.whole_size)
            camera = self._camera and self._camera.resized(*frame.whole_size)
        except InputError as error:
            return [_failed("size", error)]
        found = [Finding("size", OK, f"{width}x{height}"), _saturation(frame.light)]
        # The estimated noise is compared with the camera file's, which must not be used for it.
        camera = camera and dataclasses.replace(camera, noise=0.0, noise_gain=0.0)
        try:
            if self._pipeline is None:
                self._pipeline = FramePipeline(self._bank, camera, deblur=None)
            self._pipeline.reconfigure(camera=camera)
            estimate = self._pipeline(frame)
        except InputError as error:
            return [*found, _failed("frame", error)]
        return [*found, self._noise(estimate), self._fit(estimate), _known(estimate)]

    def close(self) -> None:
        """End the pipeline's threads."""
        if self._pipeline is not None:
            self._pipeline.close()

    def _noise(self, estimate: DepthEstimate) -> Finding:
        camera, found = self._camera, estimate.noise
        expected = 0.0 if camera is None else camera.noise
        numbers = {"noise": found, "noise_of_the_file": expected}
        if camera is None or not expected:
            silent = "there is no camera file" if camera is None else "no noise in the camera file"
            return Finding("noise", OK, f"{found:.4f}; {silent}", "", numbers)
        differs = not 1 / _NOISE_FACTOR <= found / expected <= _NOISE_FACTOR
        return Finding(
            "noise",
            WARNING if differs and not camera.noise_gain else OK,
            f"{found:.4f}, the camera file says {expected:.4f}",
            "measure it with calibrate noise" if differs else "",
            numbers,
        )

    def _fit(self, estimate: DepthEstimate) -> Finding:
        health = estimate.health
        if health is None:
            reason = unchecked_reason(self._bank.stack) or "the frame has too little texture"
            return Finding("fit", WARNING, f"not checked: {reason}")
        numbers = {"health": health.value, "cause": health.cause}
        remedy = "" if health.fits else CAUSE_TEXTS[health.cause].partition(": ")[2]
        return Finding("fit", OK if health.fits else FAILED, str(health), remedy, numbers)


def _failed(about: str, error: InputError) -> Finding:
    text, _, remedy = str(error).rpartition(": ")
    return Finding(about, FAILED, text or remedy, remedy)


def _saturation(frame: FloatArray) -> Finding:
    share = float((~(frame < DepthConfig().saturation)).mean())
    black = float((frame <= 0).mean())
    state = FAILED if share > _SATURATED_FAILED else WARNING if share > _SATURATED_WARNING else OK
    remedy = "" if state == OK else "expose for less time: saturated light has no depth"
    if state == OK and black > _SATURATED_WARNING:
        state = WARNING
        remedy = "expose longer, or lower the black level: what is cut off is lost"
    text = f"{100 * share:.1f} % saturated, {100 * black:.1f} % black"
    return Finding("light", state, text, remedy, {"saturated": share, "black": black})


def _known(estimate: DepthEstimate) -> Finding:
    share = float(np.isfinite(estimate.level).mean())
    # Where a frame does not fit, that is why there is little depth.
    fits = estimate.health is None or estimate.health.fits
    few = share < _MIN_KNOWN_SHARE
    return Finding(
        "depth",
        WARNING if few else OK,
        f"known at {100 * share:.0f} % of the pixels",
        "more texture, light, or a shorter exposure is needed" if few and fits else "",
        {"known": share},
    )
