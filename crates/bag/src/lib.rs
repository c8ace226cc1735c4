//! rosbag2 bags in MCAP: write and read.
