//! `dermis container`: several nodes in one process.
//!
//! They share a session of the embedded implementation of ROS 2, so that a message from one to another is a call and no write to a
//! socket, and a large one is not copied. They start together and end together: a node that fails ends the others, and with
//! them the process, which whoever supervises it can start again as a whole. A node that is shut down through its
//! lifecycle, or whose work is done, leaves the others running.

use std::pin::Pin;

use anyhow::{Context, Result, bail};
use clap::{Args, Parser};
use tokio::task::JoinSet;

use crate::backend::Backends;
use crate::{Cli, Command, bridge, fusion, interrupt, nodes, record, reflex, sentence};

/// What runs in the process.
#[derive(Args)]
pub struct Options {
    /// Nodes, each with its arguments as on a line of its own, and `--` between them: `run`, the name of a sensor family, `fusion`,
    /// `reflex`, `bridge` or `record`.
    #[arg(required = true, trailing_var_arg = true, allow_hyphen_values = true, value_name = "NODE")]
    nodes: Vec<String>,
}

/// Between the arguments of one node and those of the next.
const SEPARATOR: &str = "--";

/// Whether a command can share a process with others.
pub fn can_share(command: &Command) -> bool {
    matches!(
        command,
        Command::Node(_) | Command::Reflex(_) | Command::Fusion(_) | Command::Bridge(_) | Command::Record(_)
    )
}

/// Runs until Ctrl-C or SIGTERM, until a node fails, or until all have ended.
pub async fn run(options: Options) -> Result<()> {
    let commands: Vec<(String, Command)> =
        options.nodes.split(|word| word == SEPARATOR).map(parse).collect::<Result<_>>()?;
    let ended = interrupt::ended()?;
    let (end, ends) = tokio::sync::watch::channel(false);
    let backends = Backends::one_session();
    let mut running = JoinSet::new();
    for (name, command) in commands {
        let (backends, mut ends) = (backends.clone(), ends.clone());
        running.spawn(async move {
            let end = async move {
                // Whoever would tell it is gone only with the process.
                let _ = ends.wait_for(|end| *end).await;
            };
            let done = start(command, &backends, Box::new(|| Ok(Box::pin(end)))).await;
            (name, done)
        });
    }
    let end_all = || {
        end.send_replace(true);
        dermis_node::end_all_nodes();
    };
    let mut ended = std::pin::pin!(ended);
    let mut stopping = false;
    let mut failures = Vec::new();
    loop {
        tokio::select! {
            () = &mut ended, if !stopping => {
                stopping = true;
                end_all();
            }
            done = running.join_next() => {
                let Some(done) = done else { break };
                let (name, done) = done.context("a node has panicked")?;
                match done {
                    Ok(()) if stopping || running.is_empty() => {}
                    Ok(()) => tracing::info!("`{name}` has ended; the other nodes of this process go on"),
                    Err(error) => {
                        failures.push(error.context(format!("`{name}` failed")));
                        stopping = true;
                        end_all();
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
fn parse(words: &[String]) -> Result<(String, Command)> {
    if words.is_empty() {
        bail!(
            "`dermis container` has nothing before or after a `{SEPARATOR}`; write a node on both sides of it"
        );
    }
    let name = format!("dermis {}", words.join(" "));
    let all = std::iter::once("dermis").chain(words.iter().map(String::as_str));
    match Cli::try_parse_from(all) {
        Ok(cli) if can_share(&cli.command) => Ok((name, cli.command)),
        Ok(_) => bail!(
            "`{name}` is no node that can share a process; these can: `run`, a sensor family, `fusion`, `reflex`, `bridge`, `record`"
        ),
        Err(error) => bail!("`{name}`: {}", sentence(&error)),
    }
}

/// When what has no end of its own ends; made once that begins.
pub type End = Box<dyn FnOnce() -> Result<Pin<Box<dyn Future<Output = ()> + Send>>> + Send>;

/// Runs a command that can share a process, alone or not: nodes end by signals and their lifecycle, a recording with `end`.
pub async fn start(command: Command, backends: &Backends, end: End) -> Result<()> {
    match command {
        Command::Node(node) => nodes::run(node, backends).await,
        Command::Reflex(options) => reflex::run(options, backends).await,
        Command::Fusion(options) => fusion::run(*options, backends).await,
        Command::Bridge(options) => bridge::run(options, backends).await,
        Command::Record(options) => record::run(*options, backends, end()?).await,
        _ => bail!("no node that can share a process"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<String> {
        text.split_whitespace().map(str::to_owned).collect()
    }

    fn parsed(text: &str) -> Result<Vec<String>, String> {
        let cli = Cli::try_parse_from(words(text)).map_err(|error| sentence(&error))?;
        let Command::Container(options) = cli.command else { return Err("another command".to_owned()) };
        let nodes = options.nodes.split(|word| word == SEPARATOR).map(|words| Ok(parse(words)?.0));
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
