"""Depth from coded frames: each goes through a list of stages."""

import dataclasses
from contextlib import ExitStack

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, Shape
from coded_aperture_ros.core.workers import Workers, thread_count
from coded_aperture_ros.depth.config import DepthConfig
from coded_aperture_ros.depth.decoders.network import (
    CELL_PX,
    DecoderChoice,
    choose_decoder,
    small_bank,
)
from coded_aperture_ros.depth.decoders.regularize import Regularizer, regularizer
from coded_aperture_ros.depth.decoders.sides import FocalSides
from coded_aperture_ros.depth.estimate import DepthEstimate, check_map_size
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.quality import FitCheck, OpticsFit, OwnFit, unchecked_reason
from coded_aperture_ros.depth.stage import Plan, SecondFocus, Stage, Work, run
from coded_aperture_ros.depth.stages import make_back, make_front
from coded_aperture_ros.depth.stages.field_doubt import field_note
from coded_aperture_ros.frames import Frame, KnownNoise
from coded_aperture_ros.likelihood import Likelihood, LikelihoodModel, torch_device
from coded_aperture_ros.likelihood.bank import FilterBank
from coded_aperture_ros.optics import Camera

# Least `Mask.asymmetry` of a mask that distinguishes the sides of the focal plane.
_LEAST_ASYMMETRY = 0.05


@dataclasses.dataclass(frozen=True, eq=False)
class _Planned:
    """Stages for frames of one size, and what they share."""

    plan: Plan
    front: tuple[Stage, ...]
    back: tuple[Stage, ...]

    @property
    def stages(self) -> tuple[Stage, ...]:
        return (*self.front, *self.back)

    def close(self) -> None:
        for stage in self.stages:
            stage.close()
        self.plan.workers.close()


class DepthEstimator:
    """Turns coded frames into depth.

    The stages are made for the size of the first frame, and anew when the size changes. With
    `DepthConfig.temporal_frames` the frames are those of a video, in order; `reset` starts another.
    Not for several threads at once.

    Parameters
    ----------
    model : LikelihoodModel
        A filter bank, or the model of another method.
    config : DepthConfig, optional
    camera : Camera, optional
        Converts blur sizes to metres, unless the model has measured depths. Its noise is used if
        the configuration states none.
    regularize : Regularizer, optional
        In place of the one that the configuration names.
    second_focus : SecondFocus, optional
        Adds the cost of a second frame at another focus distance; see `FocusPair`.
    patches_tell_sides : bool, optional
        Whether costs alone distinguish the sides of the focal plane, as those of two focus settings
        do.

    Raises
    ------
    InputError
        If the model is not for the camera.

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros.likelihood.bank import learn_bank
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("levin"), np.linspace(2, 9, 15)))
    >>> frame = np.random.default_rng(0).random((96, 128), np.float32)
    >>> DepthEstimator(bank).estimate(frame).level.shape
    (96, 128)

    References
    ----------
    M. Martinello, Coded Aperture Imaging, PhD thesis, Heriot-Watt University, 2012, chapters 4-8.
    """

    def __init__(
        self,
        model: LikelihoodModel,
        config: DepthConfig | None = None,
        camera: Camera | None = None,
        *,
        regularize: Regularizer | None = None,
        second_focus: SecondFocus | None = None,
        patches_tell_sides: bool = False,
    ) -> None:
        self.config = config or DepthConfig()
        self.camera = camera
        # As it was given, and as this camera's view has it.
        self.source_model = model
        self.model = model.for_view(camera)
        self.known_noise = KnownNoise.from_sources(self.config, camera, model)
        self._levels = Levels.from_model(model, camera)
        self._regularize = regularize
        self._second_focus = second_focus
        self._patches_tell_sides = patches_tell_sides
        self._planned: _Planned | None = None

    @property
    def depths_m(self) -> DoubleArray | None:
        """Depth of each level [m], from the measured bank or else the camera; None if unknown."""
        return self._levels.depths_m

    def estimate(self, frame: Frame | FloatArray, size: Shape | None = None) -> DepthEstimate:
        """Depth of every pixel of a frame.

        Parameters
        ----------
        frame : Frame or ndarray, float32 [rows, columns] or [rows, columns, 3]
            Linear light in [0, 1]; NaN and saturated pixels are left out.
        size : (int, int), optional
            Rows and columns of the maps, which cover the whole frame; the frame's by default.

        Raises
        ------
        InputError
            If the frame has a wrong shape or type, or is smaller than the model's window, or `size`
            is not that of a map.
        """
        work = self.run_front(frame, size)
        self.run_back(work)
        return work.estimate()

    def begin(self, frame: Frame | FloatArray, size: Shape | None = None) -> Work:
        """Work on a frame before any stage; raises what `estimate` does."""
        frame = Frame.of(frame)
        check_map_size(size)
        frame.check()
        return Work(frame, size or frame.shape)

    def run_front(self, frame: Frame | FloatArray, size: Shape | None = None) -> Work:
        """Work on a frame up to the cost of every level; raises what `estimate` does."""
        work = self.begin(frame, size)
        run(self.front(work.frame.shape), work)
        return work

    def run_back(self, work: Work) -> None:
        """Go on from the cost of every level to the maps."""
        run(self.back(work.frame.shape), work)

    def front(self, shape: Shape) -> tuple[Stage, ...]:
        """Stages from light to the cost of every level, for frames of a shape."""
        return self._stages_for(shape).front

    def back(self, shape: Shape) -> tuple[Stage, ...]:
        """Stages from cost to maps, for frames of a shape."""
        return self._stages_for(shape).back

    def reset(self) -> None:
        """Forget the frames so far: the next one begins another video."""
        if self._planned is not None:
            for stage in self._planned.stages:
                stage.reset()

    def close(self) -> None:
        """End the threads that the work was shared among."""
        if self._planned is not None:
            self._planned.close()
            self._planned = None

    def _stages_for(self, shape: Shape) -> _Planned:
        """Stages for frames of a size; another size starts another video."""
        if self._planned is None or shape != self._planned.plan.shape:
            planned = self._new_stages(shape)
            # Only now: a frame that does not suit leaves the old ones as they are.
            self.close()
            self._planned = planned
        return self._planned

    def _new_stages(self, shape: Shape) -> _Planned:
        config, model, camera = self.config, self.model, self.camera
        threads = thread_count(config.threads)
        with ExitStack() as unless_made:
            stride_px = config.stride_px or model.stride_px
            likelihood = model.plan(shape, stride_px, config.backend, threads)
            unless_made.callback(likelihood.close)
            workers = Workers(threads)
            unless_made.callback(workers.close)
            decoder = self._choose_decoder(stride_px)
            small = self._plan_small_patches(shape, threads) if decoder.learned else None
            if small is not None:
                unless_made.callback(small.close)
            plan = Plan(
                shape=shape,
                model=model,
                levels=self._levels,
                likelihood=likelihood,
                known_noise=self.known_noise,
                workers=workers,
                decoder=decoder,
                sides=self._focal_sides(shape),
                small=small,
                regularize=self._regularize,
                second_focus=self._second_focus,
                fit_check=self._fit_check(),
                device=torch_device(config.backend),
                camera=camera,
            )
            planned = _Planned(plan, make_front(plan, config), make_back(plan, config))
            unless_made.pop_all()
        return planned

    def _focal_sides(self, shape: Shape) -> FocalSides | None:
        stack = self.model.stack
        if not stack.has_both_sides:
            return None
        config = self.config
        regularize = self._regularize or regularizer(config.classical, config.smoothness)
        return FocalSides(stack, self._levels, shape, regularize, self._patches_tell_sides)

    def _choose_decoder(self, stride_px: int) -> DecoderChoice:
        """Network or classical; a regulariser that was handed over is one."""
        if self._regularize is not None:
            return DecoderChoice(learned=False)
        return choose_decoder(self.source_model, self.config.regularize, stride_px)

    def _fit_check(self) -> FitCheck | None:
        """Check of the bank; None for models that cannot be checked, or if it is not asked for."""
        config, model = self.config, self.model
        if not config.check_fit or not isinstance(model, FilterBank) or unchecked_note(model):
            return None
        limits, middle_only = model.optics_limits, model.field is not None
        return FitCheck(
            model.stack,
            remembers=config.temporal_frames > 0,
            guarded=model.guard_levels > 0,
            middle_only=middle_only,
            own_fit=OwnFit(model.own_fit) if model.own_fit else None,
            optics_fit=OpticsFit(limits, middle_only) if limits else None,
        )

    def _plan_small_patches(self, shape: Shape, threads: int) -> Likelihood:
        """Likelihood of the small patches that the network needs."""
        assert isinstance(self.source_model, FilterBank)  # it was trained for no other
        small = small_bank(self.source_model).for_view(self.camera)
        return small.plan(shape, CELL_PX, self.config.backend, threads, periodic=False)


def model_notes(
    model: LikelihoodModel, config: DepthConfig, camera: Camera | None, sides: bool = True
) -> list[str]:
    """What users should know of a model before they use it, one line each.

    Parameters
    ----------
    model : LikelihoodModel
    config : DepthConfig
    camera : Camera or None
    sides : bool
        Whether it counts that the mask does not distinguish the sides of the focal plane.
    """
    notes = [
        refinement_note(model, config),
        unchecked_note(model) if config.check_fit else None,
        side_warning(model) if sides else None,
        camera and field_note(camera),
    ]
    return [note for note in notes if note]


def unchecked_note(model: LikelihoodModel) -> str | None:
    """Note for users if frames cannot be checked against a model, and why; else None."""
    reason = "only banks without motion have a check"
    if isinstance(model, FilterBank):
        reason = unchecked_reason(model.stack)
    return f"frames are not checked for fit: {reason}" if reason else None


def refinement_note(model: LikelihoodModel, config: DepthConfig) -> str | None:
    """Note for users if the network is chosen but does not support the model; else None.

    Parameters
    ----------
    model : LikelihoodModel
    config : DepthConfig

    Returns
    -------
    str or None
        One line: what is used instead, and why.

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros.likelihood.bank import learn_bank
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("levin"), np.linspace(2, 9, 15)))
    >>> refinement_note(bank, DepthConfig()) is None
    True
    """
    decoder = choose_decoder(model, config.regularize, config.stride_px or model.stride_px)
    if decoder.reason:
        return (
            "regularize: semiglobal in place of learned, which was not trained for this model: "
            f"{decoder.reason}{'; no free-space bound' if config.free_space_risk else ''}"
            f"{'; no second surface' if config.second_surface else ''}"
        )
    if decoder.learned and config.second_surface and model.stack.has_both_sides:
        return "second_surface: not found with levels on both sides of the focal plane"
    return None


def side_warning(model: LikelihoodModel) -> str | None:
    """Warning for users if a mask does not distinguish the sides that a model has; else None.

    Parameters
    ----------
    model : LikelihoodModel

    Returns
    -------
    str or None
        One line, with the remedy.

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros.likelihood.bank import learn_bank
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("levin"), np.linspace(2, 9, 15)))
    >>> side_warning(bank) is None
    True
    """
    stack = model.stack
    if not stack.has_both_sides:
        return None
    psf = stack.psfs[np.abs(stack.blur_sizes_px).argmax()]
    if np.abs(psf - psf[::-1, ::-1]).sum() / 2 >= _LEAST_ASYMMETRY:
        return None
    return (
        "side: the mask is nearly the same after half a turn, so the blur does not tell the two "
        "sides of the focal plane apart: use an asymmetric mask such as three_wide or zhou, or "
        "focus before or beyond the scene"
    )
