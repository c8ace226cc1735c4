//! One node API over two ROS 2 backends.
