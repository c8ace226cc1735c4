//! Commands to a skin that is known by its contacts: tare it, switch it on or off, give it another model.
//!
//! Who asks knows a skin's name, and the topic that its contacts come on. The ROS graph knows which node publishes that topic,
//! and the node's services lie under the node's name. Where several nodes publish one topic, because none has a namespace, the
//! one that is called as its skin is meant, as nodes are by default: `left_palm` is `/gripper/left/palm`. A command that a node does not offer is not sent to it.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use dermis_msgs::Service;
use dermis_msgs::srv::{LoadModel, LoadModelRequest};
use dermis_msgs::std_srvs::srv::{SetBool, SetBoolRequest, Trigger, TriggerRequest};
use dermis_node::backend::EndpointKind;
use dermis_node::{Client, Node, NodeError};
use serde::Serialize;

/// How long a service is looked for that is not seen at once.
const LOOKING: Duration = Duration::from_secs(3);
/// How often it is looked for.
const LOOK: Duration = Duration::from_millis(20);
/// Longest wait for an answer; a node ends a tare by itself, and says why.
const PATIENCE: Duration = Duration::from_secs(60);

/// Commands that a skin's node takes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Command {
    /// Take the present readings for those of an untouched skin.
    Tare,
    /// Compute contacts, or report that it is switched off.
    SetEnabled(bool),
    /// Run another model bundle: its path, or its name, on the node's machine.
    LoadModel(String),
}

impl Command {
    /// Every word that [`Command::parse`] knows.
    pub const WORDS: [&'static str; 3] = ["tare", "set_enabled", "load_model"];

    /// A command by its word, with what it is given: nothing, `true` or `false`, and a path, each as JSON.
    ///
    /// # Errors
    ///
    /// A sentence that says what should be given.
    pub fn parse(word: &str, given: &[u8]) -> Result<Self, String> {
        let text = String::from_utf8_lossy(given);
        let value = serde_json::from_str::<serde_json::Value>(&text).ok();
        // Also as the fields of the ROS service are called.
        let field = |name: &str| value.as_ref().map(|v| v.get(name).unwrap_or(v).clone());
        let got = || if text.is_empty() { "nothing".to_owned() } else { format!("`{text}`") };
        match word {
            "tare" => Ok(Self::Tare),
            "set_enabled" => field("data")
                .and_then(|v| v.as_bool())
                .map(Self::SetEnabled)
                .ok_or_else(|| format!("set_enabled takes true or false; it was given {}", got())),
            "load_model" => field("bundle")
                .and_then(|v| v.as_str().map(str::to_owned))
                .filter(|bundle| !bundle.is_empty())
                .map(Self::LoadModel)
                .ok_or_else(|| {
                    format!(
                        "load_model takes the bundle as a JSON string, e.g. \"models/palm\"; it was given {}",
                        got()
                    )
                }),
            other => Err(format!("`{other}` is no command; there are {}", Self::WORDS.join(", "))),
        }
    }

    /// Its word, which is also the name of the service below the node's.
    #[must_use]
    pub fn word(&self) -> &'static str {
        match self {
            Self::Tare => "tare",
            Self::SetEnabled(_) => "set_enabled",
            Self::LoadModel(_) => "load_model",
        }
    }
}

/// What a node said to a command, or why it was not called.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Answer {
    /// Whether it was done.
    pub success: bool,
    /// What was done, or why not.
    pub message: String,
}

impl Answer {
    fn refused(message: impl Into<String>) -> Self {
        Self { success: false, message: message.into() }
    }
}

/// Sends commands, as one ROS node.
pub struct Commander {
    node: Node,
    tares: Clients<Trigger>,
    switches: Clients<SetBool>,
    loads: Clients<LoadModel>,
}

/// Clients by the name of their service: they are kept, because a backend may keep each that was ever made.
type Clients<S> = Mutex<HashMap<String, Client<S>>>;

impl Commander {
    /// Commands come from this node.
    #[must_use]
    pub fn new(node: &Node) -> Self {
        Self {
            node: node.clone(),
            tares: Mutex::default(),
            switches: Mutex::default(),
            loads: Mutex::default(),
        }
    }

    /// Tells the node that publishes the contacts of `skin` on `topic`, and waits for its answer.
    pub async fn tell(&self, topic: &str, skin: &str, command: &Command) -> Answer {
        let node = match node_of(&self.node, topic, skin) {
            Ok(node) => node,
            Err(why) => return Answer::refused(why),
        };
        let name = format!("{node}/{}", command.word());
        let reply = match command {
            Command::Tare => self
                .call(&self.tares, &name, &TriggerRequest::default())
                .await
                .map(|r| (r.success, r.message)),
            Command::SetEnabled(on) => self
                .call(&self.switches, &name, &SetBoolRequest { data: *on })
                .await
                .map(|r| (r.success, r.message)),
            Command::LoadModel(bundle) => self
                .call(&self.loads, &name, &LoadModelRequest { bundle: bundle.clone() })
                .await
                .map(|r| (r.success, r.message)),
        };
        match reply {
            Ok((success, message)) => Answer { success, message },
            Err(why) => Answer::refused(why),
        }
    }

    async fn call<S: Service>(
        &self,
        clients: &Clients<S>,
        name: &str,
        request: &S::Request,
    ) -> Result<S::Response, String> {
        let client = self.client(clients, name).map_err(|e| e.to_string())?;
        let begun = Instant::now();
        while !client.available() {
            if begun.elapsed() > LOOKING {
                return Err(format!(
                    "the service {name} is not offered: the node was started without this command, or is gone"
                ));
            }
            tokio::time::sleep(LOOK).await;
        }
        client.call(request, PATIENCE).await.map_err(|e| e.to_string())
    }

    fn client<S: Service>(&self, clients: &Clients<S>, name: &str) -> Result<Client<S>, NodeError> {
        let mut clients = clients.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(client) = clients.get(name) {
            return Ok(client.clone());
        }
        let client = self.node.client::<S>(name)?;
        clients.insert(name.to_owned(), client.clone());
        Ok(client)
    }
}

/// The full name of the node that publishes `topic` about `skin`.
///
/// # Errors
///
/// A sentence: nobody publishes it, or several do.
pub fn node_of(node: &Node, topic: &str, skin: &str) -> Result<String, String> {
    let offers = node.endpoints(topic, EndpointKind::Publisher).map_err(|e| e.to_string())?;
    let mut names: Vec<String> =
        offers.into_iter().map(|offer| offer.node).filter(|n| !n.is_empty()).collect();
    names.sort();
    names.dedup();
    choose(&names, topic, skin)
}

fn choose(nodes: &[String], topic: &str, skin: &str) -> Result<String, String> {
    match nodes {
        [] => Err(format!("no node publishes {topic} any more")),
        [one] => Ok(one.clone()),
        several => {
            // ROS names have no `-`.
            let called = skin.replace('-', "_");
            let ending = format!("_{called}");
            let mut fitting = several.iter().filter(|name| name.replace('/', "_").ends_with(&ending));
            match (fitting.next(), fitting.next()) {
                (Some(one), None) => Ok(one.clone()),
                _ => Err(format!(
                    "{} publish {topic}, and none alone is called as the skin `{skin}`: give each node a namespace of its own",
                    several.join(" and ")
                )),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_read_from_json() {
        assert_eq!(Command::parse("tare", b""), Ok(Command::Tare));
        for text in ["true", " true\n", r#"{"data": true}"#] {
            assert_eq!(
                Command::parse("set_enabled", text.as_bytes()),
                Ok(Command::SetEnabled(true)),
                "{text}"
            );
        }
        for text in [r#""models/palm""#, r#"{"bundle": "models/palm"}"#] {
            assert_eq!(
                Command::parse("load_model", text.as_bytes()),
                Ok(Command::LoadModel("models/palm".into()))
            );
        }
        let refused = |word, text: &str| Command::parse(word, text.as_bytes()).unwrap_err();
        insta::assert_snapshot!(refused("set_enabled", ""), @"set_enabled takes true or false; it was given nothing");
        insta::assert_snapshot!(refused("set_enabled", "on"), @"set_enabled takes true or false; it was given `on`");
        insta::assert_snapshot!(refused("load_model", "7"), @r#"load_model takes the bundle as a JSON string, e.g. "models/palm"; it was given `7`"#);
        insta::assert_snapshot!(refused("shutdown", ""), @"`shutdown` is no command; there are tare, set_enabled, load_model");
    }

    #[test]
    fn the_node_of_a_skin_is_found_or_the_reason_why_not() {
        let nodes = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
        assert_eq!(choose(&nodes(&["/left/palm"]), "/left/contacts", "baro-grid"), Ok("/left/palm".into()));
        assert_eq!(
            choose(&nodes(&["/baro_dome", "/baro_grid"]), "/contacts", "baro-grid"),
            Ok("/baro_grid".into())
        );
        let palms = nodes(&["/gripper/left/palm", "/gripper/right/palm"]);
        for skin in ["right_palm", "gripper_right_palm"] {
            assert_eq!(choose(&palms, "/gripper/contacts", skin), Ok("/gripper/right/palm".into()), "{skin}");
        }
        insta::assert_snapshot!(choose(&nodes(&["/a", "/b"]), "/contacts", "baro-grid").unwrap_err(), @"/a and /b publish /contacts, and none alone is called as the skin `baro-grid`: give each node a namespace of its own");
        insta::assert_snapshot!(choose(&[], "/contacts", "baro-grid").unwrap_err(), @"no node publishes /contacts any more");
    }
}
