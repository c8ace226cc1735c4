//! ROS 2 messages of dermis: .msg text, Rust types made from it, CDR and RIHS01 type hashes.
