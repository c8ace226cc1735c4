//! How a recording goes, and what it lacks.

use std::time::Duration;

use dermis_bag::RecorderState;

/// That a recording waits for room, or goes on.
#[must_use]
pub fn waiting(state: &RecorderState) -> String {
    match state.waits {
        Some(reason) => format!(
            "{reason}: recording waits for room; messages are kept in memory as far as --buffer allows, and counted beyond"
        ),
        None => format!(
            "there is room again, after {:.1} s in all: recording goes on, in a new file",
            state.paused_ms as f64 * 1e-3
        ),
    }
}

/// Where a recording is, in one line; `before` is how many bytes of messages there were at a time this long ago.
#[must_use]
pub fn line(state: &RecorderState, before: u64, since: Duration) -> String {
    let rate = (state.payload_bytes - before) as f64 / since.as_secs_f64() * 1e-6;
    format!(
        "{} messages on {} topics, {:.1} MB, {rate:.1} MB/s, {} lost on the way, {} dropped{}",
        state.messages,
        state.topics.len(),
        state.payload_bytes as f64 * 1e-6,
        state.lost.map_or_else(|| "not known how many".to_owned(), |lost| lost.to_string()),
        state.dropped,
        state.waits.map_or_else(String::new, |reason| format!("; waiting, because {reason}")),
    )
}

/// What is missing, a sentence for each topic and reason.
#[must_use]
pub fn losses(state: &RecorderState) -> Vec<String> {
    let mut sentences = Vec::new();
    for topic in &state.topics {
        let (name, lost) = (&topic.name, topic.lost.unwrap_or(0));
        let all = topic.recorded + topic.dropped + lost;
        if lost > 0 {
            sentences.push(format!(
                "{name}: {lost} of {all} messages were lost on the way, before they reached the recorder"
            ));
        }
        if topic.dropped > 0 {
            let dropped = topic.dropped;
            sentences.push(format!(
                "{name}: {dropped} of {all} messages were dropped, because they came faster than they were written or found no room: give --buffer more, or --compression less"
            ));
        }
        let beyond = topic.missing_frames.unwrap_or(0).saturating_sub(lost + topic.dropped);
        if beyond > 0 {
            sentences.push(format!(
                "{name}: {beyond} frames of the skin are missing that were not published as messages here"
            ));
        }
    }
    let unknown: Vec<_> = state.topics.iter().filter(|t| t.lost.is_none()).map(|t| t.name.as_str()).collect();
    if !unknown.is_empty() {
        sentences.push(format!(
            "whether messages were lost on the way is not known of {}: their publishers, or this ROS 2 implementation, do not number them",
            unknown.join(", ")
        ));
    }
    sentences
}

#[cfg(test)]
mod tests {
    use dermis_bag::TopicState;

    use super::*;

    #[test]
    fn what_is_missing_is_said_by_topic_and_reason() {
        let topic = |name: &str, dropped, lost, missing_frames| TopicState {
            name: name.into(),
            type_name: String::new(),
            recorded: 90,
            dropped,
            lost,
            missing_frames,
        };
        let topics = vec![
            topic("/a", 4, Some(6), Some(12)),
            topic("/b", 0, Some(0), None),
            topic("/c", 0, None, None),
        ];
        let said = losses(&RecorderState { topics, ..RecorderState::default() }).join("\n");
        insta::assert_snapshot!(said, @r"
        /a: 6 of 100 messages were lost on the way, before they reached the recorder
        /a: 4 of 100 messages were dropped, because they came faster than they were written or found no room: give --buffer more, or --compression less
        /a: 2 frames of the skin are missing that were not published as messages here
        whether messages were lost on the way is not known of /c: their publishers, or this ROS 2 implementation, do not number them
        ");
    }
}
