"""What leaves the house: the survey as E57, the robot maps for ROS."""

from mission.export.e57 import write_e57
from mission.export.ros_map import read_ros_map, write_ros_map

__all__ = ["read_ros_map", "write_e57", "write_ros_map"]
