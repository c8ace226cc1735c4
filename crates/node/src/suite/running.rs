//! What a node says of itself while it runs, and how it ends.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicUsize, Ordering};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use dermis_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use dermis_msgs::rcl_interfaces::msg::Log;
use dermis_msgs::rosgraph_msgs::msg::Clock;
use dermis_msgs::std_msgs::msg::Int32;
use dermis_msgs::std_srvs::srv::{SetBool, SetBoolRequest};

use super::services::on_off;
use super::{Bench, WAIT, into, next, number, send, until};
use crate::backend::EndpointKind;
use crate::{Backend, ClockJump, Level, LogLevel, NodeError, Qos, State, Status, Transition};

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
