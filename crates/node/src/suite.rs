//! The behaviour that every backend must show, as tests.
//!
//! [`behaviour_suite!`](crate::behaviour_suite) makes one `#[test]` of each function here. Nodes of one
//! test share a namespace and a domain that other processes are unlikely to use; nothing leaves the
//! machine.
#![expect(clippy::unwrap_used, clippy::missing_panics_doc, reason = "these functions are tests")]

use std::fmt::Debug;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU32, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

use dermis_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use dermis_msgs::lifecycle_msgs::msg::{Transition as TransitionMsg, TransitionEvent};
use dermis_msgs::lifecycle_msgs::srv as lifecycle_srv;
use dermis_msgs::rcl_interfaces::msg::{Log, Parameter, ParameterEvent};
use dermis_msgs::rcl_interfaces::srv as parameter_srv;
use dermis_msgs::rosgraph_msgs::msg::Clock;
use dermis_msgs::sensor_msgs::msg::PointCloud2;
use dermis_msgs::std_msgs::msg::{Int32, String as Text};
use dermis_msgs::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse};
use dermis_msgs::{Message, TypeSupport};

use crate::backend::EndpointKind;
use crate::executor::lock;
use crate::{
    Backend, ClockJump, Level, LogLevel, Node, NodeError, NodeOptions, ParameterDescriptor, ParameterValue,
    ProblemKind, Qos, State, Status, Transition,
};

/// How long a condition may take: discovery of DDS alone takes up to 4 s on a busy machine.
pub const WAIT: Duration = Duration::from_secs(30);

/// Makes a test of each behaviour; `$backend` is evaluated for each and gives an `Arc<dyn Backend>`.
#[macro_export]
macro_rules! behaviour_suite {
    ($backend:expr) => {
        $crate::behaviour_suite!(@ $backend;
            messages_pass_both_ways
            messages_keep_their_order
            messages_of_many_sizes_pass
            encoded_bytes_pass_unchanged
            bytes_that_do_not_decode_are_counted
            subscribers_are_counted
            a_late_joiner_gets_what_is_latched
            a_publisher_that_comes_back_is_heard
            a_qos_mismatch_is_reported
            another_type_on_a_topic_is_reported
            two_nodes_of_one_name_are_reported
            names_are_remapped
            a_service_answers
            calls_at_the_same_time_get_their_own_answers
            a_call_without_answer_times_out
            parameters_are_reached_by_services
            parameter_events_are_published
            lifecycle_is_driven_by_services
            time_follows_clock
            diagnostics_are_published
            log_lines_reach_rosout
            timers_tick
            a_panic_in_a_callback_is_survived
            a_slow_callback_gets_the_newest
            what_was_lost_is_zero_or_unknown
            a_finished_subscription_has_handed_on_what_arrived
            shutdown_withdraws_everything
            a_managed_node_is_finalized_at_shutdown
            the_api_works_in_a_single_threaded_runtime
        );
    };
    (@ $backend:expr; $($name:ident)*) => {$(
        #[test]
        fn $name() {
            $crate::suite::$name(&*$backend);
        }
    )*};
}

/// The domain of this process. One for all tests, because a process of rcl is in one domain.
#[must_use]
pub fn domain() -> u16 {
    static DOMAIN: OnceLock<u16> = OnceLock::new();
    // Domains above 101 take ports of the ephemeral range with DDS.
    *DOMAIN.get_or_init(|| u16::try_from(1 + std::process::id() % 100).unwrap_or(1))
}

/// Waits until `condition` holds; fails with `what` after [`WAIT`].
pub fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let deadline = Instant::now() + WAIT;
    while !condition() {
        assert!(Instant::now() < deadline, "waited {WAIT:?} in vain: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// A namespace of its own for one test.
pub struct Bench<'a> {
    backend: &'a dyn Backend,
    namespace: String,
}

impl<'a> Bench<'a> {
    /// A fresh namespace.
    #[must_use]
    pub fn new(backend: &'a dyn Backend) -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        Self { backend, namespace: format!("/t{}_{number}", std::process::id()) }
    }

    /// Options of a node on this machine only.
    #[must_use]
    pub fn options(&self, name: &str) -> NodeOptions {
        NodeOptions::new(name).namespace(&self.namespace).domain_id(domain()).localhost_only(true)
    }

    /// Opens a node of this name.
    #[must_use]
    pub fn node(&self, name: &str) -> Node {
        self.open(self.options(name))
    }

    /// Opens a node with these options.
    #[must_use]
    pub fn open(&self, options: NodeOptions) -> Node {
        Node::open(options, self.backend).unwrap()
    }
}

fn next<T>(rx: &Receiver<T>, what: &str) -> T {
    rx.recv_timeout(WAIT).unwrap_or_else(|_| panic!("waited {WAIT:?} in vain: {what}"))
}

/// A test that got what it wanted hangs up.
fn send<T>(tx: &Sender<T>, value: T) {
    let _ = tx.send(value);
}

fn number(data: i32) -> Int32 {
    Int32 { data }
}

fn into<T: Send + 'static, I>(tx: Sender<T>) -> impl FnMut(T, I) + Send + 'static {
    move |message, _| send(&tx, message)
}

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

fn on_off(answer: &str) -> impl FnMut(SetBoolRequest) -> SetBoolResponse + Send + 'static {
    let answer = answer.to_owned();
    move |request| SetBoolResponse { success: request.data, message: answer.clone() }
}

/// A service answers, also from within a callback of another node.
pub fn a_service_answers(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let server = a.serve::<SetBool>("~/set_enabled", on_off("done")).unwrap();
    assert_eq!(server.name(), format!("{}/set_enabled", a.full_name()));
    let client = b.client::<SetBool>("a/set_enabled").unwrap();
    for data in [true, false] {
        let response = client.call_blocking(&SetBoolRequest { data }, WAIT).unwrap();
        assert_eq!(response, SetBoolResponse { success: data, message: "done".to_owned() });
    }
    assert!(client.available());
    let (tx, rx) = channel();
    let timer = b.timer(Duration::from_millis(20), move || {
        send(&tx, client.call_blocking(&SetBoolRequest { data: true }, WAIT).is_ok());
    });
    assert!(next(&rx, "the call from a callback"));
    drop(timer);
}

/// Calls of several clients at once do not mix.
pub fn calls_at_the_same_time_get_their_own_answers(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let _one = a.serve::<SetBool>("one", on_off("one")).unwrap();
    let _two = a.serve::<SetBool>("two", on_off("two")).unwrap();
    std::thread::scope(|scope| {
        for i in 0..8 {
            let name = if i % 2 == 0 { "one" } else { "two" };
            let client = b.client::<SetBool>(name).unwrap();
            scope.spawn(move || {
                for call in 0..5 {
                    let data = (i + call) % 3 == 0;
                    let response = client.call_blocking(&SetBoolRequest { data }, WAIT).unwrap();
                    assert_eq!((response.success, response.message.as_str()), (data, name));
                }
            });
        }
    });
}

/// Neither a missing nor a busy server holds the caller longer than it requested.
pub fn a_call_without_answer_times_out(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let client = b.client::<SetBool>("nobody").unwrap();
    let error = client.call_blocking(&SetBoolRequest { data: true }, Duration::from_millis(50));
    let error = error.unwrap_err().to_string();
    assert!(error.contains("no server of that name and type was seen"), "{error}");

    let (go, gate) = channel::<()>();
    let _busy = a
        .serve::<SetBool>("busy", move |_| {
            // Ends with the test at the latest.
            let _ = gate.recv_timeout(WAIT);
            SetBoolResponse::default()
        })
        .unwrap();
    let client = b.client::<SetBool>("busy").unwrap();
    until("the server is seen", || client.available());
    let started = Instant::now();
    let error = client.call_blocking(&SetBoolRequest { data: true }, Duration::from_millis(200));
    assert!(error.unwrap_err().to_string().contains("did not answer"));
    assert!(started.elapsed() < Duration::from_secs(5));
    drop(go);
}

/// The six standard services read, describe, list and set parameters, and refuse with the reason.
pub fn parameters_are_reached_by_services(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let a = bench.open(bench.options("a").parameter("rate", 50.0));
    let b = bench.node("b");
    let limits = ParameterDescriptor::new("frames per second (Hz)").float_range(1.0, 1000.0);
    a.parameters().declare("rate", 100.0, limits).unwrap();
    let fixed = ParameterDescriptor::new("description file").read_only();
    a.parameters().declare("skin", "palm.toml", fixed).unwrap();
    let names = vec!["rate".to_owned(), "skin".to_owned(), "unknown".to_owned()];

    let get = b.client::<parameter_srv::GetParameters>("a/get_parameters").unwrap();
    let request = parameter_srv::GetParametersRequest { names: names.clone() };
    let values = get.call_blocking(&request, WAIT).unwrap().values;
    let values: Vec<_> = values.into_iter().filter_map(ParameterValue::from_msg).collect();
    assert_eq!(values, [50.0.into(), "palm.toml".into(), ParameterValue::NotSet]);

    let types = b.client::<parameter_srv::GetParameterTypes>("a/get_parameter_types").unwrap();
    let request = parameter_srv::GetParameterTypesRequest { names: names.clone() };
    assert_eq!(types.call_blocking(&request, WAIT).unwrap().types, [3, 4, 0]);

    let describe = b.client::<parameter_srv::DescribeParameters>("a/describe_parameters").unwrap();
    let request = parameter_srv::DescribeParametersRequest { names };
    let described = describe.call_blocking(&request, WAIT).unwrap().descriptors;
    assert_eq!(described[0].description, "frames per second (Hz)");
    assert_eq!(described[0].floating_point_range[0].to_value.to_bits(), 1000f64.to_bits());
    assert!(described[1].read_only);

    let list = b.client::<parameter_srv::ListParameters>("a/list_parameters").unwrap();
    let request = parameter_srv::ListParametersRequest::default();
    let listed = list.call_blocking(&request, WAIT).unwrap().result.names;
    assert_eq!(listed, ["rate", "skin", "use_sim_time"]);

    let set = b.client::<parameter_srv::SetParameters>("a/set_parameters").unwrap();
    let parameter =
        |name: &str, value: ParameterValue| Parameter { name: name.to_owned(), value: value.to_msg() };
    let parameters = vec![
        parameter("rate", 60.0.into()),
        parameter("rate", 0.0.into()),
        parameter("skin", "other.toml".into()),
        parameter("unknown", true.into()),
    ];
    let request = parameter_srv::SetParametersRequest { parameters };
    let results = set.call_blocking(&request, WAIT).unwrap().results;
    let successes: Vec<_> = results.iter().map(|result| result.successful).collect();
    assert_eq!(successes, [true, false, false, false]);
    assert!(results[1].reason.contains("0.0 is outside of 1.0 to 1000.0"), "{}", results[1].reason);
    assert!(results[2].reason.contains("read-only"), "{}", results[2].reason);
    assert_eq!(a.parameters().get("rate"), Some(60.0.into()));

    let atomically =
        b.client::<parameter_srv::SetParametersAtomically>("a/set_parameters_atomically").unwrap();
    let parameters = vec![parameter("rate", 70.0.into()), parameter("skin", "other.toml".into())];
    let request = parameter_srv::SetParametersAtomicallyRequest { parameters };
    assert!(!atomically.call_blocking(&request, WAIT).unwrap().result.successful);
    assert_eq!(a.parameters().get("rate"), Some(60.0.into()));
}

/// Changes are published on `/parameter_events`.
pub fn parameter_events_are_published(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    a.parameters().declare("gain", 1.0, ParameterDescriptor::new("no unit")).unwrap();
    let (tx, rx) = channel();
    let _sub = b.subscribe::<ParameterEvent>("/parameter_events", Qos::parameter_events(), into(tx)).unwrap();
    let deadline = Instant::now() + WAIT;
    let mut gain = 1.0;
    let event = loop {
        assert!(Instant::now() < deadline, "no event came");
        gain += 1.0;
        a.parameters().set("gain", gain).unwrap();
        let own =
            |event: &ParameterEvent| event.node == a.full_name() && !event.changed_parameters.is_empty();
        if let Some(event) = rx.recv_timeout(Duration::from_millis(100)).ok().filter(own) {
            break event;
        }
    };
    assert_eq!(event.changed_parameters[0].name, "gain");
    assert!(event.changed_parameters[0].value.double_value > 1.0);
    assert!(event.stamp.sec > 0);
}

/// Standard lifecycle services drive the node, and each step is published.
pub fn lifecycle_is_driven_by_services(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let life = a.lifecycle().unwrap();
    let ready = Arc::new(AtomicBool::new(false));
    let model = Arc::clone(&ready);
    life.on(Transition::Configure, move |_| {
        if model.load(Ordering::SeqCst) { Ok(()) } else { Err("no model".to_owned()) }
    });
    let (tx, events) = channel();
    let _sub = b.subscribe::<TransitionEvent>("a/transition_event", Qos::reliable(10), into(tx)).unwrap();
    let change = b.client::<lifecycle_srv::ChangeState>("a/change_state").unwrap();
    let get = b.client::<lifecycle_srv::GetState>("a/get_state").unwrap();
    let step = |id: u8| {
        let transition = TransitionMsg { id, label: String::new() };
        let request = lifecycle_srv::ChangeStateRequest { transition };
        change.call_blocking(&request, WAIT).unwrap().success
    };
    let state = || {
        let request = lifecycle_srv::GetStateRequest::default();
        get.call_blocking(&request, WAIT).unwrap().current_state.label
    };
    assert_eq!(state(), "unconfigured");
    assert!(!step(TransitionMsg::TRANSITION_ACTIVATE), "not from here");
    assert!(!step(TransitionMsg::TRANSITION_CONFIGURE), "no model");
    assert_eq!(state(), "unconfigured");
    ready.store(true, Ordering::SeqCst);
    assert!(step(TransitionMsg::TRANSITION_CONFIGURE));
    assert_eq!(state(), "inactive");
    // An event before the subscription is matched is lost.
    let mut reached = None;
    until("the event of activation", || {
        assert!(step(TransitionMsg::TRANSITION_ACTIVATE));
        assert_eq!(life.state(), State::Active);
        reached = events.try_iter().find(|event| event.goal_state.label == "active");
        reached.is_some() || !step(TransitionMsg::TRANSITION_DEACTIVATE)
    });
    let reached: TransitionEvent = reached.unwrap();
    assert_eq!(reached.start_state.label, "activating");

    let available =
        b.client::<lifecycle_srv::GetAvailableTransitions>("a/get_available_transitions").unwrap();
    let request = lifecycle_srv::GetAvailableTransitionsRequest::default();
    let list = available.call_blocking(&request, WAIT).unwrap().available_transitions;
    let labels: Vec<_> = list.iter().map(|one| one.transition.label.as_str()).collect();
    assert_eq!(labels, ["deactivate", "shutdown"]);
    let states = b.client::<lifecycle_srv::GetAvailableStates>("a/get_available_states").unwrap();
    let request = lifecycle_srv::GetAvailableStatesRequest::default();
    assert_eq!(states.call_blocking(&request, WAIT).unwrap().available_states.len(), 10);
    assert!(step(TransitionMsg::TRANSITION_ACTIVE_SHUTDOWN));
    assert_eq!(life.state(), State::Finalized);
}

/// A node with `use_sim_time` follows `/clock`, also back, and stops when the parameter is cleared.
pub fn time_follows_clock(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    // `/clock` is one for all of a domain: a topic of its own keeps other tests out.
    let own = |name: &str| bench.options(name).remap("/clock", "clock");
    let simulator = bench.open(own("simulator"));
    let a = bench.open(own("a").use_sim_time(true));
    assert!(a.clock().is_simulated());
    assert_eq!(a.clock().now(), 0);
    let publisher = simulator.publisher::<Clock>("/clock", Qos::clock()).unwrap();
    until("matched", || publisher.subscriber_count() == 1);
    let set = |ns: i64| {
        let clock = dermis_msgs::builtin_interfaces::msg::Time::from_nanos(ns);
        publisher.publish(&Clock { clock }).unwrap();
    };
    until("the first time", || {
        set(12_000_000_005);
        a.clock().now() == 12_000_000_005
    });
    let from = Arc::new(AtomicI64::new(0));
    let seen = Arc::clone(&from);
    a.clock().on_jump_back(move |jump: ClockJump| seen.store(jump.from_ns, Ordering::SeqCst));
    until("the time after the jump", || {
        set(3_000_000_000);
        a.clock().now() == 3_000_000_000
    });
    until("the jump is reported", || from.load(Ordering::SeqCst) == 12_000_000_005);
    assert_eq!(a.clock().jumps().0, 1);
    a.parameters().set("use_sim_time", false).unwrap();
    assert!(!a.clock().is_simulated());
    assert!(a.clock().now() > 1_700_000_000_000_000_000, "the time of the system");
}

/// Sources come out on `/diagnostics` once a second.
pub fn diagnostics_are_published(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    a.diagnostics().set_hardware_id("BD-0042");
    let calls = Arc::new(AtomicUsize::new(0));
    let count = Arc::clone(&calls);
    a.diagnostics().add("transport", move || {
        count.fetch_add(1, Ordering::SeqCst);
        let mut status = Status::ok("streaming");
        status.worsen(Level::Warn, "3 frames lost");
        status.value("rate (Hz)", 100);
        status
    });
    let (tx, rx) = channel();
    let _sub = b.subscribe::<DiagnosticArray>("/diagnostics", Qos::reliable(10), into(tx)).unwrap();
    let name = format!("{}: transport", a.full_name().trim_start_matches('/'));
    let status: DiagnosticStatus = loop {
        let array: DiagnosticArray = next(&rx, "diagnostics");
        if let Some(status) = array.status.into_iter().find(|status| status.name == name) {
            break status;
        }
    };
    assert_eq!(status.level, DiagnosticStatus::WARN);
    assert_eq!(status.message, "3 frames lost");
    assert_eq!(status.hardware_id, "BD-0042");
    assert_eq!((status.values[0].key.as_str(), status.values[0].value.as_str()), ("rate (Hz)", "100"));
    assert!(calls.load(Ordering::SeqCst) > 0);
}

/// Lines of the log reach those who listen to `/rosout`, latecomers too.
pub fn log_lines_reach_rosout(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let a = bench.node("a");
    a.log(LogLevel::Warn, "channel b3 is saturated");
    let b = bench.node("b");
    let (tx, rx) = channel();
    let _sub = b.subscribe::<Log>("/rosout", Qos::latched().with_depth(100), into(tx)).unwrap();
    let line = loop {
        let line: Log = next(&rx, "the line");
        if line.msg == "channel b3 is saturated" {
            break line;
        }
    };
    assert_eq!(line.level, Log::WARN);
    assert_eq!(line.name, a.full_name().trim_start_matches('/').replace('/', "."));
}

/// Timers tick at their period until they are dropped.
pub fn timers_tick(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let a = bench.node("a");
    let (tx, rx) = channel();
    let started = Instant::now();
    let timer = a.timer(Duration::from_millis(20), move || send(&tx, ()));
    for _ in 0..10 {
        next(&rx, "a tick");
    }
    assert!(started.elapsed() >= Duration::from_millis(190), "ten periods of 20 ms");
    drop(timer);
    while rx.try_recv().is_ok() {}
    assert!(rx.recv().is_err(), "the callback is gone with the timer");
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

/// After shutdown no callback runs, nothing is sent, and within 5 s nobody sees the node any more.
pub fn shutdown_withdraws_everything(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let (a, b) = (bench.node("a"), bench.node("b"));
    let count = Arc::new(AtomicUsize::new(0));
    let seen = Arc::clone(&count);
    let sub = a
        .subscribe("numbers", Qos::reliable(10), move |_: Int32, _| {
            seen.fetch_add(1, Ordering::SeqCst);
        })
        .unwrap();
    let own = a.publisher::<Int32>("others", Qos::reliable(10)).unwrap();
    let server = a.serve::<SetBool>("switch", on_off("done")).unwrap();
    let publisher = b.publisher::<Int32>("numbers", Qos::reliable(10)).unwrap();
    let client = b.client::<SetBool>("switch").unwrap();
    until("all is seen", || {
        publisher.subscriber_count() == 1
            && client.available()
            && b.node_names().unwrap().contains(&a.full_name())
            && !b.endpoints("others", EndpointKind::Publisher).unwrap().is_empty()
    });
    until("a message arrives", || {
        publisher.publish(&number(0)).unwrap();
        count.load(Ordering::SeqCst) > 0
    });
    a.shutdown();
    let at_shutdown = count.load(Ordering::SeqCst);
    let started = Instant::now();
    assert!(a.is_shut_down());
    assert!(matches!(own.publish(&number(1)), Err(NodeError::ShutDown { .. })));
    assert!(matches!(a.publisher::<Int32>("x", Qos::latched()), Err(NodeError::ShutDown { .. })));
    until("nothing is seen any more", || {
        publisher.publish(&number(1)).unwrap();
        publisher.subscriber_count() == 0
            && !client.available()
            && !b.node_names().unwrap().contains(&a.full_name())
            && b.endpoints("others", EndpointKind::Publisher).unwrap().is_empty()
    });
    assert!(started.elapsed() < Duration::from_secs(5), "gone after {:?}", started.elapsed());
    assert_eq!(count.load(Ordering::SeqCst), at_shutdown, "no callback after shutdown");
    a.shutdown();
    drop((sub, server));
}

/// Shutdown takes a managed node to its end, with its callbacks.
pub fn a_managed_node_is_finalized_at_shutdown(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let a = bench.node("a");
    let life = a.lifecycle().unwrap();
    let (tx, rx) = channel();
    life.on(Transition::Shutdown, move |from| {
        send(&tx, from);
        Ok(())
    });
    life.take(Transition::Configure).unwrap();
    drop(a);
    assert_eq!(rx.try_recv(), Ok(State::Inactive));
    assert_eq!(life.state(), State::Finalized);
}

/// Opening, calling and waiting for the end work in async code on one thread.
pub fn the_api_works_in_a_single_threaded_runtime(backend: &dyn Backend) {
    let bench = Bench::new(backend);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let (a, b) = (bench.node("a"), bench.node("b"));
        let _server = a.serve::<SetBool>("switch", on_off("done")).unwrap();
        let client = b.client::<SetBool>("switch").unwrap();
        assert!(client.call(&SetBoolRequest { data: true }, WAIT).await.unwrap().success);
        let ender = a.clone();
        let thread = std::thread::spawn(move || ender.shutdown());
        a.wait_for_shutdown().await.unwrap();
        thread.join().unwrap();
        assert!(a.is_shut_down());
        drop(b);
    });
}

/// For tests of one backend: the next message of a channel, or a failure that says `what` was missed.
pub fn expect_next<T: Debug>(rx: &Receiver<T>, what: &str) -> T {
    next(rx, what)
}
