//! The behaviour that every backend must show, as tests.
//!
//! [`behaviour_suite!`](crate::behaviour_suite) makes one `#[test]` of each function here. Nodes of one
//! test share a namespace and a domain that other processes are unlikely to use; nothing leaves the
//! machine.
#![expect(clippy::unwrap_used, clippy::missing_panics_doc, reason = "these functions are tests")]

use std::fmt::Debug;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, Sender};
use std::time::{Duration, Instant};

use dermis_msgs::std_msgs::msg::Int32;

use crate::{Backend, Node, NodeOptions};

pub use messages::*;
pub use running::*;
pub use services::*;

mod messages;
mod running;
mod services;

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

/// Prints how long publishes took beside a subscriber that stopped reading, as `cargo xtask measure hanging` reads it, and returns what 99 %
/// of them and what all of them took at most.
pub fn report_waits(case: &str, mut waits: Vec<Duration>) -> (Duration, Duration) {
    waits.sort_unstable();
    let [half, most, worst] = [0.5, 0.99, 1.0].map(|q| waits[((waits.len() - 1) as f64 * q) as usize]);
    let ms = |wait: Duration| wait.as_secs_f64() * 1e3;
    let figures = serde_json::json!({
        "case": case, "publishes": waits.len(), "median_ms": ms(half), "p99_ms": ms(most), "longest_ms": ms(worst),
    });
    println!("figures: {figures}");
    (most, worst)
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

/// For tests of one backend: the next message of a channel, or a failure that says `what` was missed.
pub fn expect_next<T: Debug>(rx: &Receiver<T>, what: &str) -> T {
    next(rx, what)
}
