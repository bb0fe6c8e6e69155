"""What changes over minutes of a camera in service: slow averages, and since when they have moved.

A single frame says little of a mask that is turned by a few degrees or covered in part, since its
texture has directions, too. Over minutes of a camera that moves, textures average out, and what the
mask says adds up. Frames are looked at once a second at most, and those of a camera that stands
still count once. What says that the mask has changed has to come from several views: one scene's
texture may look like a turn of 6 degrees.
"""

import dataclasses
import math
from collections import deque

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.depth.estimate import DepthEstimate
from coded_aperture_ros.depth.quality.mask_test import (
    PARTS,
    TURNS_DEG,
    MaskLook,
    MaskTest,
    middle_part,
)
from coded_aperture_ros.frames import Frame, grey_image
from coded_aperture_ros.frames.noise import NOISE_FLOOR
from coded_aperture_ros.optics import PsfStack

# Time constants of the averages, s, by the ends of their names.
_AVERAGES_S = {"10s": 10.0, "10min": 600.0}
_INTERVAL_S = 1.0
_MINUTE_S = 60.0
# Fewest frames of a minute that counts, minutes that changes are the mean of, and the fewest of
# them. On 18 photographs of scenes, through three masks, the angle of a mask that is not turned is
# off by 0.3 to 1.1 degrees (standard deviation) after four scenes, and by 0.2 to 0.7 after eight.
_FEWEST_LOOKS = 15
_MINUTES = 5
_FEWEST_MINUTES = 3
# Least angle of a turned mask, degrees, and least gain of a covered part, hundredths of the
# negative log-likelihood: 0.5 to 2 where one of 3 x 3 parts is dark, -0.2 and less where none is.
_LEAST_TURN_DEG = 4.0
_LEAST_GAIN = 0.4
# Least loss of health since the first minutes, and the most that it is then.
_LEAST_LOSS = 0.2
_LOW_HEALTH = 0.6
# Side of the small pictures by which frames are compared, px, and the mean difference of those that
# are alike, as a share of their light.
_SMALL_PX = 16
_ALIKE = 0.04
# Fewest different views that tell a change of the mask. Two views differ if the middle of neither
# is found in the other one with a correlation of so much; of 18 photographs of scenes 16 do, of the
# demo's scene, which the camera pans over, three parts.
_FEWEST_VIEWS = 5
_SAME_VIEW = 0.5
# Side of the pictures that views are compared by, px, and the scale of the light that is not: the
# standard deviation of a Gaussian, px.
_VIEW_PX = 32
_VIEW_SCALE_PX = 3.0
# Added to the light, so that the dark counts as little as noise makes it.
_VIEW_DARK = 0.02
# Most views that are remembered.
_MOST_VIEWS = 20


@dataclasses.dataclass(frozen=True, eq=False)
class Minute:
    """Means over the frames of a minute.

    Attributes
    ----------
    began_s : float
    health : float
        NaN if no frame was checked.
    look : MaskLook
    """

    began_s: float
    health: float
    look: MaskLook


@dataclasses.dataclass(frozen=True)
class Drift:
    """A change that has lasted.

    Attributes
    ----------
    text : str
        What has changed, and what to do.
    since_s : float
        Time of the first minute of it.
    """

    text: str
    since_s: float


class DriftWatch:
    """Averages over seconds and minutes of how frames fit, and what has changed since the start.

    Parameters
    ----------
    stack : PsfStack
        PSFs of the bank that frames are compared with.
    middle_only : bool
        Whether they are those of the middle of the image.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> watch = DriftWatch(render_psf_stack(Mask.named("levin"), [4.0, 6.0, 8.0]))
    >>> watch.due(0.0), watch.figures(), watch.drift
    (True, {}, None)
    """

    def __init__(self, stack: PsfStack, middle_only: bool = False) -> None:
        self.stack = stack
        self._middle_only = middle_only
        self._test = MaskTest(stack)
        self._averages = {name: _Average(span_s) for name, span_s in _AVERAGES_S.items()}
        self._looks: list[tuple[float, float, MaskLook]] = []  # of this minute
        self._minutes: deque[Minute] = deque(maxlen=_MINUTES)
        self._first_health = math.nan
        self._since_s: dict[str, float] = {}
        self._seen_s = -math.inf
        self._small: FloatArray | None = None
        self._views: deque[tuple[float, FloatArray]] = deque(maxlen=_MOST_VIEWS)
        self.drift: Drift | None = None

    def due(self, now_s: float) -> bool:
        """Whether the next frame is to be seen."""
        return now_s - self._seen_s >= _INTERVAL_S

    def see(self, now_s: float, frame: Frame, estimate: DepthEstimate, saturation: float) -> None:
        """Add a frame and what was estimated of it, at a time by a steady clock, s."""
        self._seen_s = now_s
        grey, unusable = grey_image(frame.light, saturation)
        if self._middle_only:
            part = middle_part(grey.shape)
            grey, unusable = grey[part], None if unusable is None else unusable[part]
        if self._is_alike(grey):
            return
        noise = max(estimate.noise / math.sqrt(frame.channels), NOISE_FLOOR)
        look = self._test.look(grey, noise, unusable)
        if look is not None:
            health = math.nan if estimate.health is None else estimate.health.value
            self.add(now_s, health, look, view_of(grey))

    def _is_alike(self, grey: FloatArray) -> bool:
        """Whether a frame is about the last one that was looked at; else it becomes that."""
        small = cv2.resize(grey, (_SMALL_PX, _SMALL_PX), interpolation=cv2.INTER_AREA)
        before = self._small
        if before is not None and np.abs(small - before).mean() < _ALIKE * before.mean():
            return True
        self._small = small
        return False

    def add(self, now_s: float, health: float, look: MaskLook, view: FloatArray) -> None:
        """Add what was seen of a frame, and its `view_of`; a health of NaN is unknown."""
        if self._looks and now_s - self._looks[0][0] >= _MINUTE_S:
            self._end_minute()
        self._looks.append((now_s, health, look))
        for average in self._averages.values():
            average.add(np.array([health, look.residual, *look.gains]), now_s)
        self._note_view(now_s, view)

    def _note_view(self, now_s: float, view: FloatArray) -> None:
        """Remember a view with the time when it was seen last."""
        for number, (_, before) in enumerate(self._views):
            if is_same_view(view, before):
                self._views[number] = now_s, before
                return
        self._views.append((now_s, view))

    def figures(self) -> dict[str, float]:
        """Averages for /diagnostics, by name; empty before the first frame."""
        found: dict[str, float] = {}
        for name, average in self._averages.items():
            if len(average.value):
                health, residual, *gains = average.value
                found[f"health_{name}"] = float(health)
                found[f"residual_{name}"] = float(np.exp(residual))
                found[f"mask_turned_{name}_deg"] = turn_deg(np.array(gains))
        return {name: value for name, value in found.items() if math.isfinite(value)}

    def _end_minute(self) -> None:
        """Close this minute, and compare it with the first ones."""
        looks, self._looks = self._looks, []
        if len(looks) < _FEWEST_LOOKS:
            return
        healths = np.array([health for _, health, _ in looks])
        known = healths[np.isfinite(healths)]
        minute = Minute(
            began_s=looks[0][0],
            health=float(known.mean()) if len(known) else math.nan,
            look=MaskLook(
                np.mean([look.gains for _, _, look in looks], axis=0),
                float(np.mean([look.residual for _, _, look in looks])),
            ),
        )
        self._minutes.append(minute)
        if len(self._minutes) < _FEWEST_MINUTES:
            return
        changes = self._changes()
        self._since_s = {name: self._since_s.get(name, minute.began_s) for name in changes}
        self.drift = None
        if changes:
            name = min(changes, key=lambda name: self._since_s[name])
            self.drift = Drift(changes[name], self._since_s[name])

    def _changes(self) -> dict[str, str]:
        """What the last minutes show, by a short name."""
        gains = np.mean([minute.look.gains for minute in self._minutes], axis=0)
        angle, covers = turn_deg(gains), gains[len(TURNS_DEG) :]
        found = {}
        began_s = self._minutes[0].began_s
        if sum(seen_s >= began_s for seen_s, _ in self._views) < _FEWEST_VIEWS:
            pass  # the texture of so few scenes may look like anything
        elif covers.max() >= max(_LEAST_GAIN, gains[: len(TURNS_DEG)].max()):
            row, column = divmod(int(covers.argmax()), PARTS)
            found["covered"] = (
                f"the mask looks covered in row {row + 1}, column {column + 1} of {PARTS}x{PARTS}, "
                "or on the other side: clean it"
            )
        elif abs(angle) >= _LEAST_TURN_DEG:
            way = "clockwise" if angle > 0 else "counter-clockwise"
            found["turned"] = (
                f"the mask looks turned by {abs(angle):.0f} degrees {way}: put it in as the camera "
                "file has it"
            )
        known = [minute.health for minute in self._minutes if math.isfinite(minute.health)]
        health = float(np.mean(known)) if known else math.nan
        if math.isnan(self._first_health):
            self._first_health = health
        # Neither holds for NaN.
        if health < self._first_health - _LEAST_LOSS and health < _LOW_HEALTH:
            found["health"] = (
                f"health is {health:.2f} in place of {self._first_health:.2f} at first: look for "
                "what has moved"
            )
        return found


def view_of(grey: FloatArray) -> FloatArray:
    """Small picture of a frame, float32 [32, 32], by which views are compared.

    Parameters
    ----------
    grey : ndarray, float32 [height, width]
        Linear light.
    """
    small = cv2.resize(grey, (_VIEW_PX, _VIEW_PX), interpolation=cv2.INTER_AREA)
    light = np.log(np.maximum(small, 0) + np.float32(_VIEW_DARK))
    return np.asarray(light - cv2.GaussianBlur(light, (0, 0), _VIEW_SCALE_PX), np.float32)


def is_same_view(one: FloatArray, other: FloatArray) -> bool:
    """Whether two `view_of` overlap: the middle of one is found in the other one."""
    middle = np.s_[_VIEW_PX // 4 : -_VIEW_PX // 4, _VIEW_PX // 4 : -_VIEW_PX // 4]
    found = (
        cv2.matchTemplate(whole, part[middle], cv2.TM_CCOEFF_NORMED).max()
        for whole, part in ((one, other), (other, one))
    )
    return max(found) >= _SAME_VIEW


def turn_deg(gains: DoubleArray) -> float:
    """Angle at which a turned mask explains frames best, degrees; 0 is the mask as it is.

    Between the angles that were tried it is where the parabola through the best one and its
    neighbours is highest.

    Parameters
    ----------
    gains : ndarray, float64 [changes]
        See `MaskLook`.
    """
    middle = len(TURNS_DEG) // 2
    angles = np.insert(TURNS_DEG, middle, 0.0)
    values = np.insert(gains[: len(TURNS_DEG)], middle, 0.0)
    best = int(values.argmax())
    if not 0 < best < len(angles) - 1:
        return float(angles[best])
    less, most, more = values[best - 1 : best + 2]
    step = (angles[best + 1] - angles[best - 1]) / 2
    return float(angles[best] + step * (more - less) / (2 * (2 * most - less - more) + 1e-9))


class _Average:
    """Mean over about so many seconds; at first over all that there is."""

    def __init__(self, span_s: float) -> None:
        self._span_s = span_s
        self._count = 0
        self._last_s = 0.0
        self.value: DoubleArray = np.zeros(0)

    def add(self, value: DoubleArray, now_s: float) -> None:
        """Add a value; NaN leaves what is known of its place as it was."""
        self._count += 1
        if not len(self.value):
            self.value = value
        weight = max(-math.expm1((self._last_s - now_s) / self._span_s), 1 / self._count)
        change = np.where(np.isfinite(value), value - self.value, 0.0)
        started = np.where(np.isfinite(self.value), self.value, value)
        self.value = started + weight * np.nan_to_num(change)
        self._last_s = now_s
