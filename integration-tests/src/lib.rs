//! Tests across processes: rclpy, zenoh's Python client, bag readers.
