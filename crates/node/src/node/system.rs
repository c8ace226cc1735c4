//! What a node offers by itself: `/rosout`, the parameter services, `/clock`, `/diagnostics`, and warnings about the graph.
//!
//! All of it runs on an executor of its own, so that it goes on while callbacks of the user are busy.

use std::any::Any;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::diagnostic_msgs::msg::DiagnosticArray;
use dermis_msgs::rcl_interfaces::msg::{Log, Parameter, ParameterEvent, SetParametersResult};
use dermis_msgs::rcl_interfaces::srv as parameter_srv;
use dermis_msgs::rosgraph_msgs::msg::Clock as ClockMsg;

use super::{Node, Shared};
use crate::diagnostics::{Level, Status};
use crate::error::NodeError;
use crate::executor::lock;
use crate::parameters::{ParameterDescriptor, ParameterValue};
use crate::pubsub::{Publisher, Subscription};
use crate::qos::{Durability, History, Qos, Reliability};
use crate::service::ServiceServer;
use crate::watch::{OwnEndpoint, Problem, problems};

/// Period of `/diagnostics`.
const DIAGNOSTICS_PERIOD: Duration = Duration::from_secs(1);

/// Parameter that decides which clock stamps come from.
pub(super) const SIM_TIME: &str = "use_sim_time";

/// Severity of a line in the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum LogLevel {
    /// Details for finding a fault.
    Debug,
    /// For the record.
    Info,
    /// Something needs attention.
    Warn,
    /// Something does not work.
    Error,
}

impl Node {
    /// Keeps what the node itself needs until its end.
    pub(super) fn keep(&self, item: impl Any + Send) {
        lock(&self.0.kept).push(Box::new(item));
    }

    pub(super) fn start_log(&self) -> Result<(), NodeError> {
        let qos = Qos {
            reliability: Reliability::Reliable,
            durability: Durability::TransientLocal,
            history: History::KeepLast(1000),
        };
        let publisher: Publisher<Log> = self.publisher("/rosout", qos)?;
        let lane = self.0.core.system.lane("/rosout".to_owned(), Some(1000), move |line: Log| {
            if let Err(error) = publisher.publish(&line) {
                tracing::debug!("{error}");
            }
        });
        // Set once: a node starts once.
        let _ = self.0.log.set(lane);
        Ok(())
    }

    pub(super) fn start_parameters(&self, refused: Option<String>) -> Result<(), NodeError> {
        let core = &self.0.core;
        let events: Publisher<ParameterEvent> = self.stream_publisher("/parameter_events", 1000)?;
        let lane =
            core.system.lane("/parameter_events".to_owned(), Some(1000), move |event: ParameterEvent| {
                if let Err(error) = events.publish(&event) {
                    tracing::debug!("{error}");
                }
            });
        let full_name = self.full_name();
        let clock = self.0.clock.clone();
        self.0.parameters.set_event_sink(Box::new(move |mut event| {
            event.stamp = Time::from_nanos(clock.now());
            event.node.clone_from(&full_name);
            lane.push(event);
        }));

        let fixed = refused.is_some();
        self.serve_parameter_values(refused)?;
        self.serve_parameter_descriptions(fixed)
    }

    /// Get and set; `refused` says why other nodes may not set.
    fn serve_parameter_values(&self, refused: Option<String>) -> Result<(), NodeError> {
        let core = &self.0.core;
        let p = self.0.parameters.clone();
        self.keep(ServiceServer::new::<parameter_srv::GetParameters>(
            core,
            &core.system,
            "~/get_parameters",
            move |request| parameter_srv::GetParametersResponse { values: p.get_msgs(&request.names) },
        )?);
        let p = self.0.parameters.clone();
        self.keep(ServiceServer::new::<parameter_srv::GetParameterTypes>(
            core,
            &core.system,
            "~/get_parameter_types",
            move |request| parameter_srv::GetParameterTypesResponse {
                types: p.get_msgs(&request.names).iter().map(|value| value.r#type).collect(),
            },
        )?);
        let p = self.0.parameters.clone();
        let set = move |parameters: Vec<Parameter>| match &refused {
            Some(reason) => SetParametersResult { successful: false, reason: reason.clone() },
            None => p.set_msgs(parameters),
        };
        let each = set.clone();
        self.keep(ServiceServer::new::<parameter_srv::SetParameters>(
            core,
            &core.system,
            "~/set_parameters",
            move |request| parameter_srv::SetParametersResponse {
                results: request.parameters.into_iter().map(|one| each(vec![one])).collect(),
            },
        )?);
        self.keep(ServiceServer::new::<parameter_srv::SetParametersAtomically>(
            core,
            &core.system,
            "~/set_parameters_atomically",
            move |request| parameter_srv::SetParametersAtomicallyResponse { result: set(request.parameters) },
        )?);
        Ok(())
    }

    /// Describe and list; `fixed`: other nodes may not set.
    fn serve_parameter_descriptions(&self, fixed: bool) -> Result<(), NodeError> {
        let core = &self.0.core;
        let p = self.0.parameters.clone();
        self.keep(ServiceServer::new::<parameter_srv::DescribeParameters>(
            core,
            &core.system,
            "~/describe_parameters",
            move |request| {
                let mut descriptors = p.describe_msgs(&request.names);
                // Tools then do not offer to change what they may not.
                descriptors.iter_mut().for_each(|descriptor| descriptor.read_only |= fixed);
                parameter_srv::DescribeParametersResponse { descriptors }
            },
        )?);
        let p = self.0.parameters.clone();
        self.keep(ServiceServer::new::<parameter_srv::ListParameters>(
            core,
            &core.system,
            "~/list_parameters",
            move |request| parameter_srv::ListParametersResponse {
                result: p.list(&request.prefixes, request.depth),
            },
        )?);
        Ok(())
    }

    pub(super) fn start_clock(&self) -> Result<(), NodeError> {
        let descriptor = ParameterDescriptor::new("whether stamps come from /clock instead of the system");
        let simulated = self.0.parameters.declare(SIM_TIME, false, descriptor)?;
        if simulated == ParameterValue::Bool(true) {
            self.0.set_simulated(true)?;
        }
        let weak = Arc::downgrade(&self.0.0);
        self.0.parameters.on_changed(move |name, value| {
            let (SIM_TIME, Some(simulated), Some(shared)) = (name, value.as_bool(), weak.upgrade()) else {
                return;
            };
            if let Err(error) = shared.set_simulated(simulated) {
                shared.log(LogLevel::Error, format!("cannot follow /clock: {error}"));
            }
        });
        Ok(())
    }

    pub(super) fn start_problems(&self) {
        let callbacks = Arc::clone(&self.0.problem_callbacks);
        let lane = self.0.core.executor.lane("problems".to_owned(), Some(100), move |problem: Problem| {
            for callback in lock(&callbacks).iter_mut() {
                callback(&problem);
            }
        });
        // Set once: a node starts once.
        let _ = self.0.problem_lane.set(lane);
    }

    pub(super) fn start_diagnostics(&self) -> Result<(), NodeError> {
        let weak = Arc::downgrade(&self.0.0);
        self.0.diagnostics.add("ROS graph", move || {
            let mut status = Status::ok("no conflict with other nodes");
            if let Some(shared) = weak.upgrade() {
                for problem in lock(&shared.problems).values() {
                    status.worsen(Level::Warn, &problem.sentence);
                }
                let (jumps, last) = shared.clock.jumps();
                status.value("backend", shared.backend);
                status.value("domain", shared.domain_id);
                status.value("clock", if shared.clock.is_simulated() { "/clock" } else { "system" });
                status.value("clock jumps back", jumps);
                if let Some(jump) = last {
                    status.value("last clock jump (ns)", jump.to_ns.saturating_sub(jump.from_ns));
                }
            }
            status
        });
        let core = Arc::downgrade(&self.0.core);
        let mut before = BTreeMap::new();
        self.0.diagnostics.add("subscriptions", move || {
            let now = core.upgrade().map(|core| core.losses()).unwrap_or_default();
            let status = subscriptions_status(&before, &now);
            before = now;
            status
        });
        let publisher: Publisher<DiagnosticArray> = self.stream_publisher("/diagnostics", 10)?;
        let weak = Arc::downgrade(&self.0.0);
        let timer = self.timer_on(&self.0.core.system, DIAGNOSTICS_PERIOD, move || {
            let Some(shared) = weak.upgrade() else { return };
            if publisher.subscriber_count() > 0 {
                let message = shared.diagnostics.message(shared.clock.now());
                if let Err(error) = publisher.publish(&message) {
                    tracing::debug!("{error}");
                }
            }
        });
        self.keep(timer);
        Ok(())
    }
}

/// What subscriptions lost, by topic: on the way, and dropped by a queue for newer messages.
fn subscriptions_status(before: &BTreeMap<String, (u64, u64)>, now: &BTreeMap<String, (u64, u64)>) -> Status {
    let mut status = Status::ok("nothing was lost since the last report");
    for (topic, &(lost, dropped)) in now {
        let (lost_before, dropped_before) = before.get(topic).copied().unwrap_or_default();
        if lost > lost_before {
            let sentence = format!("{} messages on {topic} were lost on the way", lost - lost_before);
            status.worsen(Level::Warn, sentence);
        } else if dropped > dropped_before && status.level == Level::Ok {
            // With keep last, a slow reader gets the newest messages only: this is no fault.
            status.message =
                "messages were dropped, because newer ones came before they were read".to_owned();
        }
        status.value(format!("{topic}: lost on the way"), lost);
        status.value(format!("{topic}: dropped for newer ones"), dropped);
    }
    status
}

impl Shared {
    pub(super) fn log(&self, level: LogLevel, text: String) {
        let node = self.core.names.full_name();
        let id = match level {
            LogLevel::Debug => {
                tracing::debug!(%node, "{text}");
                Log::DEBUG
            }
            LogLevel::Info => {
                tracing::info!(%node, "{text}");
                Log::INFO
            }
            LogLevel::Warn => {
                tracing::warn!(%node, "{text}");
                Log::WARN
            }
            LogLevel::Error => {
                tracing::error!(%node, "{text}");
                Log::ERROR
            }
        };
        if let Some(lane) = self.log.get() {
            lane.push(Log {
                stamp: Time::from_nanos(self.clock.now()),
                level: id,
                name: node.trim_start_matches('/').replace('/', "."),
                msg: text,
                ..Log::default()
            });
        }
    }

    fn set_simulated(&self, simulated: bool) -> Result<(), NodeError> {
        let mut slot = lock(&self.clock_subscription);
        if simulated == slot.is_some() {
            return Ok(());
        }
        self.clock.set_simulated(simulated);
        *slot = if simulated {
            let clock = self.clock.clone();
            let on_clock = move |message: ClockMsg, _| {
                clock.set_simulated_now(message.clock.as_nanos());
            };
            Some(Subscription::typed(&self.core, "/clock", Qos::clock(), on_clock)?)
        } else {
            None
        };
        Ok(())
    }

    /// Warns of conflicts that are new in the graph.
    pub(super) fn check_graph(&self) {
        let own: Vec<OwnEndpoint> = lock(&self.core.own).values().cloned().collect();
        let found = match problems(self.core.node.as_ref(), &self.core.names.full_name(), &own) {
            Ok(found) => found,
            Err(error) => {
                tracing::debug!("{error}");
                return;
            }
        };
        let before = std::mem::replace(&mut *lock(&self.problems), found.clone());
        for (key, problem) in found {
            if !before.contains_key(&key) {
                self.log(LogLevel::Warn, problem.sentence.clone());
                if let Some(lane) = self.problem_lane.get() {
                    lane.push(problem);
                }
            }
        }
    }
}
