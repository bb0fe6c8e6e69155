"""ROS 2 bags: read (whole or cut off), written, and converted frame by frame. No rclpy in here.

The room stands behind the pipeline, because converting a bag needs it, and before `sources`, for
which a bag is a source of frames like a folder of pictures. Its files, in their order:

- `names`, `contents`, `codec`, `topics`: topics and messages of a bag, and what the messages hold;
- `layout`, `mcap_records`, `mcap_file`, `sqlite_file`, `sqlite_recovery`, `opening`, `reading`: the
  files of a bag, each as far as it can be read;
- `mcap_writing`, `writing`: new bags; `recording`: of simulated frames;
- `frames`, `messages`: one frame through the pipeline, and the messages of its results;
- `pairing`, `score`, `frame_log`, `figures`, `page`: the report;
- `engine`: work on frames, or on bags, by worker processes;
- `conversion`, `many`: one bag, and many.

Needs rosbags and joblib, and matplotlib for reports, which come with the extra `eval`.
"""

from coded_aperture_ros.bags.contents import BagMessage
from coded_aperture_ros.bags.names import is_bag
from coded_aperture_ros.bags.reading import Bag
from coded_aperture_ros.bags.recording import record_views
from coded_aperture_ros.bags.writing import bag_output, check_bag_output
