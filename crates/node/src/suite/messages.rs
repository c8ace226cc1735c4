//! How messages pass between publishers and subscriptions.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use dermis_msgs::sensor_msgs::msg::PointCloud2;
use dermis_msgs::std_msgs::msg::{Int32, String as Text};
use dermis_msgs::{Message as _, TypeSupport};

use super::{Bench, WAIT, into, next, number, send, until};
use crate::executor::lock;
use crate::{Backend, Level, NodeError, ProblemKind, Qos};

/// Both directions between two nodes at the same time.
pub fn messages_pass_both_ways(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let (tx_a, at_a) = channel();
    let (tx_b, at_b) = channel();
    let _sub_a = a.subscribe::<Text>("to_a", Qos::reliable(10), into(tx_a)).unwrap();
    let _sub_b = b.subscribe::<Text>("to_b", Qos::sensor_data(), into(tx_b)).unwrap();
    let to_b = a.publisher::<Text>("to_b", Qos::sensor_data()).unwrap();
    let to_a = b.publisher::<Text>("to_a", Qos::reliable(10)).unwrap();
    until("both are matched", || to_a.subscriber_count() == 1 && to_b.subscriber_count() == 1);
    to_b.publish(&Text { data: "to b".to_owned() }).unwrap();
    to_a.publish(&Text { data: "grüße".to_owned() }).unwrap();
    assert_eq!(next(&at_b, "message at b").data, "to b");
    assert_eq!(next(&at_a, "message at a").data, "grüße");
}

/// Reliable messages come in order and none is lost.
pub fn messages_keep_their_order(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let (tx, rx) = channel();
    let _sub = b
        .subscribe::<Int32>("numbers", Qos::reliable(1000), move |message, info| {
            send(&tx, (message.data, info));
        })
        .unwrap();
    let publisher = a.publisher::<Int32>("numbers", Qos::reliable(1000)).unwrap();
    until("matched", || publisher.subscriber_count() == 1);
    for i in 0..500 {
        publisher.publish(&number(i)).unwrap();
    }
    assert_eq!(publisher.published(), 500);
    for i in 0..500 {
        let (data, info) = next(&rx, "the next number");
        assert_eq!(data, i);
        if let Some(source_ns) = info.source_ns {
            assert!(source_ns <= info.received_ns, "sent before received on one clock");
        }
    }
}

/// From nothing to a megabyte, also sizes that are no multiple of four.
pub fn messages_of_many_sizes_pass(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let (tx, rx) = channel();
    let _sub = b.subscribe::<PointCloud2>("cloud", Qos::reliable(10), into(tx)).unwrap();
    let publisher = a.publisher::<PointCloud2>("cloud", Qos::reliable(10)).unwrap();
    until("matched", || publisher.subscriber_count() == 1);
    for size in [0, 1, 2, 3, 4, 5, 7, 100, 1_000, 1_399, 1_400, 65_535, 65_536, 65_537, 1_000_000] {
        #[expect(clippy::cast_possible_truncation, reason = "a pattern of bytes")]
        let data: Vec<u8> = (0..size).map(|i: u32| (i * 31 + size) as u8).collect();
        let message = PointCloud2 { width: size, data, ..PointCloud2::default() };
        publisher.publish(&message).unwrap();
        let got = next(&rx, "the cloud");
        assert!(got == message, "{size} bytes arrive as they were sent");
    }
}

/// What is published encoded arrives byte for byte.
pub fn encoded_bytes_pass_unchanged(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let text = TypeSupport::of::<Text>();
    let (tx, rx) = channel();
    let _sub =
        b.subscribe_raw("raw", text, Qos::reliable(10), move |bytes, _| send(&tx, bytes.to_vec())).unwrap();
    let publisher = a.publisher_raw("raw", text, Qos::reliable(10)).unwrap();
    until("matched", || publisher.subscriber_count() == 1);
    let bytes = Text { data: "as they are".to_owned() }.to_cdr();
    publisher.publish_cdr(&bytes).unwrap();
    assert_eq!(next(&rx, "the bytes"), bytes);
}

/// Bytes that are no message of the type are counted, and the next message arrives.
pub fn bytes_that_do_not_decode_are_counted(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let (tx, rx) = channel();
    let sub = b.subscribe::<Text>("text", Qos::reliable(10), into(tx)).unwrap();
    let publisher = a.publisher::<Text>("text", Qos::reliable(10)).unwrap();
    until("matched", || publisher.subscriber_count() == 1);
    // A string of 1000 bytes, of which 2 are there. A backend that checks itself may refuse to send it.
    let sent = publisher.publish_cdr(&[0, 1, 0, 0, 0xe8, 3, 0, 0, b'h', b'i']).is_ok();
    publisher.publish(&Text { data: "whole".to_owned() }).unwrap();
    assert_eq!(next(&rx, "the whole message").data, "whole");
    assert!(sub.rejected() <= u64::from(sent));
    if backend.name() == "hiroz" {
        assert_eq!(sub.rejected(), 1);
    }
}

/// The number of subscribers follows them as they come and go.
pub fn subscribers_are_counted(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let publisher = a.publisher::<Int32>("numbers", Qos::sensor_data()).unwrap();
    assert_eq!(publisher.subscriber_count(), 0);
    let first = b.subscribe("numbers", Qos::sensor_data(), |_: Int32, _| {}).unwrap();
    until("one", || publisher.subscriber_count() == 1);
    let second = a.subscribe("numbers", Qos::sensor_data(), |_: Int32, _| {}).unwrap();
    until("two", || publisher.subscriber_count() == 2);
    drop(second);
    b.shutdown();
    until("none", || {
        // A backend may notice only with the next message that a subscription of its own was dropped.
        publisher.publish(&number(0)).unwrap();
        publisher.subscriber_count() == 0
    });
    drop(first);
}

/// A subscription that comes after the message gets it all the same.
pub fn a_late_joiner_gets_what_is_latched(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let a = bench.node("a");
    let publisher = a.publisher::<Text>("geometry", Qos::latched()).unwrap();
    publisher.publish(&Text { data: "old".to_owned() }).unwrap();
    publisher.publish(&Text { data: "current".to_owned() }).unwrap();
    let b = bench.node("b");
    let (tx, rx) = channel();
    let _sub = b.subscribe::<Text>("geometry", Qos::latched(), into(tx)).unwrap();
    assert_eq!(next(&rx, "the latched message").data, "current");
    publisher.publish(&Text { data: "next".to_owned() }).unwrap();
    assert_eq!(next(&rx, "the message after it").data, "next");
}

/// A node that is stopped and started again is heard by those that stayed.
pub fn a_publisher_that_comes_back_is_heard(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let listener = bench.node("listener");
    let (tx, rx) = channel();
    let _sub = listener.subscribe::<Text>("words", Qos::latched(), into(tx)).unwrap();
    for life in 0..3 {
        let talker = bench.node("talker");
        let publisher = talker.publisher::<Text>("words", Qos::latched()).unwrap();
        publisher.publish(&Text { data: format!("life {life}") }).unwrap();
        assert_eq!(next(&rx, "a word of the restarted node").data, format!("life {life}"));
        if life % 2 == 0 {
            talker.shutdown();
        }
    }
}

/// A subscription that asks for more than a publisher offers is reported with topic and policies.
pub fn a_qos_mismatch_is_reported(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let (tx, rx) = channel();
    b.on_problem(move |problem| send(&tx, problem.clone()));
    let fits = b.subscribe("fits", Qos::sensor_data(), |_: Int32, _| {}).unwrap();
    let _reliable = a.publisher::<Int32>("fits", Qos::reliable(5)).unwrap();
    let sub = b.subscribe("stream", Qos::reliable(5), |_: Int32, _| {}).unwrap();
    let _publisher = a.publisher::<Int32>("stream", Qos::sensor_data()).unwrap();
    let problem = next(&rx, "the report");
    assert_eq!(problem.kind, ProblemKind::QosMismatch);
    assert_eq!(problem.name, sub.topic());
    for part in [sub.topic(), &a.full_name(), "best effort", "reliable"] {
        assert!(problem.sentence.contains(part), "{part} in {}", problem.sentence);
    }
    assert!(b.problems().iter().all(|problem| problem.name != fits.topic()));
    let status = b.diagnostics().collect();
    let (_, graph) = status.iter().find(|(name, _)| name == "ROS graph").unwrap();
    assert_eq!(graph.level, Level::Warn);
    assert!(graph.message.contains(sub.topic()));
}

/// Another type on the same topic is reported by name.
pub fn another_type_on_a_topic_is_reported(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let (tx, rx) = channel();
    b.on_problem(move |problem| send(&tx, problem.clone()));
    let _sub = b.subscribe("data", Qos::reliable(5), |_: Int32, _| {}).unwrap();
    let publisher = a.publisher::<Text>("data", Qos::reliable(5));
    if let Err(refused) = &publisher {
        // DDS has one type for each topic of a process.
        let sentence = refused.to_string();
        for part in ["/data", "std_msgs/msg/String", "std_msgs/msg/Int32"] {
            assert!(sentence.contains(part), "{part} in {sentence}");
        }
        assert_eq!(backend.name(), "r2r");
        return;
    }
    let problem = next(&rx, "the report");
    assert_eq!(problem.kind, ProblemKind::TypeMismatch);
    for part in ["/data", "std_msgs/msg/String", "std_msgs/msg/Int32", &a.full_name()] {
        assert!(problem.sentence.contains(part), "{part} in {}", problem.sentence);
    }
}

/// Two nodes of one name report each other, and the report ends with one of them.
pub fn two_nodes_of_one_name_are_reported(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let first = bench.node("twin");
    let (tx, rx) = channel();
    first.on_problem(move |problem| send(&tx, problem.clone()));
    let second = bench.node("twin");
    let problem = next(&rx, "the report of the first");
    assert_eq!(problem.kind, ProblemKind::DuplicateNode);
    assert!(problem.sentence.contains(&first.full_name()), "{}", problem.sentence);
    until("the report of the second", || {
        second.problems().iter().any(|problem| problem.kind == ProblemKind::DuplicateNode)
    });
    second.shutdown();
    until("the end of the report", || first.problems().is_empty());
}

/// Remapped topics are what others see.
pub fn names_are_remapped(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let renamed = bench.options("a").remap("words", "~/speech").remap("__node", "speaker");
    let (a, b) = (bench.open(renamed), bench.node("b"));
    assert!(a.full_name().ends_with("/speaker"));
    let (tx, rx) = channel();
    let _sub = b.subscribe::<Text>("speaker/speech", Qos::reliable(10), into(tx)).unwrap();
    let publisher = a.publisher::<Text>("words", Qos::reliable(10)).unwrap();
    assert_eq!(publisher.topic(), format!("{}/speech", a.full_name()));
    until("matched", || publisher.subscriber_count() == 1);
    publisher.publish(&Text { data: "hello".to_owned() }).unwrap();
    assert_eq!(next(&rx, "the word").data, "hello");
    assert!(matches!(a.publisher::<Text>("a b", Qos::latched()), Err(NodeError::Name { .. })));
    until("both nodes are seen", || {
        let names = b.node_names().unwrap();
        names.contains(&a.full_name()) && names.contains(&b.full_name())
    });
}

/// A panic in one callback loses one message; the node and the subscription go on.
pub fn a_panic_in_a_callback_is_survived(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let (tx, rx) = channel();
    let _sub = b
        .subscribe("numbers", Qos::reliable(10), move |message: Int32, _| {
            assert!(message.data != 1, "the panic of this test");
            send(&tx, message.data);
        })
        .unwrap();
    let publisher = a.publisher::<Int32>("numbers", Qos::reliable(10)).unwrap();
    until("matched", || publisher.subscriber_count() == 1);
    for i in 0..3 {
        publisher.publish(&number(i)).unwrap();
    }
    assert_eq!((next(&rx, "0"), next(&rx, "2")), (0, 2));
}

/// Where all arrives, nothing is reported as lost; where the wire does not tell, that is said and not 0.
pub fn what_was_lost_is_zero_or_unknown(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let publisher = a.publisher::<Int32>("numbers", Qos::reliable(1000)).unwrap();
    // What goes out before somebody listens is not lost.
    for i in 0..5 {
        publisher.publish(&number(i)).unwrap();
    }
    let (tx, rx) = channel();
    let sub = b.subscribe::<Int32>("numbers", Qos::reliable(1000), into(tx)).unwrap();
    let quiet = b.subscribe::<Int32>("silence", Qos::reliable(1000), |_, _| {}).unwrap();
    until("matched", || publisher.subscriber_count() == 1);
    assert_eq!(quiet.losses().known(), None, "nothing has come that would tell");
    for i in 5..100 {
        publisher.publish(&number(i)).unwrap();
    }
    // A subscription that opens while a message is on its way may hear that one, too.
    let first = next(&rx, "the first number").data;
    assert!((0..=5).contains(&first), "{first}");
    while next(&rx, "the last number").data != 99 {}
    let (losses, heard) = (sub.losses(), u64::try_from(100 - first).unwrap());
    if backend.name() == "r2r" {
        assert_eq!((losses.known(), losses.unnumbered), (None, heard));
    } else {
        assert_eq!((losses.known(), losses.numbered, losses.unnumbered), (Some(0), heard, 0));
    }
}

/// Ending a subscription in an orderly way loses nothing that had arrived, however slow its callback is.
pub fn a_finished_subscription_has_handed_on_what_arrived(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let count = Arc::new(AtomicUsize::new(0));
    let seen = Arc::clone(&count);
    let (go, gate) = channel::<()>();
    let sub = b
        .subscribe("numbers", Qos::reliable(1000), move |_: Int32, _| {
            if seen.fetch_add(1, Ordering::SeqCst) == 0 {
                let _ = gate.recv_timeout(WAIT);
            }
        })
        .unwrap();
    let publisher = a.publisher::<Int32>("numbers", Qos::reliable(1000)).unwrap();
    until("matched", || publisher.subscriber_count() == 1);
    for i in 0..200 {
        publisher.publish(&number(i)).unwrap();
    }
    until("all have arrived", || sub.losses().numbered + sub.losses().unnumbered == 200);
    assert!(count.load(Ordering::SeqCst) <= 1, "the callback is busy with the first");
    let ending = std::thread::spawn(move || sub.finish(WAIT));
    drop(go);
    assert_eq!(ending.join().unwrap(), crate::Unread::default());
    assert_eq!(count.load(Ordering::SeqCst), 200);
}

/// A callback that is too slow loses old messages, never new ones, and does not slow the publisher down.
pub fn a_slow_callback_gets_the_newest(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let (entered_tx, entered) = channel();
    let (go, gate) = channel::<()>();
    let seen: Arc<Mutex<Vec<i32>>> = Arc::default();
    let log = Arc::clone(&seen);
    let sub = b
        .subscribe("numbers", Qos::sensor_data(), move |message: Int32, _| {
            lock(&log).push(message.data);
            if lock(&log).len() == 1 {
                send(&entered_tx, ());
                let _ = gate.recv_timeout(WAIT);
            }
        })
        .unwrap();
    let publisher = a.publisher::<Int32>("numbers", Qos::sensor_data()).unwrap();
    until("matched", || publisher.subscriber_count() == 1);
    let mut sent = 0;
    until("the callback is busy", || {
        publisher.publish(&number(sent)).unwrap();
        sent += 1;
        entered.try_recv().is_ok()
    });
    let payload = number(0).to_cdr();
    let started = Instant::now();
    for _ in 0..200 {
        publisher.publish_cdr(&payload).unwrap();
    }
    assert!(started.elapsed() < Duration::from_secs(5), "a busy reader does not hold the writer up");
    // The newest is repeated, because best effort may lose it on the way.
    let newest = i32::MAX;
    until("messages were dropped", || {
        publisher.publish(&number(newest)).unwrap();
        sub.dropped() > 0
    });
    drop(go);
    until("the newest arrives", || {
        publisher.publish(&number(newest)).unwrap();
        lock(&seen).last() == Some(&newest)
    });
}
