//! `dermis container`: several nodes in one process.
//!
//! They share a session of the embedded implementation of ROS 2, so that a message from one to another is a call and no write to a
//! socket, and a large one is not copied. They start together and end together: a node that fails ends the others, and with
//! them the process, which whoever supervises it can start again as a whole. A node that is shut down through its
//! lifecycle, or whose work is done, leaves the others running.

use std::pin::Pin;

use anyhow::{Error, Result, bail};
use clap::{Args, Subcommand};
use dermis_launch::NODE_SEPARATOR;
use tokio::task::JoinSet;

use crate::backend::Backends;
use crate::{Command, bridge, fusion, interrupt, nodes, record, reflex};

/// What runs in the process.
#[derive(Args)]
pub struct Options {
    /// Nodes, each with its arguments as on a line of its own, and `--` between them: `run`, the name of a sensor family, `fusion`,
    /// `reflex`, `bridge` or `record`.
    #[arg(required = true, trailing_var_arg = true, allow_hyphen_values = true, value_name = "NODE")]
    nodes: Vec<String>,
}

/// A command that can share a process with others.
#[derive(Subcommand)]
pub enum Node {
    #[command(flatten)]
    Skin(nodes::Node),
    /// Act on touch: stop or slow a robot by rules on its contacts, and on the loss of its senses.
    Reflex(reflex::Options),
    /// Merge the contacts of all skins of a robot into one list for its body, with wrenches and joint torques.
    Fusion(Box<fusion::Options>),
    /// Offer every skin in the ROS domain as JSON over zenoh, for clients that know no ROS.
    Bridge(bridge::Options),
    /// Record what is published into a bag.
    Record(Box<record::Options>),
}

/// When what has no end of its own ends; made once that begins.
type End = Box<dyn FnOnce() -> Result<Pin<Box<dyn Future<Output = ()> + Send>>> + Send>;

impl Node {
    /// Runs it in a process of its own, until Ctrl-C or SIGTERM.
    pub async fn run_alone(self) -> Result<()> {
        self.run(&Backends::default(), Box::new(|| Ok(Box::pin(interrupt::ended()?)))).await
    }

    /// Nodes end by signals and through their lifecycle, a recording with `end`.
    async fn run(self, backends: &Backends, end: End) -> Result<()> {
        match self {
            Self::Skin(node) => nodes::run(node, backends).await,
            Self::Reflex(options) => reflex::run(options, backends).await,
            Self::Fusion(options) => fusion::run(*options, backends).await,
            Self::Bridge(options) => bridge::run(options, backends).await,
            Self::Record(options) => record::run(*options, backends, end()?).await,
        }
    }
}

/// Runs until Ctrl-C or SIGTERM, until a node fails, or until all have ended.
pub async fn run(options: Options) -> Result<()> {
    let nodes: Vec<(String, Node)> =
        options.nodes.split(|word| word == NODE_SEPARATOR).map(parse).collect::<Result<_>>()?;
    let mut ended = std::pin::pin!(interrupt::ended()?);
    let backends = Backends::one_session();
    let mut running = JoinSet::new();
    for (name, node) in nodes {
        let backends = backends.clone();
        running.spawn(async move {
            let end: End = Box::new(|| Ok(Box::pin(dermis_node::end_of_all_nodes())));
            node.run(&backends, end).await.map_err(|error| error.context(format!("`{name}` failed")))?;
            Ok(name)
        });
    }
    let mut stopping = false;
    let mut failures = Vec::new();
    loop {
        tokio::select! {
            () = &mut ended, if !stopping => {
                stopping = true;
                dermis_node::end_all_nodes();
            }
            done = running.join_next() => {
                let Some(done) = done else { break };
                match done.map_err(|panic| Error::from(panic).context("a node has panicked")).flatten() {
                    Ok(_) if stopping || running.is_empty() => {}
                    Ok(name) => tracing::info!("`{name}` has ended; the other nodes of this process go on"),
                    Err(error) => {
                        failures.push(error);
                        stopping = true;
                        dermis_node::end_all_nodes();
                    }
                }
            }
        }
    }
    let mut failures = failures.into_iter();
    let Some(first) = failures.next() else { return Ok(()) };
    for failure in failures {
        tracing::error!("{failure:#}");
    }
    Err(first)
}

/// A node by its arguments; it goes by the command and what follows it.
fn parse(words: &[String]) -> Result<(String, Node)> {
    if words.is_empty() {
        bail!(
            "`dermis container` has nothing before or after a `{NODE_SEPARATOR}`; write a node on both sides of it"
        );
    }
    let name = format!("dermis {}", words.join(" "));
    match crate::parse(words).map_err(Error::msg)? {
        Command::Node(node) => Ok((name, node)),
        _ => bail!(
            "`{name}` is no node that can share a process; these can: `run`, a sensor family, `fusion`, `reflex`, `bridge`, `record`"
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<String> {
        text.split_whitespace().map(str::to_owned).collect()
    }

    fn parsed(text: &str) -> Result<Vec<String>, String> {
        let command = crate::parse(&words(text)[1..])?;
        let Command::Container(options) = command else { return Err("another command".to_owned()) };
        let nodes = options.nodes.split(|word| word == NODE_SEPARATOR).map(|words| Ok(parse(words)?.0));
        nodes.collect::<Result<_>>().map_err(|error| error.to_string())
    }

    #[test]
    fn nodes_are_cut_at_the_separator() {
        let nodes = parsed(
            "dermis container run pad.toml --source udp://0.0.0.0:7400 -- fusion --robot r.toml -- bridge -- record -o bag",
        );
        assert_eq!(
            nodes.unwrap(),
            [
                "dermis run pad.toml --source udp://0.0.0.0:7400",
                "dermis fusion --robot r.toml",
                "dermis bridge",
                "dermis record -o bag"
            ]
        );
    }

    #[test]
    fn what_is_no_node_is_refused_with_what_is() {
        for (line, expected) in [
            ("dermis container bag info b", "is no node that can share a process"),
            ("dermis container bridge --", "nothing before or after"),
            ("dermis container bridge -- fusion", "`dermis fusion`: the following required arguments"),
            ("dermis container", "required arguments"),
            ("dermis container container bridge", "is no node"),
        ] {
            let error = parsed(line).unwrap_err();
            assert!(error.contains(expected), "{line}: {error}");
        }
    }
}
