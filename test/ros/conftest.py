"""What the tests of the nodes share."""

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def model(tmp_path_factory):
    """Return the parameters that depth_node and deblur_node need: a small camera and its bank."""
    from small_camera import write_model

    return write_model(tmp_path_factory.mktemp("model"))


@pytest.fixture(scope="session")
def camera_file(model):
    return Path(model["camera_file"])


@pytest.fixture(scope="session")
def coded(camera_file):
    """Return a frame of a textured wall at DEPTH_M."""
    from small_camera import coded_wall

    from coded_aperture_ros.optics import load_camera

    coded = coded_wall(load_camera(camera_file))
    coded.flags.writeable = False
    return coded
