//! What a publisher costs its node when somebody listens and when nobody does.

use std::hint::black_box;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use clap::Args;
use dermis_msgs::msg::{Contact, ContactArray};
use dermis_node::{Node, NodeOptions, Qos};
use serde_json::{Value, json};

use crate::subscriber::{Choice, start};

/// What to measure.
#[derive(Debug, Args)]
pub struct Options {
    /// ROS 2 implementation.
    #[arg(long, value_enum, default_value = "hiroz")]
    backend: Choice,
    /// Messages of each measurement.
    #[arg(long, default_value_t = 200_000)]
    messages: u32,
}

/// Measures both.
///
/// # Errors
///
/// Where ROS refuses or the subscriber does not come.
pub fn run(options: &Options) -> Result<Value> {
    let domain = 100 + (std::process::id() % 20) as u16;
    let backend = options.backend.open()?;
    let mut node_options = NodeOptions::new("bench_publisher");
    node_options.domain_id = Some(domain);
    node_options = node_options.localhost_only(true);
    let node = Node::open(node_options, backend.as_ref())?;
    let publisher = node.publisher::<ContactArray>("contacts", Qos::sensor_data())?;
    let message = ContactArray {
        skin: "baro-grid".into(),
        contacts: vec![Contact { taxels: vec![1; 25], ..Contact::default() }],
        ..ContactArray::default()
    };
    let mean_ns = |publish: &mut dyn FnMut() -> Result<()>| -> Result<f64> {
        let begun = Instant::now();
        for _ in 0..options.messages {
            publish()?;
        }
        Ok(begun.elapsed().as_nanos() as f64 / f64::from(options.messages))
    };
    // As every node of ours does it: ask first, and compute nothing that nobody wants.
    let mut request = || -> Result<()> {
        if black_box(&publisher).subscriber_count() > 0 {
            publisher.publish(black_box(&message))?;
        }
        Ok(())
    };
    let unheard = mean_ns(&mut request)?;
    let careless = mean_ns(&mut || Ok(publisher.publish(black_box(&message))?))?;
    let (_subscriber, arrivals) = start(options.backend, domain)?;
    let patience = Instant::now() + Duration::from_secs(20);
    while publisher.subscriber_count() == 0 {
        if Instant::now() > patience {
            bail!("the subscriber was not seen within 20 s");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let heard = mean_ns(&mut request)?;
    let arrived = arrivals.recv_timeout(Duration::from_secs(5)).is_ok();
    if !arrived {
        bail!("no message arrived");
    }
    eprintln!("publish, nobody listens      {unheard:>9.1} ns");
    eprintln!("publish without asking first {careless:>9.1} ns");
    eprintln!("publish, one subscriber      {heard:>9.1} ns");
    Ok(json!({
        "backend": options.backend.name(),
        "unheard_ns": unheard,
        "without_asking_ns": careless,
        "heard_ns": heard,
        "share": unheard / heard,
    }))
}
