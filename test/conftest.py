"""What the tests share: the data folder, and a ROS network of their own."""

import gc
import os
import signal
import tempfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest
from domain_lock import reserve_domain
from hypothesis import settings
from waiting import scaled

# No time limit for a single example: it would fail tests on a busy machine. Where CI is set,
# Hypothesis itself makes its choices repeatable.
settings.register_profile("patient", parent=settings.default, deadline=None)
settings.load_profile("patient")

# Before anything imports rclpy. Domains 1 to 100 keep clear of the ports that Linux hands out.
_LOGS = tempfile.TemporaryDirectory(prefix="coded_aperture_ros-logs-")
_DOMAIN, _DOMAIN_LOCK = reserve_domain()
os.environ["ROS_DOMAIN_ID"] = str(_DOMAIN)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_LOG_DIR"] = _LOGS.name
# Tests make many participants in one process, one after the other and some side by side. Fast DDS
# would hand their messages over directly, and then now and then never get to the end of removing a
# participant that another one is just sending to. The rest keeps the participants of `Ros`, whose
# transport is UDP alone, from looking for others beyond this machine.
_PROFILES = Path(_LOGS.name) / "fastdds.xml"
_PROFILES.write_text(
    """<dds xmlns="http://www.eprosima.com">
    <library_settings><intraprocess_delivery>OFF</intraprocess_delivery></library_settings>
    <profiles><participant profile_name="tests" is_default_profile="true"><rtps><builtin>
        <metatrafficUnicastLocatorList><locator/></metatrafficUnicastLocatorList>
        <initialPeersList>
            <locator><udpv4><address>127.0.0.1</address></udpv4></locator>
        </initialPeersList>
    </builtin></rtps></participant></profiles>
    </dds>
    """
)
os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(_PROFILES)
for name in ("ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY", "ROS_NAMESPACE", "ROS_DISCOVERY_SERVER"):
    os.environ.pop(name, None)

# A shell that runs the tests in the background lets them ignore Ctrl-C, and so would the programs
# that they start: some tests interrupt those.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Before anything imports NumPy: on a busy machine BLAS is much slower with threads than without.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if find_spec("rclpy"):
    import coded_aperture_ros.ros  # noqa: F401  prepares the environment of the wheels

DATA = "CODED_APERTURE_DATA"


@pytest.fixture(autouse=True)
def gamma_is_assumed_without_a_word():
    """The hint comes once in a process: which test gets it would depend on their order."""
    from coded_aperture_ros.cli.reading import GammaArguments

    GammaArguments.gamma.is_told = True


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real and the ray-traced images."""
    if DATA not in os.environ:
        pytest.skip(f"needs the data folder: set {DATA}")
    folder = Path(os.environ[DATA])
    if not folder.is_dir():
        pytest.fail(f"{DATA} is {folder}, which is not a folder")
    return folder


@pytest.fixture(scope="session")
def checkout() -> Path:
    """Folder of the project's sources."""
    return Path(__file__).resolve().parents[1]


@pytest.fixture
def ros():
    """Return a ROS context of the test's own, that spins."""
    pytest.importorskip("rclpy")
    from ros_helpers import Ros

    ros = Ros()
    yield ros
    ros.close()


@pytest.fixture(scope="session")
def scene(tmp_path_factory):
    """Two planes, their coded frame and a bank, made by the command line."""
    from cli_scene import make_scene

    return make_scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="session")
def recorded(scene, tmp_path_factory):
    """Return bags of the scene, by frames and storage, that are written once; not to be changed."""
    from bag_scene import recording, write_bag

    folder = tmp_path_factory.mktemp("recorded")

    @cache
    def bag(frames, storage="mcap"):
        return write_bag(folder / f"{storage}_{frames}", recording(scene, frames=frames), storage)

    return bag


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item):
    """Give every test its time by how busy the machine is when the test begins."""
    if item.config.getoption("timeout") is None:
        item.add_marker(pytest.mark.timeout(scaled(float(item.config.getini("timeout")))))
    return (yield)


def pytest_collection_finish():
    """Keep the garbage collector from looking through all that was imported, each time anew."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session):
    """Where everything that tests need is installed, a test that is skipped is a failure."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if os.environ.get("CODED_APERTURE_NO_SKIPS") and reporter.stats.get("skipped"):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
