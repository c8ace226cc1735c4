//! Whose messages a key carries.
//!
//! Keys go by the name of a skin. Two devices can claim one name: two launch files that both say `palm`, a node that was started
//! twice. Their messages must never come one between the other under one key, since a client could not tell a press on one hand
//! from a press on the other. So the first message on a key makes its topic and its publisher the owner, and
//!
//! - another *topic* with the same name and the same last part splits the name: from then on every key of that skin begins with
//!   the topic's namespace (`left_palm`, `right_palm`), whichever came first, and the bare name has no key any more;
//! - another *publisher* on the same topic is refused while the owner speaks. An owner that was silent for a while, as a node
//!   that was started again, is replaced.
//!
//! Each of it is warned of once, with what claims the name.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

/// Silence after which another publisher on the same topic is taken for the same node, started again: a skin without frames
/// says so twice a second.
const SILENT: Duration = Duration::from_millis(750);
/// The same once both were heard at a time: on a busy machine messages of one are late now and then.
const SILENT_RIVAL: Duration = Duration::from_secs(10);

/// Unique id of a publisher, where the wire tells.
pub(crate) type Publisher = Option<[u8; 16]>;

/// What is to be done with a message.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// Send it as this skin.
    As(String),
    /// Send it as this skin, after all keys of a skin have moved: those of each topic to the name beside it.
    Moved {
        /// Name of the skin for this message.
        name: String,
        /// Name that has no keys any more.
        from: String,
        /// Topic, and name of its skin from now on.
        to: BTreeMap<String, String>,
        /// One sentence.
        warning: String,
    },
    /// Do not send it. The sentence comes once.
    Refused(Option<String>),
}

/// Who owns which key.
#[derive(Debug, Default)]
pub(crate) struct Claims {
    /// By the name on keys and the last part of the topic.
    owners: BTreeMap<(String, String), Owner>,
    /// Names that two topics have claimed.
    split: BTreeSet<String>,
    /// Topics and names that were warned of.
    warned: BTreeSet<(String, String)>,
    /// Coordinate frame and type of each skin, and the pairs that were warned of.
    frames: BTreeMap<String, (String, String)>,
}

#[derive(Debug)]
struct Owner {
    topic: String,
    publisher: Publisher,
    heard: Instant,
    /// Another publisher spoke while this one did.
    rival: bool,
}

/// The last part of a topic's name.
pub(crate) fn last_part(topic: &str) -> &str {
    topic.rsplit('/').next().unwrap_or(topic)
}

/// The name of a skin that is distinguished by its topic's namespace.
fn beside_namespace(topic: &str, skin: &str) -> String {
    let namespace = topic.trim_matches('/').rsplit_once('/').map_or("root", |(namespace, _)| namespace);
    format!("{}_{skin}", namespace.replace('/', "_"))
}

impl Claims {
    /// What to do with a message that names `skin`.
    pub(crate) fn claim(&mut self, skin: &str, topic: &str, publisher: Publisher, now: Instant) -> Verdict {
        if self.split.contains(skin) {
            return self.claim_key(&beside_namespace(topic, skin), topic, publisher, now);
        }
        let key = (skin.to_owned(), last_part(topic).to_owned());
        let Some(owner) = self.owners.get(&key).filter(|owner| owner.topic != topic) else {
            return self.claim_key(skin, topic, publisher, now);
        };
        let first = owner.topic.clone();
        self.split.insert(skin.to_owned());
        let moved = std::mem::take(&mut self.owners);
        let mut to = BTreeMap::new();
        for ((name, part), owner) in moved {
            if name == skin {
                let name = beside_namespace(&owner.topic, skin);
                to.insert(owner.topic.clone(), name.clone());
                self.owners.entry((name, part)).or_insert(owner);
            } else {
                self.owners.insert((name, part), owner);
            }
        }
        let name = beside_namespace(topic, skin);
        let warning = format!(
            "{first} and {topic} both name their skin `{skin}`: from now on they are `{}` and `{name}`, and `{skin}` has no \
             keys; give each node an `instance` of its own",
            beside_namespace(&first, skin)
        );
        match self.claim_key(&name, topic, publisher, now) {
            Verdict::As(name) => Verdict::Moved { name, from: skin.to_owned(), to, warning },
            other => other,
        }
    }

    /// Takes a key for a topic and a publisher, unless another one has it.
    fn claim_key(&mut self, name: &str, topic: &str, publisher: Publisher, now: Instant) -> Verdict {
        let key = (name.to_owned(), last_part(topic).to_owned());
        let Some(owner) = self.owners.get_mut(&key) else {
            let owner = Owner { topic: topic.to_owned(), publisher, heard: now, rival: false };
            self.owners.insert(key, owner);
            return Verdict::As(name.to_owned());
        };
        if owner.topic != topic {
            let warning = format!(
                "{topic} is not bridged: `{name}` is the skin of {} already; give its node an `instance` of its own",
                owner.topic
            );
            return self.refuse(topic, name, warning);
        }
        // A wire that tells nothing of publishers cannot tell them apart.
        if owner.publisher == publisher || owner.publisher.is_none() || publisher.is_none() {
            (owner.publisher, owner.heard) = (publisher.or(owner.publisher), now);
            return Verdict::As(name.to_owned());
        }
        let silent = now.saturating_duration_since(owner.heard);
        if silent >= if owner.rival { SILENT_RIVAL } else { SILENT } {
            *owner = Owner { topic: topic.to_owned(), publisher, heard: now, rival: false };
            return Verdict::As(name.to_owned());
        }
        owner.rival = true;
        let warning = format!(
            "two publishers on {topic} both name their skin `{name}`: only the first one is bridged; end one of the nodes, or \
             give each an `instance` of its own"
        );
        self.refuse(topic, name, warning)
    }

    fn refuse(&mut self, topic: &str, name: &str, warning: String) -> Verdict {
        let news = self.warned.insert((topic.to_owned(), name.to_owned()));
        Verdict::Refused(news.then_some(warning))
    }

    /// A topic went away: its keys are free.
    pub(crate) fn release(&mut self, topic: &str) {
        self.owners.retain(|_, owner| owner.topic != topic);
        self.warned.retain(|(other, _)| other != topic);
        let owners = &self.owners;
        let beside = |skin: &str, owner: &Owner, name: &str| beside_namespace(&owner.topic, skin) == name;
        self.split.retain(|skin| owners.iter().any(|((name, _), owner)| beside(skin, owner, name)));
        self.frames.retain(|skin, _| owners.keys().any(|(name, _)| name == skin));
    }

    /// Notes the coordinate frame and type of a skin; a sentence where another skin of that type is in the same frame.
    pub(crate) fn place(&mut self, name: &str, frame_id: &str, hash: &str) -> Option<String> {
        let placed = (frame_id.to_owned(), hash.to_owned());
        if self.frames.insert(name.to_owned(), placed.clone()).as_ref() == Some(&placed) {
            return None;
        }
        let twin = self.frames.iter().find(|(other, at)| *other != name && **at == placed)?.0;
        Some(format!(
            "skins `{twin}` and `{name}` are of one type and both in the coordinate frame `{frame_id}`: their contacts lie on \
             top of each other; give each node a `frame_id` of its own"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: Publisher = Some([1; 16]);
    const B: Publisher = Some([2; 16]);

    fn sent_as(verdict: Verdict) -> String {
        match verdict {
            Verdict::As(name) => name,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn topics_of_different_skins_are_different_keys() {
        let (mut claims, now) = (Claims::default(), Instant::now());
        // Two skins on one topic, as where `contacts` is remapped.
        for (skin, publisher) in [("left", A), ("right", B), ("left", A), ("right", B)] {
            assert_eq!(sent_as(claims.claim(skin, "/gripper/contacts", publisher, now)), skin);
        }
        assert_eq!(sent_as(claims.claim("left", "/gripper/left/taxels", A, now)), "left");
    }

    #[test]
    fn a_name_that_two_topics_claim_is_distinguished_whichever_came_first() {
        let now = Instant::now();
        for order in [["/gripper/left", "/gripper/right"], ["/gripper/right", "/gripper/left"]] {
            let mut claims = Claims::default();
            let [first, second] = order.map(|namespace| format!("{namespace}/taxels"));
            assert_eq!(sent_as(claims.claim("palm", &first, A, now)), "palm");
            assert_eq!(sent_as(claims.claim("palm", &format!("{}/contacts", order[0]), A, now)), "palm");
            let Verdict::Moved { name, from, to, warning } = claims.claim("palm", &second, B, now) else {
                panic!("not distinguished");
            };
            let called =
                |namespace: &str| format!("{}_palm", namespace.trim_start_matches('/').replace('/', "_"));
            assert_eq!((name, from.as_str()), (called(order[1]), "palm"));
            assert_eq!(to[&first], called(order[0]));
            assert_eq!(to.len(), 2, "contacts move, too");
            if order[0].ends_with("left") {
                insta::assert_snapshot!(warning, @"/gripper/left/taxels and /gripper/right/taxels both name their skin `palm`: from now on they are `gripper_left_palm` and `gripper_right_palm`, and `palm` has no keys; give each node an `instance` of its own");
            }
            for namespace in order {
                let topic = format!("{namespace}/contacts");
                assert_eq!(sent_as(claims.claim("palm", &topic, None, now)), called(namespace));
            }
            // It is free again once both are gone.
            for namespace in order {
                claims.release(&format!("{namespace}/taxels"));
                claims.release(&format!("{namespace}/contacts"));
            }
            assert_eq!(sent_as(claims.claim("palm", &first, A, now)), "palm");
        }
    }

    #[test]
    fn a_name_that_telling_apart_would_make_twice_is_refused() {
        let (mut claims, now) = (Claims::default(), Instant::now());
        assert_eq!(sent_as(claims.claim("left_palm", "/other/taxels", A, now)), "left_palm");
        assert_eq!(sent_as(claims.claim("palm", "/right/taxels", A, now)), "palm");
        let Verdict::Refused(Some(warning)) = claims.claim("palm", "/left/taxels", B, now) else {
            panic!("not refused")
        };
        insta::assert_snapshot!(warning, @"/left/taxels is not bridged: `left_palm` is the skin of /other/taxels already; give its node an `instance` of its own");
        assert_eq!(claims.claim("palm", "/left/taxels", B, now), Verdict::Refused(None), "said once");
    }

    #[test]
    fn a_node_that_was_started_again_goes_on_and_a_second_one_is_refused() {
        let (mut claims, now) = (Claims::default(), Instant::now());
        let at = |ms: u64| now + Duration::from_millis(ms);
        assert_eq!(sent_as(claims.claim("palm", "/taxels", A, at(0))), "palm");
        assert_eq!(sent_as(claims.claim("palm", "/taxels", B, at(800))), "palm", "the first one was silent");
        let Verdict::Refused(Some(warning)) = claims.claim("palm", "/taxels", A, at(810)) else {
            panic!("mixed")
        };
        insta::assert_snapshot!(warning, @"two publishers on /taxels both name their skin `palm`: only the first one is bridged; end one of the nodes, or give each an `instance` of its own");
        assert_eq!(sent_as(claims.claim("palm", "/taxels", B, at(820))), "palm");
        assert_eq!(claims.claim("palm", "/taxels", A, at(2000)), Verdict::Refused(None), "late is not gone");
        assert_eq!(sent_as(claims.claim("palm", "/taxels", A, at(11_000))), "palm");
    }

    #[test]
    fn two_like_skins_in_one_frame_are_reported() {
        let mut claims = Claims::default();
        assert_eq!(claims.place("left", "palm_link", "sha256:a"), None);
        assert_eq!(claims.place("cuff", "palm_link", "sha256:b"), None, "another type may share a link");
        insta::assert_snapshot!(claims.place("right", "palm_link", "sha256:a").unwrap(), @"skins `left` and `right` are of one type and both in the coordinate frame `palm_link`: their contacts lie on top of each other; give each node a `frame_id` of its own");
        assert_eq!(claims.place("right", "palm_link", "sha256:a"), None, "said once");
        assert_eq!(claims.place("right", "right_link", "sha256:a"), None);
    }
}
