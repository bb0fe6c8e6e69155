"""How fast `coded_aperture bag` works on a video with known depth, and how good its depth is.

An RGB-D video is made coded by the simulated camera, written into a bag with its stamps (30 Hz)
and its true depth, once as MCAP and once as SQLite, and given to the program. The time is that of
all frames, from the first one read to the last byte written; what comes before (learning the bank,
planning) and after (drawing the report) does not count.
"""

import argparse
import dataclasses
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import yaml
from coded_aperture_benchmarks.datasets.video import CodedVideo, load_video

from coded_aperture_ros.bags import bag_output
from coded_aperture_ros.bags.codec import (
    CAMERA_INFO,
    IMAGE,
    camera_info_data,
    camera_info_message,
    image_data,
    new_topic,
)
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.io.messages import millimetres_from_depth, pixels_from_frame
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank_for_camera, save_bank

RATE_HZ = 30
START_NS = 1_700_000_000 * 10**9
FRAME_ID = "camera_optical_frame"
TOPICS = {
    "/camera/image_raw": IMAGE,
    "/camera/camera_info": CAMERA_INFO,
    "/camera/ground_truth/depth": IMAGE,
}


def main() -> int:
    """Make the bags, run the program, print what it says of itself."""
    args = arguments()
    video = load_video(args.video, args.frames)
    with tempfile.TemporaryDirectory(dir=args.folder) as name:
        folder = Path(name)
        camera = write_camera(video, folder / "camera.yaml")
        write_bank(video, args, folder / "bank.npz")
        rows = []
        for encoding in args.encodings:
            for storage in ("mcap", "sqlite3"):
                bag = folder / f"{encoding}_{storage}"
                write_bag(video, bag, storage, encoding, args.noise)
                for repeat in range(args.repeats):
                    row = run_program(bag, folder / "out", camera, folder / "bank.npz", args)
                    rows.append({"encoding": encoding, "repeat": repeat, **row})
                    if not args.json:
                        print(line(rows[-1]), flush=True)
    if args.json:
        print(json.dumps(rows))
    return 0


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("video", type=Path, help="folder of an RGB-D or ray-traced video")
    parser.add_argument("--frames", type=int, default=48)
    parser.add_argument("--noise", type=float, default=0.002, help="of the frames")
    parser.add_argument("--encodings", nargs="+", default=["mono8"], help="of the frames")
    parser.add_argument("--levels", type=int, default=16, help="of the bank")
    parser.add_argument("--window-px", type=int, default=64, help="of the bank")
    parser.add_argument("--rank", type=int, default=32, help="of the bank")
    parser.add_argument(
        "--highest-frequency", type=float, default=0.3, help="of the bank, cycles per pixel"
    )
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--folder", type=Path, help="where to put the bags for the time being")
    parser.add_argument("--json", action="store_true")
    parser.add_argument(
        "options",
        nargs="*",
        default=[
            "--stride-px",
            "36",
            "--output-size",
            "quarter",
            "--deblur-rank",
            "3",
            "--deblur-band",
            "half",
        ],
        help="further options of the program, behind -- (default: %(default)s)",
    )
    return parser.parse_args()


def write_camera(video: CodedVideo, path: Path) -> Path:
    """Write the camera file of the simulated camera."""
    camera = video.camera
    content = {
        "focal_length_px": float(camera.focal_length_px),
        "focus_distance_m": float(camera.focus_distance_m),
        "image_width": camera.image_width,
        "image_height": camera.image_height,
        "mask": {"name": camera.mask.name},
        "mask_extent_mm": float(camera.mask_extent_mm),
    }
    path.write_text(yaml.safe_dump(content))
    return path


def write_bank(video: CodedVideo, args: argparse.Namespace, path: Path) -> None:
    """Learn and write the bank for the depths of the video."""
    near_m, far_m = float(np.nanmin(video.depth_m)), float(np.nanmax(video.depth_m))
    config = LearnConfig(
        window_px=args.window_px, rank=args.rank, highest_frequency=args.highest_frequency
    )
    save_bank(learn_bank_for_camera(video.camera, near_m, far_m, args.levels, config), path)


def write_bag(video: CodedVideo, path: Path, storage: str, encoding: str, noise: float) -> None:
    """Write a bag with coded frames, camera models and true depth, as RGB-D cameras send it."""
    info = camera_info_message(video.camera.intrinsics)
    random = np.random.default_rng(0)
    with bag_output(path, storage) as writer:
        for topic, type_name in TOPICS.items():
            writer.add_topic(new_topic(topic, type_name))
        for index, (frame, depth_m) in enumerate(zip(video.frames, video.depth_m, strict=True)):
            time_ns = START_NS + index * 10**9 // RATE_HZ
            stamp = dataclasses.replace(
                info.header.stamp, sec=time_ns // 10**9, nanosec=time_ns % 10**9
            )
            header = dataclasses.replace(info.header, stamp=stamp, frame_id=FRAME_ID)
            noisy = frame + noise * random.standard_normal(frame.shape, np.float32)
            pixels = pixels_from_frame(noisy.astype(np.float32), encoding)
            size = frame.shape[0], frame.shape[1]
            messages = (
                image_data(pixels, encoding, header),
                camera_info_data(info, size, header),
                image_data(millimetres_from_depth(depth_m), "16UC1", header),
            )
            for topic, data in zip(TOPICS, messages, strict=True):
                writer.write(topic, time_ns, data)


def run_program(
    bag: Path, out: Path, camera: Path, bank: Path, args: argparse.Namespace
) -> dict[str, object]:
    """Run `coded_aperture bag` and return what it says."""
    shutil.rmtree(out, ignore_errors=True)
    command = [sys.executable, "-m", "coded_aperture_ros.cli.main", "bag", str(bag)]
    command += ["-o", str(out), "--bank", str(bank), "--camera", str(camera), "--json"]
    command += ["--reference-depth", "/camera/ground_truth/depth", *args.options]
    ran = subprocess.run(command, check=True, capture_output=True, text=True)
    results = json.loads(ran.stdout)
    return {
        "storage": results["storage"],
        "load": os.getloadavg()[0],
        "frames": results["frames"],
        "used": results["used"],
        **{f"timing_{name}": value for name, value in results["timing"].items()},
        **{f"reference_{name}": value for name, value in results["reference"].items()},
    }


def line(row: dict[str, object]) -> str:
    """Return the row of a table."""
    stages = {name: times["p50_ms"] for name, times in row["timing_stages"].items()}
    return (
        f"{row['encoding']} {row['storage']:8} {row['used']} of {row['frames']} frames, "
        f"{row['timing_seconds']:.2f} s, {row['timing_frames_per_second']:.1f} frames/s, "
        f"{row['timing_times_real_time']:.2f} x real time on {processors()} processors "
        f"({1000 * row['timing_processor_seconds'] / row['frames']:.1f} ms of processor time each; "
        f"before: {row['timing_preparation_s']:.2f} s; "
        + ", ".join(f"{name} {ms:.1f} ms" for name, ms in stages.items())
        + f"); median error {100 * row['reference_median_relative_error']:.2f} %, "
        f"within 10 % {100 * row['reference_within_10_percent']:.1f} %, "
        f"coverage {100 * row['reference_coverage']:.1f} %; load {row['load']:.1f}"
    )


if __name__ == "__main__":
    sys.exit(main())
