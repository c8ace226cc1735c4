//! How services, parameters and the lifecycle answer.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use dermis_msgs::lifecycle_msgs::msg::{Transition as TransitionMsg, TransitionEvent};
use dermis_msgs::lifecycle_msgs::srv as lifecycle_srv;
use dermis_msgs::rcl_interfaces::msg::{Parameter, ParameterEvent};
use dermis_msgs::rcl_interfaces::srv as parameter_srv;
use dermis_msgs::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse};

use super::{Bench, WAIT, into, next, send, until};
use crate::{Backend, ParameterDescriptor, ParameterValue, Qos, State, Transition};

pub(super) fn on_off(answer: &str) -> impl FnMut(SetBoolRequest) -> SetBoolResponse + Send + 'static {
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
