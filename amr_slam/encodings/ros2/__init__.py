"""ROS 2 without ROS: the bytes, keys and tokens by which its programs find a robot on Zenoh."""

from amr_slam.encodings.ros2.encoder import Ros2Encoder
from amr_slam.encodings.ros2.rights import Ros2Keys, ros2_keys
from amr_slam.encodings.ros2.settings import Ros2Settings

__all__ = ["Ros2Encoder", "Ros2Keys", "Ros2Settings", "ros2_keys"]
