//! A planner's view of a skin: GO, STOP on a contact, BLIND where the skin cannot tell.
//!
//! `cargo run --release -p dermis-node --example planner -- 0.2`

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use dermis_msgs::msg::{Contact, ContactArray};
use dermis_node::{HirozBackend, Node, NodeError, NodeOptions, Qos};

/// What was decided last, and when contacts came last.
struct Planner {
    limit: f64,
    said: &'static str,
    heard: Instant,
}

impl Planner {
    fn decide(&mut self, array: &ContactArray) {
        self.heard = Instant::now();
        // Empty means "not touched" only while the skin can tell.
        if ![ContactArray::STATUS_OK, ContactArray::STATUS_DEGRADED].contains(&array.status) {
            return self.say("BLIND", &format!("{}: {}", array.skin, array.status_text));
        }
        let strongest = array.contacts.iter().map(|c| (force(c), c)).max_by(|a, b| a.0.total_cmp(&b.0));
        match strongest {
            Some((force, c)) if force > self.limit => {
                let at = format!("{:.4} {:.4} {:.4}", c.position.x, c.position.y, c.position.z);
                let frame = &array.header.frame_id;
                self.say("STOP", &format!("{} {force:.2} N at {at} m in {frame}", array.skin));
            }
            _ => self.say("GO", &array.skin),
        }
    }

    fn say(&mut self, word: &'static str, why: &str) {
        if word != self.said {
            self.said = word;
            println!("{word} {why}");
        }
    }
}

/// Force along the inward normal \[N\]; infinite where the model gives none, so that the planner stops.
fn force(contact: &Contact) -> f64 {
    if contact.force_components == Contact::FORCE_NONE {
        return f64::INFINITY;
    }
    let (f, n) = (&contact.force, &contact.normal);
    -(f.x * n.x + f.y * n.y + f.z * n.z)
}

#[tokio::main]
async fn main() -> Result<(), NodeError> {
    let limit = std::env::args().nth(1).and_then(|text| text.parse().ok()).unwrap_or(0.2);
    let planner = Arc::new(Mutex::new(Planner { limit, said: "", heard: Instant::now() }));
    let node = Node::open(NodeOptions::new("planner"), &HirozBackend::default())?;
    let deciding = Arc::clone(&planner);
    // Best effort: a planner wants the newest contacts, not all of them.
    let _contacts = node.subscribe("contacts", Qos::sensor_data(), move |array: ContactArray, _| {
        deciding.lock().unwrap_or_else(PoisonError::into_inner).decide(&array);
    })?;
    let mut watch = tokio::time::interval(Duration::from_millis(100));
    // Ends with Ctrl-C, too.
    let ended = node.wait_for_shutdown();
    tokio::pin!(ended);
    loop {
        tokio::select! {
            ended = &mut ended => return ended,
            _ = watch.tick() => {
                let mut planner = planner.lock().unwrap_or_else(PoisonError::into_inner);
                // A node that is gone says nothing at all.
                if planner.heard.elapsed() > Duration::from_millis(500) {
                    planner.say("BLIND", "no contacts for 0.5 s");
                }
            }
        }
    }
}
