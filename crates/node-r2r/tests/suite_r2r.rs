//! The behaviour suite over r2r. Under nextest each test is a process, and so a ROS context, of its own.

use std::sync::Arc;

use dermis_node_r2r::R2rBackend;

dermis_node::behaviour_suite!(Arc::new(R2rBackend));
