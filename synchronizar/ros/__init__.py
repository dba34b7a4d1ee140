"""Robots with ROS in a room, by rosbridge: their odometry and ranges go in, where they are comes out."""
