"""ROS 2: bags and MCAP files without ROS, and a node with it; both over the same conversions of messages."""
