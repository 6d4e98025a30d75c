"""Recordings that people have become bags: text files of poses, bags of ROS 1, other topics, frames of /tf."""
