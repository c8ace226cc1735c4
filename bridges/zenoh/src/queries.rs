//! Commands to a skin as zenoh queries, each with an answer: a `get` on `<skin's key>/tare`, `…/set_enabled`, `…/load_model`.
//!
//! A query is obeyed only where its key ends in the command's word. `get dermis/**` asks what there is; it matches the keys of
//! commands, too, and must not tare a robot.

use std::sync::Arc;

use serde_json::Value;
use tracing::{info, warn};
use zenoh::bytes::Encoding;
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

use crate::commands::{Answer, Command, Commander};

/// The commands of one skin; dropping them withdraws them.
pub(crate) struct Offered {
    _queryables: Vec<Queryable<()>>,
}

/// Offers the commands of the skin whose contacts come on `topic`, below `key`.
pub(crate) fn offer(
    session: &Session,
    commander: &Arc<Commander>,
    runtime: &tokio::runtime::Handle,
    key: &str,
    topic: &str,
    skin: &str,
) -> zenoh::Result<Offered> {
    let mut queryables = Vec::new();
    for word in Command::WORDS {
        let own = format!("{key}/{word}");
        let (commander, runtime) = (Arc::clone(commander), runtime.clone());
        let (topic, skin, answered) = (topic.to_owned(), skin.to_owned(), own.clone());
        let queryable = session.declare_queryable(own).callback(move |query| {
            if !names(query.key_expr().as_str(), word) {
                return;
            }
            let (commander, key) = (Arc::clone(&commander), answered.clone());
            let (topic, skin) = (topic.clone(), skin.clone());
            // A tare takes seconds, and this is zenoh's thread.
            runtime.spawn(async move { obey(&commander, &topic, &skin, word, &key, &query).await });
        });
        queryables.push(queryable.wait()?);
    }
    Ok(Offered { _queryables: queryables })
}

/// Whether a key expression asks for this command, and not for everything there is.
fn names(key_expression: &str, word: &str) -> bool {
    key_expression.rsplit('/').next() == Some(word)
}

async fn obey(commander: &Commander, topic: &str, skin: &str, word: &str, key: &str, query: &Query) {
    let given = query.payload().map(|bytes| bytes.to_bytes().into_owned()).unwrap_or_default();
    let answer = match Command::parse(word, &given) {
        Ok(command) => commander.tell(topic, skin, &command).await,
        Err(message) => Answer { success: false, message },
    };
    info!("bridge: {word} of skin {skin}: {}", answer.message);
    let text = serde_json::to_value(&answer).unwrap_or(Value::Null).to_string();
    if let Err(e) = query.reply(key, text).encoding(Encoding::APPLICATION_JSON).await {
        warn!("bridge: {key} was not answered: {e}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looking_around_commands_nothing() {
        for key_expression in ["dermis/arm/palm/tare", "dermis/*/*/tare", "**/tare"] {
            assert!(names(key_expression, "tare"), "{key_expression}");
        }
        for key_expression in
            ["dermis/**", "dermis/arm/palm/*", "**", "dermis/arm/palm/ta$*", "dermis/arm/tare/contacts"]
        {
            assert!(!names(key_expression, "tare"), "{key_expression}");
        }
    }
}
