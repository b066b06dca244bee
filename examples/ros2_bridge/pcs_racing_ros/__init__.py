"""Simulator and planner nodes of ROS 2, with the topics of f1tenth_gym_ros."""
