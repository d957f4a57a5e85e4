"""ROS bags and MCAP recordings, read and written without ROS."""
