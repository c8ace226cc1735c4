use super::*;

fn lifecycle() -> Lifecycle {
    Lifecycle::new("/palm".to_owned(), Box::new(|| 0))
}

#[test]
fn the_way_through_all_states() {
    let life = lifecycle();
    for (transition, state) in [
        (Transition::Configure, State::Inactive),
        (Transition::Activate, State::Active),
        (Transition::Deactivate, State::Inactive),
        (Transition::Cleanup, State::Unconfigured),
        (Transition::Shutdown, State::Finalized),
    ] {
        assert_eq!(life.take(transition).unwrap(), state);
        assert_eq!(life.state(), state);
    }
    assert!(life.transitions(false).is_empty());
    assert_eq!(life.transitions(true).len(), 7);
}

#[test]
fn impossible_transitions_are_refused() {
    insta::assert_snapshot!(
        lifecycle().take(Transition::Activate).unwrap_err(),
        @"cannot activate node /palm in state unconfigured: possible are: configure, shutdown"
    );
}

#[test]
fn a_failing_callback_keeps_the_state_but_not_at_shutdown() {
    let life = lifecycle();
    life.on(Transition::Configure, |_| Err("the model file is missing".to_owned()));
    life.on(Transition::Shutdown, |_| panic!("the panic of this test"));
    insta::assert_snapshot!(
        life.take(Transition::Configure).unwrap_err(),
        @"cannot configure node /palm in state unconfigured: the model file is missing"
    );
    assert_eq!(life.state(), State::Unconfigured);
    assert!(life.take(Transition::Shutdown).is_err());
    assert_eq!(life.state(), State::Finalized);
}

#[test]
fn the_end_of_a_node_waits_for_the_transition_that_runs() {
    let life = lifecycle();
    let (entered_tx, entered) = std::sync::mpsc::channel();
    let (go, gate) = std::sync::mpsc::channel::<()>();
    life.on(Transition::Configure, move |_| {
        entered_tx.send(()).unwrap();
        gate.recv_timeout(Duration::from_secs(20)).map_err(|e| e.to_string())
    });
    let ended = Arc::new(Mutex::new(Vec::new()));
    let order = Arc::clone(&ended);
    life.on(Transition::Shutdown, move |from| {
        lock(&order).push(from);
        Ok(())
    });
    std::thread::scope(|scope| {
        scope.spawn(|| life.take(Transition::Configure).unwrap());
        entered.recv_timeout(Duration::from_secs(20)).unwrap();
        let end = scope.spawn(|| life.end());
        // What anybody else asks for meanwhile is refused, as before.
        insta::assert_snapshot!(
            life.take(Transition::Shutdown).unwrap_err(),
            @"cannot shutdown node /palm in state unconfigured: another transition is running"
        );
        go.send(()).unwrap();
        end.join().unwrap().unwrap();
    });
    assert_eq!((life.state(), lock(&ended).clone()), (State::Finalized, vec![State::Inactive]));
    life.end().unwrap();
    assert_eq!(lock(&ended).len(), 1, "an end that is reached is not taken again");
}

#[test]
fn a_callback_that_ends_the_node_does_not_wait_for_itself() {
    let life = lifecycle();
    let own = life.clone();
    life.on(Transition::Configure, move |_| own.end().map_err(|e| e.to_string()));
    assert_eq!(life.take(Transition::Configure).unwrap(), State::Finalized);
    assert_eq!(Arc::strong_count(&life.0), 1, "the callback is gone with what it holds");
}

#[test]
fn events_tell_both_halves() {
    let life = lifecycle();
    let seen: Arc<Mutex<Vec<String>>> = Arc::default();
    let log = Arc::clone(&seen);
    life.set_event_sink(Box::new(move |event| {
        lock(&log).push(format!("{} -> {}", event.start_state.label, event.goal_state.label));
    }));
    life.take(Transition::Configure).unwrap();
    assert_eq!(*lock(&seen), ["unconfigured -> configuring", "configuring -> inactive"]);
}

#[test]
fn requests_come_by_number_or_label() {
    let life = lifecycle();
    let request = |id, label: &str| TransitionMsg { id, label: label.to_owned() };
    assert!(!life.change(&request(TransitionMsg::TRANSITION_ACTIVATE, "")));
    assert!(life.change(&request(TransitionMsg::TRANSITION_CONFIGURE, "")));
    assert!(life.change(&request(0, "activate")));
    assert!(!life.change(&request(TransitionMsg::TRANSITION_INACTIVE_SHUTDOWN, "")));
    assert!(life.change(&request(TransitionMsg::TRANSITION_ACTIVE_SHUTDOWN, "")));
    assert_eq!(life.state(), State::Finalized);
}
