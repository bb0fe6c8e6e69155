"""With the profile, large best-effort messages arrive; without it most of them are lost."""

import os
import subprocess
import sys

import pytest
from waiting import output_of, scaled

pytest.importorskip("rclpy")

MESSAGES = 20
SUBSCRIBER = f"""
import sys, time
import coded_aperture_ros.ros
import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image

rclpy.init()
node = rclpy.create_node("subscriber")
received = []
end = time.monotonic() + float(sys.argv[1])
node.create_subscription(Image, "large", received.append, qos_profile_sensor_data)
while len(received) < {MESSAGES} and time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.1)
    if received and received[-1].header.frame_id == "last":
        break
print(len(received))
node.destroy_node()
rclpy.shutdown()
"""
PUBLISHER = f"""
import array, time
import coded_aperture_ros.ros
import rclpy
from sensor_msgs.msg import Image

rclpy.init()
node = rclpy.create_node("publisher")
publisher = node.create_publisher(Image, "large", 1)
while not publisher.get_subscription_count():
    time.sleep(0.05)
time.sleep(0.5)
message = Image(data=array.array("B", bytes(640 * 480 * 4)))
for number in range({MESSAGES}):
    message.header.frame_id = "last" if number == {MESSAGES} - 1 else ""
    publisher.publish(message)
    time.sleep(0.1)
time.sleep(0.5)
node.destroy_node()
rclpy.shutdown()
"""


@pytest.mark.serial
def test_large_best_effort_messages_arrive(checkout):
    profile = checkout / "config" / "fastdds_shared_memory.xml"
    shared_memory = os.statvfs("/dev/shm")
    if shared_memory.f_bavail * shared_memory.f_frsize < 280 * 2**20:
        pytest.skip("needs 280 MB of /dev/shm")
    environment = dict(os.environ, FASTRTPS_DEFAULT_PROFILES_FILE=str(profile))
    programs = [
        subprocess.Popen(
            [sys.executable, "-c", code, str(scaled(20))],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for code in (SUBSCRIBER, PUBLISHER)
    ]
    try:
        outputs = [output_of(program, 60) for program in programs]
    finally:
        for program in programs:
            program.kill()
            program.wait()
    assert [errors for _, errors in outputs] == ["", ""]
    assert int(outputs[0][0]) >= MESSAGES - 2
