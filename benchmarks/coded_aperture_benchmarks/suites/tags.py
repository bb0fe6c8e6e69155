"""Over what distances tags and QR codes are read."""

import argparse
import dataclasses
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.arguments import at_least, between
from coded_aperture_benchmarks.datasets.cameras import camera_for_blur
from coded_aperture_benchmarks.datasets.tag_cards import (
    CARDS_M,
    SIZE,
    TAG,
    WALL_M,
    Card,
    CardScene,
    card_scene,
    pitch_px,
)
from coded_aperture_benchmarks.figures import shares_over_distance
from coded_aperture_benchmarks.methods.depth import CameraBank, StackBank, predict
from coded_aperture_benchmarks.metrics.codes import CodeReader, code_of, distance_error
from coded_aperture_benchmarks.pictures import as_rgb, of_width, side_by_side
from coded_aperture_benchmarks.rows import grouped
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.suites.tags_tables import (
    BEFORE,
    CODED,
    METHODS,
    MIDDLE,
    ORDINARY,
    SHARP,
    STOPS,
    TITLES,
    TRUE,
    blur_errors,
    goal,
    part_edges_m,
    part_of,
    part_titles,
    pooled,
    text_of,
)
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.frames import SRGB
from coded_aperture_ros.io import write_image
from coded_aperture_ros.likelihood.bank import LearnConfig
from coded_aperture_ros.optics import MASK_NAMES, Camera, Mask, render_psf_stack
from coded_aperture_ros.simulation import SensorModel

_FOCAL_LENGTH_PX, _BLUR_PX = 1194.0, (2.0, 16.0)
_MIDDLE_M = 2 / sum(1 / distance for distance in CARDS_M)
# Masks are alike on both sides of the focal plane up to this `asymmetry`.
_ALIKE = 0.01
# Of the bank for a focus in the middle: blur below a pixel is as good as none.
_LEVELS, _LEAST_PX, _GUARD, _WINDOW_PX = 30, 1.0, 1.08, 48
_READ_NOISE, _BITS = 2.5, 12
# Smaller ones are not read even where they are sharp; of larger ones not four fit into a frame.
_MODULES_PX = 2.0, 6.0
_WIDTH_PX = 1600
_GREEN, _RED = (0, 220, 0), (255, 40, 40)


@dataclasses.dataclass(frozen=True)
class Lens:
    """The lens that both cameras have, once with the mask, once with a round aperture.

    The coded camera is in focus `before` all cards, so that every blur size is of one distance, or
    in the `middle`, as the ordinary one. Then it does not know on which side a card is, and need
    not: behind a mask that looks the same after half a turn both sides are blurred alike.
    """

    mask: str
    focus: str = BEFORE
    aperture: float = 1.0  # how wide, in units of the one that `_BLUR_PX` are of

    def coded(self) -> Camera:
        """Return the camera with the mask."""
        camera = camera_for_blur(Mask.named(self.mask), _FOCAL_LENGTH_PX, SIZE, CARDS_M, _BLUR_PX)
        camera = dataclasses.replace(camera, mask_extent_mm=self.aperture * camera.mask_extent_mm)
        if self.focus == BEFORE:
            return camera
        return dataclasses.replace(camera, focus_distance_m=_MIDDLE_M, side="both")

    def ordinary(self, stop: float) -> Camera:
        """Return one with a round aperture, in focus in the middle, by the light that passes."""
        coded, disc = self.coded(), Mask.named("disc")
        area = stop * coded.mask.open_fraction / disc.open_fraction
        extent_mm = coded.mask_extent_mm * np.sqrt(area)
        return dataclasses.replace(
            coded, mask=disc, mask_extent_mm=extent_mm, focus_distance_m=_MIDDLE_M, side="both"
        )


@dataclasses.dataclass(frozen=True)
class Cell:
    """A frame of cards, in some light."""

    scene: int
    electrons: int
    module_px: float
    lens: Lens
    srgb: bool

    @property
    def reader(self) -> CodeReader:
        """Reads frames, encoded or not."""
        return CodeReader(SRGB if self.srgb else 1.0)


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """A row for each card and whatever it is read from, and the frames."""

    cell: Cell
    rows: list[Row]
    frames: dict[str, FloatArray]


def _cells(args: argparse.Namespace) -> list[Cell]:
    least, most = _MODULES_PX
    if not least <= args.module <= most:
        args.usage_error(f"--module: expected {least:g} to {most:g} px")
    options.check_known(args, "mask", [args.mask], MASK_NAMES)
    lens = _lens(args)
    if lens.focus != BEFORE and Mask.named(lens.mask).asymmetry > _ALIKE:
        args.usage_error(
            f"--focus {lens.focus}: needs a mask that looks the same after half a turn"
        )
    CodeReader.check()
    return [
        Cell(scene, electrons, args.module, lens, args.srgb)
        for scene in range(args.scenes)
        for electrons in dict.fromkeys(args.electrons)
    ]


def _lens(args: argparse.Namespace) -> Lens:
    return Lens(args.mask, args.focus, args.aperture)


def measure(cell: Cell) -> Measured:
    """Take a frame with every camera, deblur, and read."""
    scene, lights = _seen(cell.scene, cell.module_px, cell.lens)
    camera, reader = cell.lens.coded(), cell.reader
    rows, frames = [], {SHARP: lights[SHARP]}
    frames |= dict(_exposed(cell, lights))
    # Of sizes without sign, if the focus is in the middle.
    true_px, found_px = (
        np.abs(scene.seen_by(camera).blur_size_px()),
        _found(cell.lens, frames[CODED]),
    )
    frames |= dict(_deblurred(cell.lens, frames[CODED], found_px, true_px))
    blur = [_blur_on(card, np.abs(found_px - true_px)) for card in scene.cards]
    for given, frame in frames.items():
        codes = reader.read(frame)
        for card, of_card in zip(scene.cards, blur, strict=True):
            code = code_of(card, codes)
            error = None
            if code is not None and card.kind == TAG:
                error = distance_error(card, code, camera)
            rows.append(
                {
                    "scene": cell.scene,
                    "electrons": cell.electrons,
                    "given": given,
                    "kind": card.kind,
                    "part": part_of(card.distance_m),
                    "read": code is not None,
                    "distance_error": error,
                    **of_card,
                }
            )
    return Measured(cell, rows, frames)


@lru_cache(maxsize=1)
def _seen(seed: int, module_px: float, lens: Lens) -> tuple[CardScene, dict[str, FloatArray]]:
    """Return the cards, and the light that they send to each sensor."""
    scene = card_scene(seed, module_px)
    coded = scene.seen_by(lens.coded())
    lights = {SHARP: coded.all_in_focus(), CODED: coded.coded()}
    for name, stop in zip(ORDINARY, STOPS, strict=True):
        lights[name] = scene.seen_by(lens.ordinary(stop)).coded()
    return scene, lights


def _exposed(cell: Cell, lights: dict[str, FloatArray]) -> Iterator[tuple[str, FloatArray]]:
    """Yield every frame after the same time of exposure, amplified where there is less light."""
    random = np.random.default_rng([cell.scene, cell.electrons])
    sensor = SensorModel(bits=_BITS)
    for name, share in ((CODED, 1.0), *zip(ORDINARY, STOPS, strict=True)):
        white = cell.electrons * share
        counted = random.poisson(np.clip(lights[name], 0, None) * white)
        noise = random.normal(0, _READ_NOISE, counted.shape)
        yield name, sensor.expose((counted + noise) / white, random)


def _found(lens: Lens, coded: FloatArray) -> FloatArray:
    """Return the blur size that is estimated of every pixel."""
    camera = lens.coded() if lens.focus == BEFORE else None
    return np.asarray(predict(coded, _bank(lens), DepthConfig(), camera).blur_size_px)


def _deblurred(
    lens: Lens, coded: FloatArray, found_px: FloatArray, true_px: FloatArray
) -> Iterator[tuple[str, FloatArray]]:
    for method in METHODS:
        deblurrer = Deblurrer(_bank(lens).learn().stack, DeblurConfig(method=method))
        yield method, deblurrer.deblur(coded, found_px)
        if method == "sparse":
            yield TRUE, deblurrer.deblur(coded, true_px)
        deblurrer.close()


def _blur_on(card: Card, errors_px: FloatArray) -> Row:
    """Return of how much of a code the blur is known, and how wrong it is there."""
    inside = np.zeros(errors_px.shape, np.uint8)
    cv2.fillPoly(inside, [np.rint(card.corners_px()).astype(np.int32)], 1)
    errors = errors_px[inside > 0]
    known = errors[np.isfinite(errors)]
    return {
        "known": known.size / errors.size,
        "blur_error_px": float(np.median(known)) if known.size else None,
    }


@lru_cache(maxsize=1)
def _bank(lens: Lens) -> CameraBank | StackBank:
    camera = lens.coded()
    if lens.focus == BEFORE:
        return CameraBank.guarded(camera, (CARDS_M[0], WALL_M[1]), _LEVELS)
    largest_px = np.abs(camera.blur_size_px([CARDS_M[0], WALL_M[1]])).max()
    sizes_px = np.linspace(_LEAST_PX, _GUARD * largest_px, _LEVELS)
    return StackBank(render_psf_stack(camera.mask, sizes_px), LearnConfig(_WINDOW_PX))


def _results(args: argparse.Namespace, measured: list[Measured]) -> Row:
    rows = [row for each in measured for row in each.rows]
    by_given = [
        {"electrons": electrons, "given": given, **pooled(group)}
        for (electrons, given), group in grouped(rows, "electrons", "given").items()
    ]
    return {
        "cards": len(rows) // len(grouped(rows, "electrons", "given")),
        "part_edges_m": [round(edge, 3) for edge in part_edges_m()],
        "blur_at_ends_px": {
            name: round(_blur_at_ends_px(_lens(args), stop), 2)
            for name, stop in zip(ORDINARY, STOPS, strict=True)
        },
        "same_depth_of_field": _same_depth_of_field(args),
        "blur_errors": list(blur_errors(rows)),
        "rows": by_given,
        "goal": [
            {"electrons": electrons, **goal(group)}
            for (electrons,), group in grouped(by_given, "electrons").items()
        ],
    }


def _blur_at_ends_px(lens: Lens, stop: float) -> float:
    """Return the blur size of the ordinary lens at the nearest and at the farthest distance."""
    return float(np.abs(lens.ordinary(stop).blur_size_px(CARDS_M)).max())


def _same_depth_of_field(args: argparse.Namespace) -> str | None:
    """Return the widest stop that blurs nothing by more than a module."""
    for name, stop in zip(ORDINARY, STOPS, strict=True):
        if _blur_at_ends_px(_lens(args), stop) <= args.module:
            return name
    return None


def _draw(args: options.Args, measured: list[Measured], folder: Path) -> None:
    stopped = _same_depth_of_field(args) or ORDINARY[-1]
    given = [SHARP, CODED, "fast", "sparse", ORDINARY[0], stopped]
    for each in measured:
        if each.cell.scene == 0:
            cards = card_scene(0, each.cell.module_px).cards
            parts = [
                (TITLES[name], [_outlined(each.frames[name], cards, each.cell)])
                for name in dict.fromkeys(given)
            ]
            picture = of_width(side_by_side(parts), _WIDTH_PX)
            write_image(folder / f"codes_{each.cell.electrons}.jpg", picture)
    results = _results(args, measured)
    panels = {
        f"{electrons} electrons": {
            TITLES[row["given"]]: [np.nan if share is None else share for share in row["parts"]]
            for row in rows
            if row["given"] != SHARP
        }
        for (electrons,), rows in grouped(results["rows"], "electrons").items()
    }
    titles = [title.removesuffix(" m") for title in part_titles(results["part_edges_m"])]
    shares_over_distance(panels, titles, folder / "read.png")


def _outlined(frame: FloatArray, cards: Sequence[Card], cell: Cell) -> NDArray[np.uint8]:
    """Return the left of a frame, up to two cards wide: what is read in green, the rest in red."""
    codes, module_px = cell.reader.read(frame), cell.module_px
    picture = np.ascontiguousarray(as_rgb(np.clip(frame, 0, 1), SRGB))
    font = cv2.FONT_HERSHEY_SIMPLEX
    for card in cards:
        colour = _RED if code_of(card, codes) is None else _GREEN
        corners = np.rint(card.corners_px(1.5 * module_px)).astype(np.int32)
        cv2.polylines(picture, [corners], True, colour, 2, cv2.LINE_AA)
        where = int(card.middle_px[0]) - 30, int(corners[:, 1].max()) + 20
        text = f"{card.distance_m:.2f} m"
        for rim, width in (((0, 0, 0), 5), (colour, 2)):  # legible on white and on black
            cv2.putText(picture, text, where, font, 0.6, rim, width, cv2.LINE_AA)
    return picture[:, : min(2 * pitch_px(module_px), picture.shape[1])]


SUITE = Suite(
    name="tags",
    said=("module", "scenes", "mask", "srgb", "focus", "aperture"),
    description="Read AprilTags (36h11, by OpenCV) and QR codes (by zxing-cpp) on cards at random "
    "distances, by a coded camera before and after deblurring, and by an ordinary lens that is in "
    "focus in the middle and lets pass as much light as the mask, or less. The exposure is the "
    "same for all; all codes have modules of one size in the picture. Range: the parts of the "
    "distances (equal ones of the inverse distance, next to each other) in each of which at least "
    "half is read; in dioptres, as blur goes by these.",
    examples="""examples:
  three frames of twelve cards (a minute and a half), with pictures and a figure:
    python -m coded_aperture_benchmarks tags --output tags/
  a single one, in good light:
    python -m coded_aperture_benchmarks tags --scenes 1 --electrons 10000
  the coded camera in focus in the middle too, behind a wider aperture:
    python -m coded_aperture_benchmarks tags --focus middle --aperture 1.5
""",
    options=(
        options.number("--scenes", 1, 3, "frames of cards"),
        options.option(
            "--module", "of the codes (black or white square), px", 4.0, type=float, metavar="PX"
        ),
        options.option(
            "--electrons",
            "that make white behind the mask",
            [10_000, 1_000, 200],
            type=at_least(1),
            metavar="N",
        ),
        options.option("--mask", "of the coded camera", "levin", metavar="MASK"),
        options.option(
            "--focus",
            "of the coded camera: before all cards, or in the middle, as of the ordinary one",
            BEFORE,
            choices=(BEFORE, MIDDLE),
        ),
        options.option(
            "--aperture",
            "how wide both are, 1: blur of 2 to 16 px, focused before",
            1.0,
            type=between(0.5, 2),
            metavar="A",
        ),
        options.option(
            "--srgb",
            "read frames encoded as pictures are, not as linear light",
            action="store_true",
        ),
        *options.DEPTH_RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=text_of,
    draw=_draw,
)
