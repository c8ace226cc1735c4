//! The r2r backend of dermis-node, for robots with ROS 2 installed.
