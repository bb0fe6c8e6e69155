"""Names and encodings of the maps that every estimate has: those of files, bags and node agree."""

from pathlib import Path

import numpy as np
import pytest

from coded_aperture_ros.bags.messages import result_topics
from coded_aperture_ros.bags.topics import Outputs
from coded_aperture_ros.depth import layer_specs
from coded_aperture_ros.depth.core_maps import CONFIDENCE, CORE_MAPS, DEPTH, STD_DEV
from coded_aperture_ros.depth.files import estimate_files
from coded_aperture_ros.io.messages.encodings import check_pixels


def test_no_topic_and_no_file_belongs_to_two_maps():
    specs = (*CORE_MAPS, *layer_specs())
    topics = [topic for spec in specs for topic in (spec.topic, spec.points_topic) if topic]
    assert len(set(topics)) == len(topics)
    files = estimate_files(Path("x.npy"))
    assert len(set(files)) == len(files)
    assert {Path(f"x.{spec.name}.npy") for spec in (CONFIDENCE, STD_DEV)} <= set(files)


def test_a_bag_has_the_topics_of_the_node():
    names = [topic.name for topic in result_topics(Outputs.within("/eye/"), deblurs=False)]
    expected = [f"/eye/{spec.topic}" for spec in (DEPTH, CONFIDENCE, STD_DEV)]
    assert names == [*expected, "/eye/depth/camera_info"]
    assert DEPTH.topic == "depth/image" and DEPTH.points_topic == "depth/points"


def test_encodings_are_those_of_the_pixels():
    for spec in CORE_MAPS:
        dtype = np.uint16 if spec.unit == "mm" else np.float32
        check_pixels(np.zeros((2, 3), dtype), spec.encoding)


def test_the_node_publishes_every_map():
    pytest.importorskip("rclpy")
    from sensor_msgs.msg import CompressedImage, Image, PointCloud2

    from coded_aperture_ros.ros.depth_node import output_types

    types = output_types()
    for spec in (*CORE_MAPS, *layer_specs()):
        assert types[spec.topic] is Image
        if spec.points_topic:
            assert types[spec.points_topic] is PointCloud2
    compressed = {name for name, kind in types.items() if kind is CompressedImage}
    assert compressed == {f"depth/{name}/compressedDepth" for name in ("image", "image_raw")}
