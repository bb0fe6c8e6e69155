"""Settings that do nothing at present, and why."""

from collections.abc import Collection

from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.depth.decoders.network import DecoderChoice, choose_decoder
from coded_aperture_ros.depth.decoders.regularize import LEARNED
from coded_aperture_ros.likelihood import LikelihoodModel
from coded_aperture_viewer.settings import LookConfig, Settings

_NEEDS_LEARNED = "needs the regularisation: learned"


def inactive_settings(
    settings: Settings, looks: Collection[LookConfig], model: LikelihoodModel
) -> dict[str, str]:
    """Reasons why settings change nothing at present.

    Parameters
    ----------
    settings : Settings
        Of the page that shows the controls.
    looks : collection of LookConfig
        Of all pages.
    model : LikelihoodModel

    Returns
    -------
    dict
        `{name of the setting: reason}`; settings that act are not in it.
    """
    depth = settings.depth
    reasons = {}
    decoder = choose_decoder(model, depth.regularize, depth.stride_px or model.stride_px)
    if reason := _no_smoothness(depth, decoder, model):
        reasons["depth.smoothness"] = reason
    if depth.regularize != LEARNED:
        reasons["depth.free_space_risk"] = _NEEDS_LEARNED
        reasons["depth.second_surface"] = _NEEDS_LEARNED
    elif decoder.reason:
        reasons["depth.second_surface"] = (
            f"needs the learned network, and of this bank {decoder.reason}"
        )
    elif model.stack.has_both_sides:
        reasons["depth.second_surface"] = "not found with levels on both sides of the focal plane"
    if settings.run.paused:
        reasons["depth.temporal_frames"] = "paused: one frame is not averaged"
    if all(look.picture == "none" for look in looks):
        reasons["deblur.smoothness"] = "no page shows an all-in-focus picture"
    if settings.look.picture != "refocused":
        reasons["look.opening_px"] = "acts on the picture: refocused"
    return reasons


def _no_smoothness(depth: DepthConfig, decoder: DecoderChoice, model: LikelihoodModel) -> str:
    """Why the smoothness of depth does nothing; empty if it acts."""
    if depth.regularize == "none":
        return "there is no regularisation"
    # The sides of the focal plane are decided by the classical regularisation.
    if not decoder.learned or model.stack.has_both_sides:
        return ""
    return "the learned network has none"
