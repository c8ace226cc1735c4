//! The managed life of a node: its services and `~/transition_event`.

use std::any::Any;
use std::sync::Arc;

use dermis_msgs::lifecycle_msgs::msg::TransitionEvent;
use dermis_msgs::lifecycle_msgs::srv as lifecycle_srv;

use super::Node;
use crate::error::NodeError;
use crate::executor::lock;
use crate::lifecycle::{Lifecycle, Transition};
use crate::pubsub::Publisher;
use crate::service::ServiceServer;

impl Node {
    /// Lives a node that works while it is active: `work` receives whether to, with each transition. A shutdown ends the node. With
    /// `autostart` it is configured and activated at once.
    ///
    /// # Errors
    ///
    /// As [`lifecycle`](Self::lifecycle), and where a callback refuses to start.
    pub fn work_while_active(
        &self,
        autostart: bool,
        work: impl Fn(bool) + Send + Sync + 'static,
    ) -> Result<(), NodeError> {
        let life = self.lifecycle()?;
        let work = Arc::new(work);
        for (transition, active) in
            [(Transition::Activate, true), (Transition::Deactivate, false), (Transition::Shutdown, false)]
        {
            let (work, node) = (Arc::clone(&work), self.clone());
            life.on(transition, move |_| {
                work(active);
                if transition == Transition::Shutdown {
                    // The node must not wait for the callback that asks it to end.
                    let node = node.clone();
                    std::thread::spawn(move || node.shutdown());
                }
                Ok(())
            });
        }
        if autostart {
            life.take(Transition::Configure)?;
            life.take(Transition::Activate)?;
        }
        Ok(())
    }

    /// Its managed life. The first call announces the lifecycle services and `~/transition_event`; the
    /// node is Unconfigured then. A node that never calls this is not managed.
    ///
    /// # Errors
    ///
    /// When the node is shut down or the backend refuses the services.
    pub fn lifecycle(&self) -> Result<Lifecycle, NodeError> {
        let mut slot = lock(&self.0.lifecycle);
        if let Some(lifecycle) = &*slot {
            return Ok(lifecycle.clone());
        }
        let clock = self.0.clock.clone();
        let lifecycle = Lifecycle::new(self.full_name(), Box::new(move || clock.now()));
        let core = &self.0.core;
        let events: Publisher<TransitionEvent> = self.stream_publisher("~/transition_event", 10)?;
        let lane = core.system.lane("transition_event".to_owned(), None, move |event| {
            if let Err(error) = events.publish(&event) {
                tracing::debug!("{error}");
            }
        });
        lifecycle.set_event_sink(Box::new(move |event| lane.push(event)));

        let life = lifecycle.clone();
        let get_state =
            ServiceServer::new::<lifecycle_srv::GetState>(core, &core.system, "~/get_state", move |_| {
                lifecycle_srv::GetStateResponse { current_state: life.state_msg() }
            })?;
        let life = lifecycle.clone();
        let refused = self.0.lifecycle_refused.clone();
        let locked = refused.is_some();
        let change_state = self.serve::<lifecycle_srv::ChangeState>("~/change_state", move |request| {
            let success = match &refused {
                Some(why) => {
                    tracing::warn!("a transition was refused: {why}");
                    false
                }
                None => life.change(&request.transition),
            };
            lifecycle_srv::ChangeStateResponse { success }
        })?;
        let states = ServiceServer::new::<lifecycle_srv::GetAvailableStates>(
            core,
            &core.system,
            "~/get_available_states",
            |_| lifecycle_srv::GetAvailableStatesResponse { available_states: Lifecycle::available_states() },
        )?;
        let mut kept: Vec<Box<dyn Any + Send>> =
            vec![Box::new(get_state), Box::new(change_state), Box::new(states)];
        for (name, all) in [("~/get_available_transitions", false), ("~/get_transition_graph", true)] {
            let life = lifecycle.clone();
            let server = ServiceServer::new::<lifecycle_srv::GetAvailableTransitions>(
                core,
                &core.system,
                name,
                // Where transitions are refused, none is available.
                move |_| lifecycle_srv::GetAvailableTransitionsResponse {
                    available_transitions: if locked && !all { Vec::new() } else { life.transitions(all) },
                },
            )?;
            kept.push(Box::new(server));
        }
        lock(&self.0.kept).append(&mut kept);
        *slot = Some(lifecycle.clone());
        Ok(lifecycle)
    }
}
