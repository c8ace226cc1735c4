//! The force on each link of a robot, from its fused contacts, as lines: the state interface of a controller, by topic.
//!
//! `cargo run --release -p dermis-node --example links`

use dermis_msgs::geometry_msgs::msg::WrenchStamped;
use dermis_msgs::msg::{BodyContacts, ContactArray, LinkWrench};
use dermis_node::{HirozBackend, Node, NodeError, NodeOptions, Publisher, Qos};

/// One publisher a link, made when the link is sensed first.
struct Links {
    node: Node,
    publishers: Vec<(String, Publisher<WrenchStamped>)>,
}

impl Links {
    fn spread(&mut self, body: &BodyContacts) -> Result<(), NodeError> {
        for of in &body.wrenches {
            // What cannot be sensed is no force of zero: the topic falls silent.
            if ![ContactArray::STATUS_OK, ContactArray::STATUS_DEGRADED].contains(&of.status) {
                println!("{} is not sensed", of.link);
                continue;
            }
            let mut message = WrenchStamped { header: body.header.clone(), wrench: of.wrench.clone() };
            message.header.frame_id.clone_from(&of.link);
            self.publisher(of)?.publish(&message)?;
            let force = &of.wrench.force;
            println!("{} {:.3} {:.3} {:.3} N", of.link, force.x, force.y, force.z);
        }
        Ok(())
    }

    fn publisher(&mut self, of: &LinkWrench) -> Result<Publisher<WrenchStamped>, NodeError> {
        if let Some((_, known)) = self.publishers.iter().find(|(link, _)| *link == of.link) {
            return Ok(known.clone());
        }
        let made = self.node.stream_publisher(&format!("{}/wrench", of.link), 10)?;
        self.publishers.push((of.link.clone(), made.clone()));
        Ok(made)
    }
}

#[tokio::main]
async fn main() -> Result<(), NodeError> {
    let node = Node::open(NodeOptions::new("link_wrenches"), &HirozBackend::default())?;
    let mut links = Links { node: node.clone(), publishers: Vec::new() };
    let _contacts = node.subscribe("body_contacts", Qos::sensor_data(), move |body: BodyContacts, _| {
        if let Err(error) = links.spread(&body) {
            eprintln!("{error}");
        }
    })?;
    node.wait_for_shutdown().await
}
