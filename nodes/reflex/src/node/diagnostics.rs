//! The status on `/diagnostics`.

use dermis_node::{Level, State, Status};

use super::guard::{Figures, Guard};

impl Guard {
    /// The status now; delays are those since the last call.
    pub(super) fn diagnose(&self) -> Status {
        if !self.is_active() {
            let state = self.node.lifecycle().map_or(State::Unconfigured, |life| life.state());
            let mut status = Status::ok("");
            status.worsen(Level::Warn, format!("{state}: guards nothing"));
            return status;
        }
        let now = self.now();
        let mut core = self.lock();
        let mut status = Status::ok("guards");
        for state in core.reflex.states() {
            let text = match (state.acts, state.latched) {
                (None, _) => "does not act".to_owned(),
                (Some(reason), true) => format!("acts until it is released: {reason}"),
                (Some(reason), false) => format!("acts: {reason}"),
            };
            if state.acts.is_some() {
                status.worsen(Level::Warn, format!("rule `{}` {text}", state.rule));
            }
            status.value(format!("rule {}", state.rule), text);
            if let Some(holds) = state.holds {
                status.value(format!("rule {} holds", state.rule), holds);
            }
        }
        let inputs = core.reflex.rules().inputs.iter();
        for (input, (name, silence)) in inputs.zip(core.reflex.silences(now)) {
            match silence {
                None => status.worsen(Level::Error, format!("nothing has come from input `{name}`")),
                Some(silence) if silence >= input.timeout => {
                    let seconds = silence.as_secs_f64();
                    status.worsen(
                        Level::Error,
                        format!("input `{name}` has brought nothing new for {seconds:.3} s"),
                    );
                }
                Some(_) => {}
            }
            let text = silence.map_or("never".to_owned(), |s| format!("{:.1}", s.as_secs_f64() * 1e3));
            status.value(format!("input {name}: since the last message [ms]"), text);
        }
        let Figures { messages, delay_sum, delay_max, acted } = core.figures;
        if messages > 0 {
            status.value("handling mean [ms]", format!("{:.3}", delay_sum as f64 * 1e-6 / messages as f64));
            status.value("handling max [ms]", format!("{:.3}", delay_max as f64 * 1e-6));
        }
        status.value("messages", messages);
        status.value("rules that began to act", acted);
        core.figures = Figures { acted, ..Figures::default() };
        status
    }
}
