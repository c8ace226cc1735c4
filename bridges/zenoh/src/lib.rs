//! Everything for clients that know no ROS: JSON over zenoh.
