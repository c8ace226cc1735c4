//! The zenoh bridge as a program of its own.

use anyhow::Result;
use clap::Args;
use dermis_bridge_zenoh::{Bridge, BridgeConfig};
use dermis_node::{Node, NodeOptions};

use crate::backend::Choice;

/// Where the bridge appears.
#[derive(Args)]
pub struct Options {
    /// Second part of every key: one word that tells this robot from others.
    #[arg(long, default_value = "robot")]
    robot: String,
    /// `peer` finds others by itself, `client` talks through a router.
    #[arg(long, default_value = "peer")]
    mode: String,
    /// Endpoint to connect to, e.g. tcp/192.0.2.1:7447; may be repeated.
    #[arg(long)]
    connect: Vec<String>,
    /// Endpoint to listen on, e.g. tcp/0.0.0.0:7448; may be repeated.
    #[arg(long)]
    listen: Vec<String>,
    /// Offer no commands: nobody tares, switches or loads a model through it.
    #[arg(long)]
    read_only: bool,
    /// ROS 2 implementation that the skins speak.
    #[arg(long, value_enum, default_value_t)]
    backend: Choice,
}

/// Runs until Ctrl-C.
pub async fn run(options: Options) -> Result<()> {
    let node = Node::open(NodeOptions::new("dermis_bridge"), options.backend.open()?.as_ref())?;
    let config = BridgeConfig {
        robot: options.robot,
        mode: options.mode,
        connect: options.connect,
        listen: options.listen,
        read_only: options.read_only,
        ..BridgeConfig::default()
    };
    let bridge = Bridge::open(&node, config).await?;
    node.wait_for_shutdown().await?;
    bridge.close().await;
    Ok(())
}
