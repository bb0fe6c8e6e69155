"""Cameras in whose frames given depths have given blur."""

from coded_aperture_ros.optics import Camera, Mask

# A focus beyond infinity is no focus: then the smallest blur is a little larger.
_FARTHEST_FOCUS_M = 20.0


def camera_for_blur(
    mask: Mask,
    focal_length_px: float,
    size: tuple[int, int],
    depths_m: tuple[float, float],
    blur_px: tuple[float, float],
    side: str = "far",
) -> Camera:
    """Return a camera, focused before what it sees, or beyond it with `side` near.

    `size` is rows and columns, `depths_m` the nearest and the farthest depth, and `blur_px` the
    smallest and the largest blur size that they have.
    """
    near, far = 1 / depths_m[0], 1 / depths_m[1]
    # The blur size grows by this, in pixels, when the inverse of the depth changes by 1/m.
    blur_px_m = (blur_px[1] - blur_px[0]) / (near - far)
    at_focus = near + blur_px[0] / blur_px_m
    if side == "near":
        at_focus = max(far - blur_px[0] / blur_px_m, 1 / _FARTHEST_FOCUS_M)
    return Camera(
        focal_length_px=focal_length_px,
        focus_distance_m=1 / at_focus,
        image_width=size[1],
        image_height=size[0],
        mask=mask,
        mask_extent_mm=1e3 * blur_px_m / focal_length_px,
        side=side,
    )
