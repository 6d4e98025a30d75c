"""Recordings: reading, writing and comparing rosbag2 bags, without a ROS graph."""
